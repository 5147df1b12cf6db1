"""Integer reference of the front end's background: tiles, followed along the frame. See `front_end`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.flight.front_tables import BLOCK, FrontTables

LEAST_NOISE = 18
"""Of rounding, 1/√12, 6 fraction bits."""
_GAIN = 2
"""Weight of a block, 2^-gain; those of the first ones are 1 and 1/2."""
_LARGEST_LEVEL = 65535


class Lines(NamedTuple):
    """Background in the knots of each row, (H, C + 2), 8 fraction bits."""

    level: IntArray
    noise: IntArray
    slope: IntArray
    """Of the level along y, DN a row."""


def square_root(n: IntArray) -> IntArray:
    """Floor of the square roots of non-negative integers below 2^62."""
    root = np.sqrt(n.astype(np.float64)).astype(np.int64)
    root -= root * root > n
    return np.asarray(root + ((root + 1) * (root + 1) <= n))


def background_lines(image: NDArray[np.uint16], tables: FrontTables) -> Lines:
    """Background in the knots of all rows.

    Each tile of 4 rows gives a clipped mean and standard deviation, which pass a median of three along x; along y the
    level follows them with a slope (an alpha-beta filter of 1/4 and 1/32), the noise exponentially. A level off by more
    than half of the noise is taken as it is, and changes the slope by a quarter of the difference (a gradient that
    begins); by more than four times the noise it is a step, after which the slope begins at zero. The level does not
    follow tiles of more than 1.5 times the noise of those above: clipping leaves the faint light of stars and trails.
    """
    height = len(image)
    tiles = len(tables.edge) - 1
    blocks = max(1, height // BLOCK)
    found = np.array([_tile_statistics(image, tables, tile) for tile in range(tiles)])  # (C, 2, blocks)
    level, noise = _median_of_three(found[:, 0].T), _median_of_three(found[:, 1].T)
    levels, noises, slopes = (np.empty((height, tiles), np.int64) for _ in range(3))
    x, v, n = level[0] << 4, np.zeros(tiles, np.int64), noise[0] << 6
    for block in range(blocks):
        if block > 0:
            x, v, n = _follow((x, v, n), level[block] << 4, noise[block] << 6, min(block, _GAIN))
        last = height if block == blocks - 1 else BLOCK * (block + 1)
        rows = np.arange(BLOCK * block, last)[:, None]
        moved = x + ((v * (2 * (rows - BLOCK * block) - BLOCK + 1)) >> 3)
        levels[rows[:, 0]] = np.clip(moved, 0, _LARGEST_LEVEL << 12) >> 4
        noises[rows[:, 0]], slopes[rows[:, 0]] = n >> 4, v >> 6
    ends = (0, 0), (1, 1)
    return Lines(_extended(levels, tables.extend), np.pad(noises, ends, "edge"), np.pad(slopes, ends, "edge"))


def _tile_statistics(image: NDArray[np.uint16], tables: FrontTables, tile: int) -> tuple[IntArray, IntArray]:
    """Level (8 fraction bits) and noise (6) of one tile in all blocks."""
    rows = min(BLOCK, len(image))
    blocks = max(1, len(image) // BLOCK)
    columns = [
        np.arange(tables.edge[tile] + row % tables.stride, tables.edge[tile + 1], tables.stride) for row in range(rows)
    ]
    x = np.concatenate(columns)
    y = np.repeat(np.arange(rows), [len(row) for row in columns])
    values = np.sort(image[BLOCK * np.arange(blocks)[:, None] + y, x].astype(np.int64), axis=1)
    count = values.shape[1]
    if count == 0:
        return np.zeros(blocks, np.int64), np.full(blocks, LEAST_NOISE)
    middle, upper = values[:, (count - 1) // 2], values[:, (count * 27571) >> 15]
    apart = values - middle[:, None]
    half = np.maximum(192 * (upper - middle), 3 * LEAST_NOISE) + 32
    mean, noise = _clipped(apart, half)
    mean, noise = _clipped(apart, 3 * noise + 32)
    cut = (values[:, 0] == 0) & (2 * middle <= upper - middle)  # noise below zero is missing: its tail is longer
    noise = np.where(cut, np.maximum(noise, (upper - middle + 1) << 6), noise)
    return (middle << 8) + mean, noise


def _clipped(apart: IntArray, half: IntArray) -> tuple[IntArray, IntArray]:
    """Mean (8 fraction bits) and noise (6) of the values within a half width (6)."""
    kept = np.where(np.abs(apart) * 64 <= half[:, None], apart, 0)
    count = (np.abs(apart) * 64 <= half[:, None]).sum(axis=1)
    total, squares = kept.sum(axis=1), (kept * kept).sum(axis=1)
    mean = (total << 8) // count
    variance = (squares << 12) // count - ((mean * mean) >> 4)
    sigma = square_root(np.clip(variance, 0, (1 << 32) - 1))
    return mean, np.maximum((sigma * 1038) >> 10, LEAST_NOISE)


def _median_of_three(tiles: IntArray) -> IntArray:
    """Median with both neighbours along the last axis; the outermost stay."""
    out = tiles.copy()
    out[:, 1:-1] = np.median([tiles[:, :-2], tiles[:, 1:-1], tiles[:, 2:]], axis=0) if tiles.shape[1] > 2 else 0
    return out


def _follow(
    state: tuple[IntArray, IntArray, IntArray], level: IntArray, noise: IntArray, gain: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Level, slope and noise after another block, 12 fraction bits; `gain` in bits to the right."""
    x, v, n = state
    ahead = level - x - v
    even, step = 2 * noise <= 3 * n, np.abs(ahead) > 4 * n
    lost = even & (np.abs(ahead) > n >> 1)
    followed = np.where(even, ahead, 0)
    x = np.where(lost | step, level, np.clip(x + v + (followed >> gain), 0, _LARGEST_LEVEL << 12))
    v = np.where(step, 0, v + (followed >> np.where(lost, 2, 5)))
    changed = (noise > 4 * n) | (2 * noise < n)
    return x, v, np.where(changed, noise, n + ((noise - n) >> gain))


def _extended(levels: IntArray, extend: IntArray) -> IntArray:
    """Levels with those at both borders, extrapolated."""
    first, last = levels[:, :1], levels[:, -1:]
    if levels.shape[1] > 1:
        first = first + (((first - levels[:, 1:2]) * extend[0]) >> 16)
        last = last + (((last - levels[:, -2:-1]) * extend[1]) >> 16)
    return np.clip(np.hstack([first, levels, last]), 0, _LARGEST_LEVEL << 8)


def at_columns(lines: IntArray, tables: FrontTables, y: IntArray, x: IntArray) -> IntArray:
    """Values of knots, interpolated at pixels."""
    cell = np.searchsorted(tables.knot[1:-1], x, side="right")
    rise = (lines[y, cell + 1] - lines[y, cell]) * tables.inverse[cell]
    return np.asarray(lines[y, cell] + ((rise * (x - tables.knot[cell])) >> 16))
