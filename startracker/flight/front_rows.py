"""Integer reference of the front end's search: matched filter, threshold, candidates. See `front_end`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import BoolArray, IntArray
from startracker.flight.front_background import Lines, at_columns, background_lines
from startracker.flight.front_tables import HALF, HOT, RUNS, TRAIL_RUNS, FrontTables

_CORE = 2
"""Half side of the pixels of which not all may be saturated: what is left of a stamp is too little for a fit."""
_EXTENDED = 20, 7
"""A candidate is part of something extended if 7/20 of the border of its stamp are bright."""


class Searched(NamedTuple):
    """What was found in a frame, for the next stages."""

    pixels: IntArray
    """(H, W): Pixel values, hot pixels bridged."""
    lines: Lines
    filtered: IntArray
    """(H, W): 0 where the filter reaches beyond the frame."""
    above: BoolArray
    """(H, W): Pixels above the threshold."""
    low: BoolArray
    """(H, W): Pixels above half of it."""


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
    """(N, 11, 11): Pixels about it, without the slope of the background; 0 beyond the frame."""

    def take(self, index: IntArray) -> Candidates:
        """The candidates of an index."""
        return Candidates(*(column[index] for column in self))


def bridge_impulses(pixels: IntArray, lines: Lines, tables: FrontTables) -> IntArray:
    """Pixels with the hot ones replaced by the fourth lowest of their eight neighbours.

    A hot pixel stands 5σ above the background and has at most two neighbours with more than 0.15 of its signal, as of
    `startracker.detection.artefacts`. Pixels at the frame's border, and more than `HOT` in a row, are left as they are.
    """
    height, width = pixels.shape
    if not tables.share or min(height, width) < 3:
        return pixels
    knots = lines.level + 5 * lines.noise
    cell = np.searchsorted(tables.knot[1:-1], np.arange(width), side="right")
    step = ((knots[:, 1:] - knots[:, :-1]) * tables.inverse) >> 12
    limit = (knots[:, cell] << 4) + step[:, cell] * (np.arange(width) - tables.knot[cell])
    y, x = np.nonzero((pixels[1:-1, 1:-1] << 12) > limit[1:-1, 1:-1])
    y, x = y + 1, x + 1
    around = np.sort([pixels[y + j, x + i] for j in (-1, 0, 1) for i in (-1, 0, 1) if (i, j) != (0, 0)], axis=0)
    level = at_columns(lines.level, tables, y, x)
    third = (around[5] << 8) - level
    hot = 20 * third <= 3 * ((pixels[y, x] << 8) - level)
    y, x, value = y[hot], x[hot], around[3][hot]
    first = np.searchsorted(y, np.arange(height))
    kept = np.arange(len(y)) - first[y] < HOT
    out = pixels.copy()
    out[y[kept], x[kept]] = value[kept]
    return out


def search_rows(image: NDArray[np.uint16], tables: FrontTables) -> Searched:
    """Background, filtered frame and the pixels above the threshold."""
    lines = background_lines(image, tables)
    pixels = bridge_impulses(image.astype(np.int64), lines, tables)
    filtered = np.zeros(image.shape, np.int64)
    above, low = np.zeros((2, *image.shape), np.bool_)
    reach, (height, width) = len(tables.tap) - 1, image.shape
    inner = (slice(reach, height - reach), slice(reach, width - reach))
    if min(height, width) <= 2 * reach:
        return Searched(pixels, lines, filtered, above, low)
    kernel = np.concatenate([tables.tap[:0:-1], tables.tap])
    down = sum(tap * pixels[k : height - 2 * reach + k] for k, tap in enumerate(kernel))
    down = (down + 8) >> 4
    filtered[inner] = sum(tap * down[:, k : width - 2 * reach + k] for k, tap in enumerate(kernel))
    cell = np.searchsorted(tables.knot[1:-1], np.arange(width), side="right")
    for threshold, over in ((tables.threshold, above), (tables.threshold >> 1, low)):
        limit = ((tables.level_weight * lines.level) >> 16) + ((threshold * lines.noise) >> 8)
        step = ((limit[:, 1:] - limit[:, :-1]) * tables.inverse) >> 16
        limits = limit[:, cell] + step[:, cell] * (np.arange(width) - tables.knot[cell])
        over[inner] = (filtered > limits)[inner]
    return Searched(pixels, lines, filtered, _first_runs(above, RUNS), _first_runs(low, TRAIL_RUNS))


def _first_runs(above: BoolArray, most: int) -> BoolArray:
    """Pixels of the first runs of each row."""
    begins = above.copy()
    begins[:, 1:] &= ~above[:, :-1]
    return np.asarray(above & (np.cumsum(begins, axis=1) <= most))


def find_candidates(searched: Searched, tables: FrontTables) -> Candidates:
    """Local maxima above the threshold that are neither one pixel nor part of something extended."""
    image, filtered, reach = searched.pixels, searched.filtered, len(tables.tap) - 1
    height, width = image.shape
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
    peak = (image[y, x] << 8) - level
    stamp, inside = _stamps(image, x, y)
    core = stamp[:, HALF - _CORE : HALF + _CORE + 1, HALF - _CORE : HALF + _CORE + 1]
    star = (tall > 0) & (core.min(axis=(1, 2), initial=65535) < tables.saturation)
    if tables.share:
        star &= (image[y, x] >= tables.saturation) | (4 * peak <= ((tables.share * tall) >> 16) + 12 * noise)
    border = np.ones((2 * HALF + 1, 2 * HALF + 1), np.bool_)
    border[1:-1, 1:-1] = False
    bright = (stamp << 8) - level[:, None, None] > np.maximum(peak >> 2, 2 * noise)[:, None, None]
    extended = (bright & inside & border).sum(axis=(1, 2)) * _EXTENDED[0] > _EXTENDED[1] * (inside & border).sum(
        axis=(1, 2)
    )
    kept = np.flatnonzero(star & ~extended)
    kept = kept[np.lexsort((x[kept], y[kept], -tall[kept]))]
    even = _without_slope(stamp, inside, (x, y), searched.lines, tables)
    return Candidates(x[kept], y[kept], tall[kept], level[kept], noise[kept], even[kept])


def _without_slope(
    stamp: IntArray, inside: BoolArray, middle: tuple[IntArray, IntArray], lines: Lines, tables: FrontTables
) -> IntArray:
    """Stamps as on the level of their middle pixels (x, y), to whole DN; pixels remain saturated, or not."""
    (x, y), away = middle, np.arange(-HALF, HALF + 1)
    cell = np.searchsorted(tables.knot[1:-1], x, side="right")
    across = ((lines.level[y, cell + 1] - lines.level[y, cell]) * tables.inverse[cell]) >> 16
    down = at_columns(lines.slope, tables, y, x)
    rise = (across[:, None, None] * away + down[:, None, None] * away[:, None] + 128) >> 8
    even = np.clip(stamp - rise, 0, min(tables.saturation - 1, 65535))
    return np.where(inside & (stamp < tables.saturation), even, stamp)


def _stamps(image: IntArray, x: IntArray, y: IntArray) -> tuple[IntArray, BoolArray]:
    """Pixels about positions, (N, 11, 11), and which of them are on the frame."""
    height, width = image.shape
    away = np.arange(-HALF, HALF + 1)
    rows, columns = y[:, None, None] + away[:, None], x[:, None, None] + away
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    values = image[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    return np.where(inside, values, 0), inside
