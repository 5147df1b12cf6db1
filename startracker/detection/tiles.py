"""Kernels of the background: statistics of tiles, their smoothing, their interpolation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.values import Image, is_value
from startracker.kernels import kernel, kernel_with

__all__ = ["find_kth", "interpolate_tiles", "select_kth", "smooth_tiles", "tile_statistics", "whole_step"]

Tile = tuple[int, int, int, int]
"""First row, last row + 1, first column, last column + 1."""
_SAMPLES = 400
_QUANTILE = 0.841345
"""One standard deviation above the mean of a normal distribution."""
_CLIP = 3.0
_CLIPPINGS = 3
_ROUNDING = 1.0 / math.sqrt(12.0)
"""Standard deviation of rounding to whole steps."""
_SHIFT = 5
_FARTHEST = 2.0**20
"""Steps from one tile's quantile beyond which the next one's is not looked for."""
_LARGEST_WHOLE = 2.0**31
_CLIPPED_STD = 0.98658
"""Standard deviation of a unit normal distribution cut at ±3: √(1 − 6 φ(3) / (2 Φ(3) − 1))."""


@kernel
def select_kth(values: NDArray[np.float32], start: int, stop: int, k: int) -> float:
    """Value at place k if values[start:stop] were sorted; reorders them, none before k larger (Hoare 1961)."""
    left, right = start, stop - 1
    while left < right:
        # median of three keeps sorted and constant tiles from going quadratic
        middle = (left + right) // 2
        a, b, c = values[left], values[middle], values[right]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = left, right
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            right = j
        elif k >= i:
            left = i
        else:
            break
    return float(values[k])


@kernel
def whole_step(values: NDArray[np.float32]) -> int:
    """Greatest common divisor of the differences of whole numbers; 1 where all are the same, 0 where one is not whole.

    Values that are not finite are left out; without any other, or beyond 2³¹, the answer is 0.
    """
    divisor, first, count = 0, 0, 0
    for i in range(len(values)):
        value = values[i]
        if not abs(value) < np.inf:
            continue
        if not abs(value) < _LARGEST_WHOLE or value != np.rint(value):
            return 0
        whole = int(value)
        if count == 0:
            first = whole
        count += 1
        if divisor != 1:
            rest = abs(whole - first)
            while rest:
                divisor, rest = rest, divisor % rest
    return max(divisor, 1) if count else 0


@kernel
def find_kth(values: NDArray[np.float32], count: int, k: int, step: float, near: float) -> float:
    """Value at place k if values[:count] were sorted, looked for on a lattice of width `step` through `near`.

    Not a number where no value of the lattice is it. From tile to tile it moves by a step or two, which makes counting
    what is lower and what is not higher, at many places at once, faster than any sorting.
    """
    low, high, place, stride = -np.inf, np.inf, near, step
    while high - low > 1.5 * step:
        value, lower, not_higher = np.float32(place), np.int32(0), np.int32(0)
        for i in range(np.uint64(count)):
            lower = np.int32(lower + np.int32(values[i] < value))
            not_higher = np.int32(not_higher + np.int32(values[i] <= value))
        if lower <= k < not_higher:
            return float(value)
        if k < lower:
            high = place
        else:
            low = place
        if abs(high - low) < np.inf:
            place = low + step * np.rint(0.5 * (high - low) / step)
            if not low < place < high:  # too large for its step to be told
                break
        elif stride > step * _FARTHEST:
            break
        else:
            place += stride if k >= not_higher else -stride
            stride *= 2.0
    return np.nan


# whole numbers, and what lies on a lattice, have the same sums in any order
@kernel_with(fastmath={"reassoc", "nsz"})
def _clipped(values: NDArray[np.float32], count: int, centre: float, half_width: float) -> tuple[float, float, int]:
    """Mean and standard deviation of the values within a half width of a centre, and how many these are."""
    total, squares, n = 0.0, 0.0, 0
    for i in range(np.uint64(count)):
        d = np.float64(values[i]) - centre
        kept = d if abs(d) <= half_width else 0.0
        total += kept
        squares += kept * kept
        n += int(abs(d) <= half_width)
    mean = total / n
    return centre + mean, math.sqrt(max(squares / n - mean * mean, 0.0)), n


@kernel
def _clip(spread: float, step: float) -> float:
    """Half width of the clipping; it never falls between neighbouring values."""
    return _CLIP * max(spread, step * _ROUNDING) + 0.5 * step


@kernel
def _take_sample(image: Image, tile: Tile, stride: int, sample: NDArray[np.float32]) -> int:
    """Every so manyth pixel of a tile's rows, and how many are finite; each row begins farther than the one before.

    So a bad column does not fill the sample.
    """
    y0, y1, x0, x1 = tile
    # numbers without a sign as indices: a signed one may be negative, which costs a comparison each time
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
    return int(np.int64(used))  # a signed number, as callers count with


@kernel
def tile_statistics(
    image: Image, rows: int, columns: int, step: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Clipped mean and standard deviation of each of rows × columns tiles; NaN for one without finite pixels.

    `step` is the digitisation step: the clipping never falls between neighbouring values, and the quantiles of values
    that are multiples of it are found faster.
    """
    height, width = image.shape
    level = np.full((rows, columns), np.nan)
    noise = np.full((rows, columns), np.nan)
    size = ((height + rows - 1) // rows) * ((width + columns - 1) // columns)
    stride = max(1, size // _SAMPLES)
    sample = np.empty(size // stride + 2 * ((height + rows - 1) // rows) + 2, np.float32)
    median = upper = np.nan
    for tile_row in range(rows):
        y0, y1 = tile_row * height // rows, (tile_row + 1) * height // rows
        for tile_column in range(columns):
            x0, x1 = tile_column * width // columns, (tile_column + 1) * width // columns
            count = _take_sample(image, (y0, y1, x0, x1), stride, sample)
            if count == 0:
                continue
            half, high = count // 2, int(_QUANTILE * count)
            if step > 0.0:
                median = find_kth(sample, count, half, step, median)
                upper = find_kth(sample, count, high, step, upper)
            if not step > 0.0 or math.isnan(median) or math.isnan(upper):
                median = select_kth(sample, 0, count, half)
                # above the median: an image cut off at zero has no spread below it; clipping takes the stars off again
                upper = select_kth(sample, half, count, high)
            mean, std, before = median, upper - median, -1
            for _ in range(_CLIPPINGS):
                mean, std, kept = _clipped(sample, count, median, _clip(std, step))
                std /= _CLIPPED_STD
                if kept == before:  # the same ones, as all lie about the median
                    break
                before = kept
            level[tile_row, tile_column], noise[tile_row, tile_column] = mean, std
    return level, noise


@kernel
def _middle(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


@kernel
def smooth_tiles(tiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """3×3 median over tiles; outside, the map goes on linearly, so that a plane stays as it is."""
    rows, columns = tiles.shape
    padded = np.empty((rows + 2, columns + 2))
    above, below, left, right = min(1, rows - 1), max(rows - 2, 0), min(2, columns), max(columns - 1, 1)
    for c in range(columns):
        for r in range(rows):
            padded[r + 1, c + 1] = tiles[r, c]
        padded[0, c + 1] = 2.0 * tiles[0, c] - tiles[above, c]
        padded[rows + 1, c + 1] = 2.0 * tiles[rows - 1, c] - tiles[below, c]
    for r in range(rows + 2):
        padded[r, 0] = 2.0 * padded[r, 1] - padded[r, left]
        padded[r, columns + 1] = 2.0 * padded[r, columns] - padded[r, right]
    # the median of nine is that of the largest least, the middle middle and the least largest of its rows sorted
    low, middle, high = np.empty((rows + 2, columns)), np.empty((rows + 2, columns)), np.empty((rows + 2, columns))
    for r in range(rows + 2):
        for c in range(columns):
            a, b, d = padded[r, c], padded[r, c + 1], padded[r, c + 2]
            low[r, c], middle[r, c], high[r, c] = min(a, b, d), _middle(a, b, d), max(a, b, d)
    out = np.empty((rows, columns))
    for r in range(rows):
        for c in range(columns):
            out[r, c] = _middle(
                max(low[r, c], low[r + 1, c], low[r + 2, c]),
                _middle(middle[r, c], middle[r + 1, c], middle[r + 2, c]),
                min(high[r, c], high[r + 1, c], high[r + 2, c]),
            )
    return out


@kernel
def _cells(tiles: int, size: int, extrapolate: bool) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Lower of the two tiles between whose centres each pixel of an axis lies, and how far it is to the upper one."""
    cell, share = np.zeros(size, np.int64), np.zeros(size)
    for k in range(tiles - 1):
        low = 0.5 * (k * size // tiles + (k + 1) * size // tiles - 1)
        high = 0.5 * ((k + 1) * size // tiles + (k + 2) * size // tiles - 1)
        first = 0 if k == 0 else math.ceil(low)
        for i in range(first, size if k == tiles - 2 else math.ceil(high)):
            cell[i], share[i] = k, (i - low) / (high - low)
    for i in range(size):
        if not extrapolate:
            share[i] = min(max(share[i], 0.0), 1.0)
    return cell, share


def interpolate_tiles(tiles: NDArray[np.float64], height: int, width: int, extrapolate: bool) -> Plane:
    """Bilinear interpolation between tile centres to (height, width).

    Beyond the outermost centres the map goes on linearly or stays constant.
    """
    return Plane(*_interpolate(tiles, height, width, extrapolate))


@kernel
def _interpolate(
    tiles: NDArray[np.float64], height: int, width: int, extrapolate: bool
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]:
    rows, columns = tiles.shape
    cell_y, share_y = _cells(rows, height, extrapolate)
    cell_x, share_x = _cells(columns, width, extrapolate)
    lines = np.empty((rows, width), np.float32)
    first = 0
    while first < width:
        # the pixels between two centres
        k, last = cell_x[first], first + 1
        while last < width and cell_x[last] == k:
            last += 1
        share = share_x[first:last]
        for r in range(rows):
            left, line = tiles[r, k], lines[r, first:last]
            step = tiles[r, min(k + 1, columns - 1)] - left
            for i in range(len(share)):
                line[i] = left + share[i] * step
        first = last
    return lines, cell_y, share_y.astype(np.float32)
