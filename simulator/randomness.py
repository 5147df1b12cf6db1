"""Random streams keyed by (seed, stage, trial).

The same scenario and seed give the same random numbers on any number of workers, and the numbers of one stage do not
depend on which other stages exist.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

DEVICE = -1
"""Trial index for properties of the device, which do not depend on the trial: fixed-pattern noise, hot pixels."""

Key = NDArray[np.uint64]
"""Key (2,) of a counter-based stream of kernels (`simulator.detector.philox`): two numbers of 32 bits."""

Streams = Callable[[str], np.random.Generator]
"""Returns the generator of a stage by its name."""


def seed_of(seed: int, stage: str, name: str) -> int:
    """Seed of one of several named objects, such as the cameras of a spacecraft; from 0 to 2⁶³ − 1."""
    key = np.random.SeedSequence(entropy=seed, spawn_key=(zlib.crc32(stage.encode()), zlib.crc32(name.encode())))
    # One bit is dropped so that the seed fits into a signed 64-bit integer, as in a FITS header or a table.
    return int(key.generate_state(1, np.uint64)[0] >> np.uint64(1))


def stream(seed: int, stage: str, trial: int = DEVICE) -> np.random.Generator:
    """Independent generator of one stage of one trial.

    The key is hashed by NumPy's `SeedSequence`, and the generator is Philox-4x64 (Salmon et al. 2011, "Parallel random
    numbers: as easy as 1, 2, 3"). Stage names are hashed by CRC-32, which is the same in every process and version.
    """
    if seed < 0 or trial < DEVICE:
        raise ValueError(f"a stream needs a seed from 0 and a trial from {DEVICE} up; got {seed} and {trial}")
    # A spawn key must not be negative, and the properties of the device have the trial -1.
    key = np.random.SeedSequence(entropy=seed, spawn_key=(zlib.crc32(stage.encode()), trial + 1))
    return np.random.Generator(np.random.Philox(key))


def draw_key(rng: np.random.Generator) -> Key:
    """Key (2,) uint64 of a counter-based stream: the lower and upper half of the next 64 bits of the stream `rng`. For
    an unused stream these are its first two `integers` of 32 bits."""
    bits: int = rng.bit_generator.random_raw()
    return np.array([bits & 0xFFFFFFFF, bits >> 32], dtype=np.uint64)
