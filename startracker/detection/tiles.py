"""Kernels of the background: statistics of tiles, their smoothing, their interpolation."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["interpolate_tiles", "select_kth", "smooth_tiles", "tile_statistics"]

_SAMPLES = 400
_QUANTILE = 0.841345
"""One standard deviation above the mean of a normal distribution."""
_CLIP = 3.0
_CLIPPINGS = 3
_CLIPPED_STD = 0.98658
"""Standard deviation of a unit normal distribution cut at ±3: √(1 − 6 φ(3) / (2 Φ(3) − 1))."""


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _clipped(values: NDArray[np.float32], count: int, centre: float, half_width: float) -> tuple[float, float]:
    total, squares, n = 0.0, 0.0, 0
    for i in range(count):
        d = float(values[i]) - centre
        if abs(d) <= half_width:
            total += d
            squares += d * d
            n += 1
    mean = total / n
    return centre + mean, math.sqrt(max(squares / n - mean * mean, 0.0))


@njit(cache=True, error_model="numpy")
def tile_statistics(
    image: NDArray[np.float32], rows: int, columns: int, step: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Clipped mean and standard deviation of each of rows × columns tiles; NaN for one without finite pixels.

    `step` is the digitisation step: the clipping never falls between neighbouring values.
    """
    height, width = image.shape
    level = np.full((rows, columns), np.nan)
    noise = np.full((rows, columns), np.nan)
    size = ((height + rows - 1) // rows) * ((width + columns - 1) // columns)
    stride = max(1, size // _SAMPLES)
    sample = np.empty(size // stride + 2 * ((height + rows - 1) // rows) + 2, np.float32)
    for tile_row in range(rows):
        y0, y1 = tile_row * height // rows, (tile_row + 1) * height // rows
        for tile_column in range(columns):
            x0, x1 = tile_column * width // columns, (tile_column + 1) * width // columns
            count = 0
            for y in range(y0, y1):
                # the start moves from row to row, so that a bad column does not fill the sample
                for x in range(x0 + (y * 5) % stride, x1, stride):
                    value = image[y, x]
                    if abs(value) < np.inf:
                        sample[count] = value
                        count += 1
            if count == 0:
                continue
            half = count // 2
            median = select_kth(sample, 0, count, half)
            # above the median: an image cut off at zero has no spread below it; clipping takes the stars off again
            spread = select_kth(sample, half, count, int(_QUANTILE * count)) - median
            mean, std = median, spread
            for _ in range(_CLIPPINGS):
                width_ = _CLIP * max(std, step * 0.2886751345948129) + 0.5 * step
                mean, std = _clipped(sample, count, median, width_)
                std /= _CLIPPED_STD
            level[tile_row, tile_column] = mean
            noise[tile_row, tile_column] = std
    return level, noise


def smooth_tiles(tiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """3×3 median over tiles; outside, the map goes on linearly, so that a plane stays as it is."""
    padded = np.pad(tiles, 1, mode="edge")
    if tiles.shape[0] > 1:
        padded[0], padded[-1] = 2 * padded[1] - padded[2], 2 * padded[-2] - padded[-3]
    if tiles.shape[1] > 1:
        padded[:, 0] = 2 * padded[:, 1] - padded[:, 2]
        padded[:, -1] = 2 * padded[:, -2] - padded[:, -3]
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, (3, 3)), axis=(2, 3))


@njit(cache=True, error_model="numpy")
def interpolate_tiles(tiles: NDArray[np.float64], height: int, width: int, extrapolate: bool) -> NDArray[np.float32]:
    """Bilinear interpolation between tile centres to (height, width).

    Beyond the outermost centres the map goes on linearly or stays constant.
    """
    rows, columns = tiles.shape
    out = np.empty((height, width), np.float32)
    centre_x = np.empty(columns)
    for c in range(columns):
        centre_x[c] = 0.5 * (c * width // columns + (c + 1) * width // columns - 1)
    line = np.empty(columns)
    row = 0
    for y in range(height):
        y_low, y_high, share = 0.0, 0.0, 0.0
        if rows > 1:
            y_high = 0.5 * ((row + 1) * height // rows + (row + 2) * height // rows - 1)
            while row < rows - 2 and y > y_high:
                row += 1
                y_high = 0.5 * ((row + 1) * height // rows + (row + 2) * height // rows - 1)
            y_low = 0.5 * (row * height // rows + (row + 1) * height // rows - 1)
            share = (y - y_low) / (y_high - y_low)
            if not extrapolate:
                share = min(max(share, 0.0), 1.0)
        for c in range(columns):
            line[c] = tiles[row, c] if rows == 1 else tiles[row, c] + share * (tiles[row + 1, c] - tiles[row, c])
        if columns == 1:
            out[y, :] = line[0]
            continue
        # segment by segment, each a straight line that the compiler vectorises
        for c in range(columns - 1):
            slope = np.float32((line[c + 1] - line[c]) / (centre_x[c + 1] - centre_x[c]))
            base = np.float32(line[c])
            start, stop = math.ceil(centre_x[c]), math.ceil(centre_x[c + 1])
            origin = np.float32(start - centre_x[c])
            for i in range(stop - start):
                out[y, start + i] = base + slope * (origin + np.float32(i))
        first, last = math.ceil(centre_x[0]), math.ceil(centre_x[columns - 1])
        left = (line[1] - line[0]) / (centre_x[1] - centre_x[0]) if extrapolate else 0.0
        right = (line[columns - 1] - line[columns - 2]) / (centre_x[columns - 1] - centre_x[columns - 2])
        right = right if extrapolate else 0.0
        for x in range(first):
            out[y, x] = np.float32(line[0] + left * (x - centre_x[0]))
        for x in range(last, width):
            out[y, x] = np.float32(line[columns - 1] + right * (x - centre_x[columns - 1]))
    return out
