"""Integer reference of the front end's first stage: background, matched filter, candidates. See `front_end`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import BoolArray, IntArray
from startracker.flight.front_tables import BLOCK, HALF, RUNS, FrontTables

LEAST_NOISE = 18
"""Of rounding, 1/√12, 6 fraction bits."""
_LARGEST_LEVEL = 65535
_EXTENDED = 20, 7
"""A candidate is part of something extended if 7/20 of the border of its stamp are bright."""


class Lines(NamedTuple):
    """Background in the knots of each row, (H, C + 2), 8 fraction bits."""

    level: IntArray
    noise: IntArray


class Searched(NamedTuple):
    """What was found in a frame, for the next stages."""

    lines: Lines
    filtered: IntArray
    """(H, W): 0 where the filter reaches beyond the frame."""
    above: BoolArray
    """(H, W): Pixels above the threshold."""


class Candidates(NamedTuple):
    """Local maxima of the filtered frame, the highest first."""

    x: IntArray
    y: IntArray
    height: IntArray
    """Above the background, filtered units."""
    level: IntArray
    noise: IntArray
    """Background, 8 fraction bits."""
    stamp: IntArray
    """(N, 11, 11): Pixels about it; 0 beyond the frame."""


def square_root(n: IntArray) -> IntArray:
    """Floor of the square roots of non-negative integers below 2^62."""
    root = np.sqrt(n.astype(np.float64)).astype(np.int64)
    root -= root * root > n
    return np.asarray(root + ((root + 1) * (root + 1) <= n))


def background_lines(image: NDArray[np.uint16], tables: FrontTables) -> Lines:
    """Background in the knots of all rows.

    Each tile of 8 rows gives a clipped mean and standard deviation, which pass a median of three along x; along y the
    level follows them with a slope (an alpha-beta filter of 1/4 and 1/32), the noise exponentially (1/4), and both
    begin anew after a step.
    """
    height = len(image)
    tiles = len(tables.edge) - 1
    blocks = max(1, height // BLOCK)
    found = np.array([_tile_statistics(image, tables, tile) for tile in range(tiles)])  # (C, 2, blocks)
    level, noise = _median_of_three(found[:, 0].T), _median_of_three(found[:, 1].T)
    levels, noises = np.empty((height, tiles), np.int64), np.empty((height, tiles), np.int64)
    x, v, n = level[0] << 4, np.zeros(tiles, np.int64), noise[0] << 6
    for block in range(blocks):
        if block > 0:
            x, v, n = _follow(x, v, n, level[block] << 4, noise[block] << 6)
        last = height if block == blocks - 1 else BLOCK * (block + 1)
        rows = np.arange(BLOCK * block, last)[:, None]
        moved = x + ((v * (2 * (rows - BLOCK * block) - BLOCK + 1)) >> 4)
        levels[rows[:, 0]] = np.clip(moved, 0, _LARGEST_LEVEL << 12) >> 4
        noises[rows[:, 0]] = n >> 4
    return Lines(_extended(levels, tables.extend), np.pad(noises, ((0, 0), (1, 1)), "edge"))


def _tile_statistics(image: NDArray[np.uint16], tables: FrontTables, tile: int) -> tuple[IntArray, IntArray]:
    """Level (8 fraction bits) and noise (6) of one tile in all blocks."""
    rows = min(BLOCK, len(image))
    blocks = max(1, len(image) // BLOCK)
    columns = [np.arange(tables.edge[tile] + row % tables.stride, tables.edge[tile + 1], tables.stride) for row in range(rows)]
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
    x: IntArray, v: IntArray, n: IntArray, level: IntArray, noise: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Level, slope and noise after another block, 12 fraction bits."""
    ahead = level - x - v
    step = np.abs(ahead) > 2 * n
    x = np.where(step, level, np.clip(x + v + (ahead >> 2), 0, _LARGEST_LEVEL << 12))
    v = np.where(step, 0, v + (ahead >> 5))
    changed = (noise > 2 * n) | (2 * noise < n)
    return x, v, np.where(changed, noise, n + ((noise - n) >> 2))


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


def search_rows(image: NDArray[np.uint16], tables: FrontTables) -> Searched:
    """Background, filtered frame and the pixels above the threshold."""
    lines = background_lines(image, tables)
    filtered = np.zeros(image.shape, np.int64)
    above = np.zeros(image.shape, np.bool_)
    reach, (height, width) = len(tables.tap) - 1, image.shape
    inner = (slice(reach, height - reach), slice(reach, width - reach))
    if min(height, width) <= 2 * reach:
        return Searched(lines, filtered, above)
    pixels = image.astype(np.int64)
    kernel = np.concatenate([tables.tap[:0:-1], tables.tap])
    down = sum(tap * pixels[k : height - 2 * reach + k] for k, tap in enumerate(kernel))
    down = (down + 8) >> 4
    filtered[inner] = sum(tap * down[:, k : width - 2 * reach + k] for k, tap in enumerate(kernel))
    limit = ((tables.level_weight * lines.level) >> 16) + ((tables.threshold * lines.noise) >> 8)
    cell = np.searchsorted(tables.knot[1:-1], np.arange(width), side="right")
    step = ((limit[:, 1:] - limit[:, :-1]) * tables.inverse) >> 16
    limits = limit[:, cell] + step[:, cell] * (np.arange(width) - tables.knot[cell])
    above[inner] = (filtered > limits)[inner]
    begins = above.copy()
    begins[:, 1:] &= ~above[:, :-1]
    return Searched(lines, filtered, above & (np.cumsum(begins, axis=1) <= RUNS))


def find_candidates(image: NDArray[np.uint16], searched: Searched, tables: FrontTables) -> Candidates:
    """The highest local maxima above the threshold that are neither one pixel nor part of something extended."""
    filtered, (height, width), reach = searched.filtered, image.shape, len(tables.tap) - 1
    y, x = np.nonzero(searched.above)
    highest = np.ones(len(x), np.bool_)
    for dy, dx in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        ny, nx = np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)
        inside = (y + dy >= reach) & (y + dy < height - reach) & (x + dx >= reach) & (x + dx < width - reach)
        here, other = filtered[y, x], filtered[ny, nx]
        highest &= ~inside | (here > other if (dy, dx) < (0, 0) else here >= other)
    x, y = x[highest], y[highest]
    level, noise = at_columns(searched.lines.level, tables, y, x), at_columns(searched.lines.noise, tables, y, x)
    tall = filtered[y, x] - ((tables.level_weight * level) >> 16)
    peak = (image[y, x].astype(np.int64) << 8) - level
    stamp, inside = _stamps(image, x, y)
    star = (tall > 0) & (stamp[:, HALF - 1 : HALF + 2, HALF - 1 : HALF + 2].max(axis=(1, 2), initial=0) < tables.saturation)
    if tables.share:
        star &= 4 * peak <= ((tables.share * tall) >> 16) + 12 * noise
    border = np.ones((2 * HALF + 1, 2 * HALF + 1), np.bool_)
    border[1:-1, 1:-1] = False
    bright = (stamp << 8) - level[:, None, None] > np.maximum(peak >> 2, 2 * noise)[:, None, None]
    extended = (bright & inside & border).sum(axis=(1, 2)) * _EXTENDED[0] > _EXTENDED[1] * (inside & border).sum(axis=(1, 2))
    kept = np.flatnonzero(star & ~extended)
    kept = kept[np.lexsort((x[kept], y[kept], -tall[kept]))][: tables.pool]
    return Candidates(x[kept], y[kept], tall[kept], level[kept], noise[kept], stamp[kept])


def _stamps(image: NDArray[np.uint16], x: IntArray, y: IntArray) -> tuple[IntArray, BoolArray]:
    """Pixels about positions, (N, 11, 11), and which of them are on the frame."""
    height, width = image.shape
    away = np.arange(-HALF, HALF + 1)
    rows, columns = y[:, None, None] + away[:, None], x[:, None, None] + away
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    values = image[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.int64)
    return np.where(inside, values, 0), inside
