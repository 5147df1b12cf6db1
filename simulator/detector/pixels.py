"""The walk of an image through a row of steps, each of which acts on every pixel by itself.

An image of a million pixels is larger than the processor's cache, and to fetch it costs as much as most effects. A row
of steps is therefore walked tile by tile, not image by image. Where a level is known that most pixels have, these are
drawn from a table of the row's outcome (`level.py`), and the others gathered into tiles of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.detector.exposure import clip, collect
from simulator.detector.few import BLOCK, outside
from simulator.detector.level import LevelTable, draw_level, level_table
from simulator.detector.normal import add_normal
from simulator.detector.philox import Key, Words, block, draw_key, fill_words
from simulator.detector.poisson import LARGEST_MEAN, shot_noise
from simulator.detector.readout import amplify, bend, convert
from simulator.detector.steps import (
    AMPLIFY,
    BEND,
    CLIP,
    CONVERT,
    LIGHT,
    NORMAL_NOISE,
    SHOT_NOISE,
    Collection,
    Step,
    begin,
)
from simulator.randomness import Streams
from startracker.errors import InputError

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]

TILE = 2048
"""Pixels at a time. Part of what a seed means: pixel k takes word (k mod TILE) div (TILE/4) of the block of counter
(k div TILE) (TILE/4) + k mod (TILE/4)."""
_TILE, _QUARTER, _TWO = np.uint64(TILE), np.uint64(TILE // 4), np.uint64(2)
_VALUES = 3
_MANY = 4
"""Where more than one pixel in so many is off the level, the tile is walked as it lies."""


def walk(signal: FloatArray, steps: Sequence[Step], out: NDArray[Any], level: float | None = None) -> None:
    """Take an image through a row of steps: see `Row`."""
    Row(steps).walk(signal, out, level)


class Row:
    """A row of steps, ready for any number of images.

    Parameters
    ----------
    steps : sequence of Step
        In their order.
    """

    def __init__(self, steps: Sequence[Step]) -> None:
        self._how, self._rest = begin(steps)
        self._values = np.zeros((len(self._rest), _VALUES))
        for k, step in enumerate(self._rest):
            self._values[k, : len(step.values)] = step.values
        self._kernels = np.array([step.kernel for step in self._rest], dtype=np.int64)
        self._random = [(k, step.rng) for k, step in enumerate(self._rest) if step.rng is not None]

    def walk(
        self, signal: FloatArray, out: NDArray[Any], level: float | None = None, streams: Streams | None = None
    ) -> None:
        """Take an image through the row.

        Parameters
        ----------
        signal : (H, W) float64, contiguous
            Left as it is.
        out : (H, W) float64 or uint16, contiguous
            Takes the outcome; may be `signal`. Whole numbers in range are needed for uint16: `CONVERT` comes last.
        level : float, optional
            Signal that many pixels share. Where their outcome has a table they take it from there, by the word of the
            first random step: other numbers than without a level, of the same distribution.
        streams : callable, optional
            Gives the generators of steps that name their streams.

        Raises
        ------
        InputError
            Where light is negative or not finite, or the mean of a Poisson number, with response and dark current, is
            not in 0 to `LARGEST_MEAN`.
        """
        if not (signal.flags.c_contiguous and out.flags.c_contiguous):
            raise ValueError("walk works on C-contiguous arrays only")
        how, kernels, values = self._how, self._kernels, self._values
        keys = np.zeros((len(kernels), 2), dtype=np.uint64)
        for k, source in self._random:
            if isinstance(source, str):
                assert streams is not None, "a step names its stream, and nobody gives it"
                keys[k] = draw_key(streams(source))
            else:
                keys[k] = draw_key(source)
        pixels, target = signal.reshape(-1), out.reshape(-1)
        table = None if level is None else level_table(level, how, self._rest, signal.size)
        if level is None or table is None:
            stopped = _walk(pixels, how, kernels, values, keys, target)
        else:
            key = keys[self._random[0][0]]
            stopped = _walk_about_level(pixels, how, kernels, values, keys, float(level), table, key, target)
        if stopped == LIGHT:
            raise InputError(
                "mean_photo_e has a pixel that is negative or not finite; electrons are counted from zero up"
            )
        if stopped == SHOT_NOISE:
            raise InputError(f"a pixel's mean electrons cannot be counted: they must lie in 0 to {LARGEST_MEAN:g}")


@numba.njit(cache=True, error_model="numpy")
def _walk(
    signal: FloatArray,
    how: Collection,
    kernels: IntArray,
    values: FloatArray,
    keys: Key,
    out: NDArray[Any],
) -> int:
    """The walk; returns the kernel that refused the signal, or −1."""
    room = _rooms(TILE)
    stopped: int = -1
    space, offset = np.empty(TILE), np.arange(TILE)
    for first in range(0, signal.size, TILE):
        stop = min(first + TILE, signal.size)
        tile, source, target = space[: stop - first], signal[first:stop], out[first:stop]
        if not collect(tile, source, how, first):
            return LIGHT
        stopped = _through(tile, first, offset[: tile.size], kernels, values, keys, room)
        if stopped >= 0:
            return stopped
        for i in range(tile.size):  # on slices of their own loops are vectorised, a slice assignment is not
            target[i] = tile[i]
    return stopped


@numba.njit(cache=True, error_model="numpy")
def _walk_about_level(
    signal: FloatArray,
    how: Collection,
    kernels: IntArray,
    values: FloatArray,
    keys: Key,
    level: float,
    table: LevelTable,
    key: Key,
    out: NDArray[Any],
) -> int:
    """The walk of an image many of whose pixels have a level, and are drawn from its table by `key`."""
    room = _rooms(2 * TILE)
    stopped: int = -1
    words, numbers = np.empty(TILE, dtype=np.uint32), np.empty(TILE, dtype=np.int32)
    space, offset = np.empty(TILE), np.arange(TILE)
    others, charge = np.empty(2 * TILE), np.empty(2 * TILE)
    pixel, waiting = np.empty(2 * TILE, dtype=np.int64), 0
    for first in range(0, signal.size, TILE):
        stop = min(first + TILE, signal.size)
        tile, source, target = space[: stop - first], signal[first:stop], out[first:stop]
        drawn = numbers[: tile.size]
        off = _gather(source, level, first, others[waiting:], pixel[waiting:])
        if off < tile.size:
            fill_words(key, np.uint64(first // 4), np.uint64(0), words)
            draw_level(table, key, first, words, drawn)
        if _MANY * off > tile.size:
            if not collect(tile, source, how, first):
                return LIGHT
            stopped = _through(tile, first, offset[: tile.size], kernels, values, keys, room)
            if stopped >= 0:
                return stopped
            for i in range(tile.size):
                target[i] = np.float64(drawn[i]) if source[i] == level else tile[i]
        else:
            waiting += off
            for i in range(tile.size):
                target[i] = drawn[i]
        if waiting >= TILE or (waiting > 0 and stop == signal.size):
            run = charge[:waiting]
            if not collect(run, others[:waiting], how, 0):
                return LIGHT
            stopped = _through(run, 0, pixel[:waiting], kernels, values, keys, room)
            if stopped >= 0:
                return stopped
            for i in range(waiting):
                out[pixel[i]] = run[i]
            waiting = 0
    return stopped


@numba.njit(cache=True, error_model="numpy")
def _gather(source: FloatArray, level: float, first: int, others: FloatArray, pixel: IntArray) -> int:
    """Those pixels of a tile that are off the level, and their numbers; returns how many."""
    count = 0
    for start in range(0, source.size, BLOCK):
        stop = min(start + BLOCK, source.size)
        if outside(source[start:stop], level, level) > 0:
            for i in range(start, stop):
                if source[i] != level:
                    others[count], pixel[count] = source[i], first + i
                    count += 1
    return count


@numba.njit(cache=True, error_model="numpy")
def _rooms(size: int) -> tuple[Words, SingleArray, SingleArray]:
    return np.empty(size, dtype=np.uint32), np.empty(size, dtype=np.float32), np.empty(size, dtype=np.float32)


@numba.njit(cache=True, error_model="numpy")
def _through(
    run: FloatArray,
    first: int,
    offset: IntArray,
    kernels: IntArray,
    values: FloatArray,
    keys: Key,
    room: tuple[Words, SingleArray, SingleArray],
) -> int:
    """Take a run of pixels (N,) of the numbers first + offset through the steps, in place; returns as `_walk`."""
    words, one, two = room
    for k in range(kernels.size):
        kernel, value, key = kernels[k], values[k], keys[k]
        if kernel == SHOT_NOISE:
            _words_of(key, first, offset, words)
            if not shot_noise(run, key, first, offset, words, one, two):
                return SHOT_NOISE
        elif kernel == CLIP:
            clip(run, value[0])
        elif kernel == NORMAL_NOISE:
            _words_of(key, first, offset, words)
            add_normal(run, value[0], key, first, offset, words, one)
        elif kernel == BEND:
            bend(run, value[0], value[1], value[2])
        elif kernel == AMPLIFY:
            amplify(run, value[0], value[1])
        elif kernel == CONVERT:
            convert(run, value[0])
    return -1


@numba.njit(cache=True, error_model="numpy")
def _words_of(key: Key, first: int, offset: IntArray, words: Words) -> None:
    """Words of pixels by their rising numbers into `words` (≥ N,; all of a tile, where they are one from its start)."""
    n = offset.size
    if first % TILE == 0 and offset[0] == 0 and offset[n - 1] == n - 1 and n <= TILE:
        fill_words(key, np.uint64(first // 4), np.uint64(0), words[:TILE])
        return
    for i in range(n):
        pixel = np.uint64(first + offset[i])
        part = pixel % _TILE // _QUARTER
        x0, x1, x2, x3 = block(key[0], key[1], pixel // _TILE * _QUARTER + pixel % _QUARTER, np.uint64(0))
        words[i] = np.uint32((x0 if part == 0 else x1) if part < _TWO else (x2 if part == _TWO else x3))
