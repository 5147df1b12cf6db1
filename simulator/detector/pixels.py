"""Effects that act on every pixel by itself, one after the other while the pixels lie in the processor's cache.

An image of a million pixels is larger than the cache, and to fetch it costs as much as most effects. A row of steps is
therefore walked tile by tile, not image by image. `chain.py` has the order; a `Step` says which kernel it is and with
which numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.detector.exposure import clip, dark_signal, is_light, photo_response
from simulator.detector.normal import add_normal
from simulator.detector.philox import Key, draw_key, fill_words
from simulator.detector.poisson import LARGEST_MEAN, shot_noise
from simulator.detector.readout import amplify, bend, convert
from startracker.errors import InputError

FloatArray = NDArray[np.float64]

TILE = 2048
"""Pixels at a time. Part of what a seed means: pixel k takes word (k mod TILE) div (TILE/4) of the block of counter
(k div TILE) (TILE/4) + k mod (TILE/4)."""
LIGHT, PHOTO_RESPONSE, DARK_SIGNAL, SHOT_NOISE, CLIP, NORMAL_NOISE, BEND, AMPLIFY, CONVERT = range(9)
_VALUES = 3
_NO_KEY: Key = np.zeros(2, dtype=np.uint64)
_NO_MAP: FloatArray = np.zeros(0)


@dataclass(frozen=True)
class Step:
    """One effect on each pixel: the kernel's number, its values, a value for each pixel, the stream."""

    kernel: int
    values: tuple[float, ...] = ()
    map: FloatArray = field(default_factory=lambda: _NO_MAP)
    rng: np.random.Generator | None = None


def of_map(kernel: int, map_: FloatArray | float) -> Step:
    """Step with a value for each pixel, or the same for all."""
    if np.ndim(map_) == 0:
        return Step(kernel, (float(map_),))
    return Step(kernel, map=np.ascontiguousarray(map_, dtype=np.float64).reshape(-1))


def walk(signal: FloatArray, steps: Sequence[Step], out: NDArray[Any]) -> None:
    """Take an image through a row of steps.

    Parameters
    ----------
    signal : (H, W) float64, contiguous
        Left as it is.
    steps : sequence of Step
        In their order.
    out : (H, W) float64 or uint16, contiguous
        Takes the outcome; may be `signal`. Whole numbers in range are needed for uint16: `CONVERT` comes last.

    Raises
    ------
    InputError
        Where light is negative or not finite, or the mean of a Poisson number, with response and dark current, is not
        in 0 to `LARGEST_MEAN`.
    """
    if not (signal.flags.c_contiguous and out.flags.c_contiguous):
        raise ValueError("walk works on C-contiguous arrays only")
    values = np.zeros((len(steps), _VALUES))
    keys = np.zeros((len(steps), 2), dtype=np.uint64)
    maps = {PHOTO_RESPONSE: _NO_MAP, DARK_SIGNAL: _NO_MAP}
    for k, step in enumerate(steps):
        values[k, : len(step.values)] = step.values
        keys[k] = _NO_KEY if step.rng is None else draw_key(step.rng)
        if step.map.size:
            maps[step.kernel] = step.map
    kernels = np.array([step.kernel for step in steps], dtype=np.int64)
    stopped = _walk(signal.reshape(-1), kernels, values, keys, maps[PHOTO_RESPONSE], maps[DARK_SIGNAL], out.reshape(-1))
    if stopped == LIGHT:
        raise InputError("mean_photo_e has a pixel that is negative or not finite; electrons are counted from zero up")
    if stopped == SHOT_NOISE:
        raise InputError(f"a pixel's mean electrons cannot be counted: they must lie in 0 to {LARGEST_MEAN:g}")


@numba.njit(cache=True, error_model="numpy")
def _walk(
    signal: FloatArray,
    kernels: NDArray[np.int64],
    values: FloatArray,
    keys: Key,
    response: FloatArray,
    dark: FloatArray,
    out: NDArray[Any],
) -> int:
    """The walk; returns the kernel that refused the signal, or −1."""
    words = np.empty(TILE, dtype=np.uint32)
    one, two = np.empty(TILE, dtype=np.float32), np.empty(TILE, dtype=np.float32)
    room = np.empty(TILE)
    for first in range(0, signal.size, TILE):
        stop = min(first + TILE, signal.size)
        tile, source, target = room[: stop - first], signal[first:stop], out[first:stop]
        for i in range(tile.size):  # on slices of their own loops are vectorised, a slice assignment is not
            tile[i] = source[i]
        for k in range(kernels.size):
            kernel, value, key = kernels[k], values[k], keys[k]
            if kernel == LIGHT:
                if not is_light(tile):
                    return LIGHT
            elif kernel == PHOTO_RESPONSE:
                photo_response(tile, value[0], response[first:stop])
            elif kernel == DARK_SIGNAL:
                dark_signal(tile, value[0], dark[first:stop])
            elif kernel == SHOT_NOISE:
                fill_words(key, np.uint64(first // 4), np.uint64(0), words)
                if not shot_noise(tile, key, first, words, one, two):
                    return SHOT_NOISE
            elif kernel == CLIP:
                clip(tile, value[0])
            elif kernel == NORMAL_NOISE:
                fill_words(key, np.uint64(first // 4), np.uint64(0), words)
                add_normal(tile, value[0], key, first, words, one)
            elif kernel == BEND:
                bend(tile, value[0], value[1], value[2])
            elif kernel == AMPLIFY:
                amplify(tile, value[0], value[1])
            elif kernel == CONVERT:
                convert(tile, value[0])
        for i in range(tile.size):
            target[i] = tile[i]
    return -1
