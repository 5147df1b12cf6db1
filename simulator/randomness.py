"""Random streams keyed by (seed, stage, trial): the same scenario and seed draw the same numbers on any number of
workers, and a new stage shifts no other."""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np

DEVICE = -1
"""Trial index of what belongs to the device and not to a trial: fixed-pattern noise, hot pixels."""

Streams = Callable[[str], np.random.Generator]
"""Gives the generator of a stage by its name."""


def stream(seed: int, stage: str, trial: int = DEVICE) -> np.random.Generator:
    """Independent generator of one stage of one trial.

    The key goes through NumPy's `SeedSequence` (a hash built for it), the bits come from Philox-4x64
    (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"). Stage names are hashed by CRC-32, which is
    the same in every process and version.
    """
    if seed < 0 or trial < DEVICE:
        raise ValueError(f"streams have a seed from 0 and a trial from {DEVICE} up; got {seed} and {trial}")
    key = np.random.SeedSequence(entropy=seed, spawn_key=(zlib.crc32(stage.encode()), trial + 1))
    return np.random.Generator(np.random.Philox(key))
