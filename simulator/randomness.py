"""Random streams keyed by (seed, stage, trial): the same scenario and seed draw the same numbers on any number of
workers, and a new stage shifts no other."""

from __future__ import annotations

import functools
import zlib
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

DEVICE = -1
"""Trial index of what belongs to the device and not to a trial: fixed-pattern noise, hot pixels."""

Words = NDArray[np.uint32]

_POOL = 4
_INIT_A, _MULT_A = np.uint32(0x43B0D7E5), np.uint32(0x931E8875)
_INIT_B, _MULT_B = np.uint32(0x8B51F9DD), np.uint32(0x58F38DED)
_MIX_L, _MIX_R, _SHIFT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715), np.uint32(16)


def stream(seed: int, stage: str, trial: int = DEVICE) -> np.random.Generator:
    """Independent generator of one stage of one trial.

    The key is that of NumPy's ``SeedSequence(seed, spawn_key=(stage, trial + 1))`` (a hash built for it), hashed here
    by a kernel, as a trial asks for several; the bits come from Philox-4x64 (Salmon et al. 2011, "Parallel random
    numbers: as easy as 1, 2, 3"). Stage names are hashed by CRC-32, which is the same in every process and version.
    """
    if seed < 0 or trial < DEVICE:
        raise ValueError(f"streams have a seed from 0 and a trial from {DEVICE} up; got {seed} and {trial}")
    bits = np.random.Philox(_Seed(seed, (zlib.crc32(stage.encode()), trial + 1)))  # type: ignore[arg-type]  # NumPy's
    return np.random.Generator(bits)  # stubs know its own class only


class _Seed(np.random.bit_generator.ISpawnableSeedSequence):
    """NumPy's ``SeedSequence``, which is made only for what this has not: all but the 128 bits that Philox takes."""

    def __init__(self, seed: int, spawn_key: tuple[int, int]) -> None:
        self._origin = seed, spawn_key

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> NDArray[Any]:
        if n_words * np.dtype(dtype).itemsize > 4 * _POOL:
            return np.asarray(self._whole.generate_state(n_words, dtype))
        seed, spawn_key = self._origin
        words = _words(seed)
        words += [0] * (_POOL - len(words))
        for number in spawn_key:
            words += _words(number)
        return np.asarray(_hash(np.array(words, dtype=np.uint32)).view(dtype)[:n_words])

    def spawn(self, n_children: int) -> list[np.random.SeedSequence]:  # type: ignore[override]  # of any kind will do
        return self._whole.spawn(n_children)

    @functools.cached_property
    def _whole(self) -> np.random.SeedSequence:
        seed, spawn_key = self._origin
        return np.random.SeedSequence(entropy=seed, spawn_key=spawn_key)


def _words(number: int) -> list[int]:
    """A number that is not negative in words of 32 bits, the lowest first."""
    words = [number & 0xFFFFFFFF]
    while number := number >> 32:
        words.append(number & 0xFFFFFFFF)
    return words


@njit(cache=True, error_model="numpy")
def _hash(words: Words) -> Words:
    """128 bits (4,) of a seed (4 words or more) with its spawn key: NumPy's ``SeedSequence`` (O'Neill 2015, "Developing
    a seed_seq alternative")."""
    pool, constant = np.empty(_POOL, np.uint32), _INIT_A
    for i in range(_POOL):
        pool[i], constant = _hashed(words[i], constant, _MULT_A)
    for source in range(_POOL):
        for place in range(_POOL):
            if source != place:
                value, constant = _hashed(pool[source], constant, _MULT_A)
                pool[place] = _mixed(pool[place], value)
    for source in range(_POOL, len(words)):
        for place in range(_POOL):
            value, constant = _hashed(words[source], constant, _MULT_A)
            pool[place] = _mixed(pool[place], value)
    constant = _INIT_B
    for i in range(_POOL):
        pool[i], constant = _hashed(pool[i], constant, _MULT_B)
    return pool


@njit(cache=True, error_model="numpy", inline="always")
def _hashed(value: np.uint32, constant: np.uint32, multiplier: np.uint32) -> tuple[np.uint32, np.uint32]:
    value = np.uint32(value ^ constant)
    constant = np.uint32(constant * multiplier)
    value = np.uint32(value * constant)
    return np.uint32(value ^ (value >> _SHIFT)), constant


@njit(cache=True, error_model="numpy", inline="always")
def _mixed(x: np.uint32, y: np.uint32) -> np.uint32:
    result = np.uint32(np.uint32(_MIX_L * x) - np.uint32(_MIX_R * y))
    return np.uint32(result ^ (result >> _SHIFT))
