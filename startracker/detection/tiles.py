"""Statistics of the background in tiles, and maps interpolated from them on demand."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part, kernel_with
from startracker.core import FloatArray
from startracker.detection.values import Image, is_value
from startracker.sorting import ranked

FloatImage = NDArray[np.float32]

_ROWS_AT_ONCE = 64


class Plane(NamedTuple):
    """A map (H, W) that is linear along y between lines; kernels index it like an array: ``plane[y, x]``.

    Parameters
    ----------
    lines : float32 array, shape (L, W)
        Values along lines of the image.
    cell : int array, shape (H,)
        Index of the line above each row.
    share : float32 array, shape (H,)
        Position of each row between that line (0) and the next (1); the map is extrapolated linearly outside 0 to 1.
    """

    lines: FloatImage
    cell: NDArray[np.int64]
    share: FloatImage

    def __getitem__(self, pixel: Any) -> Any:
        """Values at pixels (y, x): integers, arrays of them, or an open grid (`numpy.ix_`)."""
        y, x = pixel
        cell = self.cell[y]
        upper = self.lines[cell, x]
        return upper + self.share[y] * (self.lines[np.minimum(cell + 1, len(self.lines) - 1), x] - upper)


def as_plane(values: FloatImage) -> Plane:
    """A plane with one line for each row of a map (H, W)."""
    return Plane(values, np.arange(len(values)), np.zeros(len(values), np.float32))


@overload(operator.getitem)
def _plane_getitem(plane: Any, pixel: Any) -> Callable[..., Any] | None:
    """``plane[y, x]`` in kernels."""
    if isinstance(plane, types.BaseNamedTuple) and plane.instance_class is Plane and isinstance(pixel, types.UniTuple):

        def value_at(plane: Any, pixel: Any) -> Any:
            y, x = pixel
            cell = plane.cell[y]
            upper = plane.lines[cell, x]
            return upper + plane.share[y] * (plane.lines[min(cell + 1, plane.lines.shape[0] - 1), x] - upper)

        return value_at
    return None


def sample_plane(plane: Plane, step_y: int, step_x: int) -> FloatImage:
    """Values of every `step_y`-th row and `step_x`-th column, flat."""
    lines, cell, share = plane.lines[:, ::step_x], plane.cell[::step_y], plane.share[::step_y, None]
    upper, lower = lines.take(cell, axis=0), lines.take(np.minimum(cell + 1, len(lines) - 1), axis=0)
    values: FloatImage = (upper + share * (lower - upper)).ravel()
    return values


def fill_plane(plane: Plane) -> FloatImage:
    """The whole map, shape (H, W)."""
    height, width = len(plane.cell), plane.lines.shape[1]
    out = np.empty((height, width), np.float32)
    for first in range(0, height, _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        out[rows] = sample_plane(Plane(plane.lines, plane.cell[rows], plane.share[rows]), 1, 1).reshape(-1, width)
    return out


Tile = tuple[int, int, int, int]
"""First row, last row + 1, first column, last column + 1."""
_SAMPLES = 400
_QUANTILES = (0.5, 0.841345)
"""Quantiles: the median, and one standard deviation above the mean of a Gaussian."""
_CLIP = 3.0
_CLIPPINGS = 3
_ROUNDING = 1.0 / math.sqrt(12.0)
"""Standard deviation of rounding to whole steps."""
_SHIFT = 5
_FARTHEST = 2.0**20
"""Distance, in steps, from the quantile of the previous tile beyond which that of the next is not searched for."""
_LARGEST_WHOLE = 2.0**31
_FEW_VALUES = 64
_CLIPPED_STD = 0.98658
"""Standard deviation of a unit Gaussian truncated at ±3: √(1 − 6 φ(3) / (2 Φ(3) − 1))."""


def whole_step(values: NDArray[Any]) -> int:
    """Greatest common divisor of the differences of integers; 1 if all are equal, 0 if a value is not an integer.

    Values that are not finite are ignored; the result is 0 if there are no others, or for values beyond 2³¹.
    """
    if values.dtype.kind == "f":
        values = values[np.isfinite(values)]
        if np.any(values != np.rint(values)) or np.any(np.abs(values) >= _LARGEST_WHOLE):
            return 0
    if not len(values):
        return 0
    # Most images have a step of 1, which a few values reveal.
    for some in (values[:_FEW_VALUES], values):
        step = int(np.gcd.reduce(some.astype(np.int64) - int(values[0])))
        if step == 1:
            break
    return max(step, 1)


@kernel
def find_kth(values: NDArray[np.float32], count: int, k: int, step: float, near: float) -> float:
    """The k-th smallest of values[:count], searched for on a lattice of width `step` through `near`.

    NaN if the value is not on the lattice. From one tile to the next it moves by a step or two, so counting the values
    below and up to a trial value, which is vectorised, is faster than sorting.
    """
    low, high, trial, stride = -np.inf, np.inf, near, step
    while high - low > 1.5 * step:
        value, lower, not_higher = np.float32(trial), np.int32(0), np.int32(0)
        for i in range(np.uint64(count)):
            lower = np.int32(lower + np.int32(values[i] < value))
            not_higher = np.int32(not_higher + np.int32(values[i] <= value))
        if lower <= k < not_higher:
            return float(value)
        if k < lower:
            high = trial
        else:
            low = trial
        # Bisect once the value is enclosed; until then double the stride away from the starting point.
        if abs(high - low) < np.inf:
            trial = low + step * np.rint(0.5 * (high - low) / step)
            if not low < trial < high:  # float32 does not resolve the step
                break
        elif stride > step * _FARTHEST:
            break
        else:
            trial += stride if k >= not_higher else -stride
            stride *= 2.0
    return np.nan


@kernel_part
def _clipped(values: NDArray[np.float32], count: int, centre: float, half_width: float) -> tuple[float, float, int]:
    """Mean and standard deviation of the values within `half_width` of `centre`, and their number."""
    total, squares, n = 0.0, 0.0, 0
    for i in range(np.uint64(count)):
        d = np.float64(values[i]) - centre
        kept = d if abs(d) <= half_width else 0.0
        total += kept
        squares += kept * kept
        n += int(abs(d) <= half_width)
    mean = total / n
    return centre + mean, math.sqrt(max(squares / n - mean * mean, 0.0)), n


@kernel_part
def _clip(spread: float, step: float) -> float:
    """Half width of the clipping, which is never so narrow that it falls between neighbouring values."""
    return _CLIP * max(spread, step * _ROUNDING) + 0.5 * step


@kernel
def _take_sample(image: Image, tile: Tile, stride: int, sample: NDArray[np.float32]) -> int:
    """Sample every `stride`-th pixel of each row of a tile; returns the number of finite ones.

    Each row begins `_SHIFT` pixels later than the one before, so that a bad column cannot fill the sample.
    """
    y0, y1, x0, x1 = tile
    # Unsigned indices, because numba compares signed ones with zero each time.
    first, stop, pace = np.uint64(x0), np.uint64(x1), np.uint64(stride)
    shift, start, used = np.uint64(_SHIFT % stride), np.uint64(x0 + y0 * _SHIFT % stride), np.uint64(0)
    for y in range(np.uint64(y0), np.uint64(y1)):
        x = start
        while x < stop:
            sample[used] = image[y, x]
            used += np.uint64(is_value(image[y, x]))
            x += pace
        start += shift
        start -= pace if start >= first + pace else np.uint64(0)
    return int(np.int64(used))  # signed, for the arithmetic of the callers


def tile_statistics(image: Image, rows: int, columns: int, step: float) -> FloatArray:
    """Clipped mean and standard deviation (2, rows, columns) of the pixels of each tile; NaN without finite pixels.

    `step` is the digitisation step: the clipping limits never fall between neighbouring values, and quantiles of values
    that are multiples of the step are found faster.
    """
    tile_rows, tile_columns = -(-image.shape[0] // rows), -(-image.shape[1] // columns)
    stride = max(1, tile_rows * tile_columns // _SAMPLES)
    sample = np.empty(tile_rows * tile_columns // stride + 2 * tile_rows + 2, np.float32)
    statistics = np.full((2, rows, columns), np.nan)
    _fill_statistics(image, stride, step, sample, np.full(len(_QUANTILES), np.nan), statistics)
    return statistics


# "reassoc" allows vectorised sums. Integers, and values on a lattice, have the same sum in any order.
@kernel_with(fastmath={"reassoc", "nsz"})
def _fill_statistics(
    image: Image, stride: int, step: float, sample: NDArray[np.float32], quantiles: FloatArray, statistics: FloatArray
) -> None:
    """Fill the statistics of `tile_statistics`; `quantiles` is working space, initially NaN."""
    height, width = image.shape
    rows, columns = statistics.shape[1], statistics.shape[2]
    for tile_row in range(rows):
        y0, y1 = tile_row * height // rows, (tile_row + 1) * height // rows
        for tile_column in range(columns):
            x0, x1 = tile_column * width // columns, (tile_column + 1) * width // columns
            count = _take_sample(image, (y0, y1, x0, x1), stride, sample)
            if count == 0:
                continue
            for k in range(len(_QUANTILES)):
                rank = int(_QUANTILES[k] * count)
                if step > 0.0:
                    quantiles[k] = find_kth(sample, count, rank, step, quantiles[k])
                if not step > 0.0 or math.isnan(quantiles[k]):
                    quantiles[k] = ranked(sample[:count], rank)[0]
            # The spread is measured above the median, because an image cut off at zero has none below it; the clipping
            # then removes the stars.
            median, before = quantiles[0], -1
            mean, std = median, quantiles[1] - median
            for _ in range(_CLIPPINGS):
                mean, std, kept = _clipped(sample, count, median, _clip(std, step))
                std /= _CLIPPED_STD
                if kept == before:  # the same values, as the intervals are concentric
                    break
                before = kept
            statistics[0, tile_row, tile_column], statistics[1, tile_row, tile_column] = mean, std


def smooth_tiles(tiles: FloatArray) -> FloatArray:
    """3 × 3 median over tiles (…, R, C).

    Beyond the border the map is extrapolated linearly, so that a plane is unchanged.
    """
    rows, columns = tiles.shape[-2:]
    out = np.empty(tiles.shape)
    _smooth(tiles.reshape(-1, rows, columns), np.empty((rows + 2, columns + 2)), out.reshape(-1, rows, columns))
    return out


@kernel
def _smooth(tiles: FloatArray, padded: FloatArray, out: FloatArray) -> None:
    rows, columns = tiles.shape[1], tiles.shape[2]
    for n in range(len(tiles)):
        for r in range(rows):
            for c in range(columns):
                padded[r + 1, c + 1] = tiles[n, r, c]
        for side in range(2):  # the border is extrapolated from the two nearest lines
            border, near, inwards = side * (rows + 1), 1 + side * (rows - 1), (1 - 2 * side) * min(1, rows - 1)
            for c in range(1, columns + 1):
                padded[border, c] = 2.0 * padded[near, c] - padded[near + inwards, c]
        for side in range(2):
            border, near, inwards = side * (columns + 1), 1 + side * (columns - 1), (1 - 2 * side) * min(1, columns - 1)
            for r in range(rows + 2):
                padded[r, border] = 2.0 * padded[r, near] - padded[r, near + inwards]
        for r in range(rows):
            for c in range(columns):
                # The median of 3 × 3 values is the median of three: the largest minimum, the median of the medians, and
                # the smallest maximum of the rows.
                low, high, first, second, third = -np.inf, np.inf, 0.0, 0.0, 0.0
                for j in range(r, r + 3):
                    a, b, d = padded[j, c], padded[j, c + 1], padded[j, c + 2]
                    low, high = max(low, min(a, b, d)), min(high, max(a, b, d))
                    first, second, third = second, third, _middle(a, b, d)
                out[n, r, c] = _middle(low, _middle(first, second, third), high)


@kernel_part
def _middle(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


@lru_cache(maxsize=16)
def _cells(tiles: int, size: int, extrapolate: bool) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Position of each pixel of an axis between the centres of tiles.

    Returns the index of the lower tile (size,), the first pixel of each tile and the end, and the distance to the upper
    centre as a share of the spacing (size,).
    """
    if tiles == 1:
        return np.zeros(size, np.int64), np.array([0, size]), np.zeros(size)
    k = np.arange(tiles)
    centre, pixel = 0.5 * (k * size // tiles + (k + 1) * size // tiles - 1), np.arange(size)
    cell = np.clip(np.searchsorted(centre, pixel, side="right") - 1, 0, tiles - 2)
    share = (pixel - centre[cell]) / (centre[cell + 1] - centre[cell])
    return cell, np.searchsorted(cell, k), share if extrapolate else np.clip(share, 0.0, 1.0)


def interpolate_tiles(tiles: FloatArray, height: int, width: int, extrapolate: bool) -> Plane:
    """Bilinear interpolation between tile centres to (height, width).

    Beyond the outermost centres the map continues linearly or stays constant.
    """
    rows, columns = tiles.shape
    cell, _, share = _cells(rows, height, extrapolate)
    lines = np.empty((rows, width), np.float32)
    _interpolate(tiles, *_cells(columns, width, extrapolate)[1:], lines)
    return Plane(lines, cell, share.astype(np.float32))


@kernel
def _interpolate(tiles: FloatArray, first: NDArray[np.int64], share: FloatArray, lines: NDArray[np.float32]) -> None:
    for r in range(len(tiles)):
        for cell in range(len(first) - 1):
            left = tiles[r, cell]
            rise = tiles[r, min(cell + 1, tiles.shape[1] - 1)] - left
            for x in range(np.uint64(first[cell]), np.uint64(first[cell + 1])):
                lines[r, x] = left + share[x] * rise
