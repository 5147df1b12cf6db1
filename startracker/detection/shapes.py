"""Kernels that look at a candidate's pixels: weighted moments, and what surrounds it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.tiles import select_kth

__all__ = ["SHAPE_COLUMNS", "measure_shapes", "measure_surroundings"]

SHAPE_COLUMNS = 5
"""Columns of `measure_shapes`: variance along the minor and the major axis, their standard error, share of the
brightest pixel, signal-to-noise ratio."""
_RECENTRINGS = 3
_RING_PX = 8
_LARGEST_RADIUS_PX = 12

FloatImage = NDArray[np.float32]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def measure_shapes(
    image: FloatImage,
    level: FloatImage,
    noise: FloatImage,
    xs: IntArray,
    ys: IntArray,
    weight_sigma: float,
) -> FloatArray:
    """Shapes (N, 5) of candidates by moments under a Gaussian weight that follows their centre.

    A Gaussian of variance C seen under a weight of variance W has C W / (C + W) (Kaiser, Squires & Broadhurst 1995);
    this is undone, so that the variances are those of the star image, the pixel's 1/12 included; infinite for what is
    as wide as the weight. NaN where the window holds no signal. The standard error is that of the background's noise.
    """
    height, width = image.shape
    half = max(2, math.ceil(2.0 * weight_sigma))
    w = weight_sigma * weight_sigma
    out = np.full((len(xs), SHAPE_COLUMNS), np.nan)
    weight_x, weight_y = np.empty(2 * half + 1), np.empty(2 * half + 1)
    for index in range(len(xs)):
        x0, y0 = xs[index], ys[index]
        dx, dy = 0.0, 0.0
        sigma = np.float64(noise[y0, x0])
        for attempt in range(_RECENTRINGS):
            for k in range(-half, half + 1):
                weight_x[k + half] = math.exp(-0.5 * (k - dx) ** 2 / w)
                weight_y[k + half] = math.exp(-0.5 * (k - dy) ** 2 / w)
            total, sx, sy, sxx, syy, sxy, plain, highest, norm = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(-half, half + 1):
                for i in range(-half, half + 1):
                    y, x = y0 + j, x0 + i
                    if y < 0 or x < 0 or y >= height or x >= width or not abs(image[y, x]) < np.inf:
                        continue
                    g = weight_x[i + half] * weight_y[j + half]
                    signal = np.float64(image[y, x]) - np.float64(level[y, x])
                    if abs(i) <= 1 and abs(j) <= 1:
                        plain += signal
                        highest = max(highest, signal)
                    signal *= g
                    norm += g * g
                    total += signal
                    sx += signal * i
                    sy += signal * j
                    sxx += signal * i * i
                    syy += signal * j * j
                    sxy += signal * i * j
            if not total > 0.0:
                break
            mx, my = sx / total, sy / total
            if attempt < _RECENTRINGS - 1:
                # under the weight a shift shows at half its size
                dx = min(max(dx + 1.5 * (mx - dx), -1.5), 1.5)
                dy = min(max(dy + 1.5 * (my - dy), -1.5), 1.5)
        if not total > 0.0:
            continue
        vx, vy, vxy = sxx / total - mx * mx, syy / total - my * my, sxy / total - mx * my
        middle, apart = 0.5 * (vx + vy), math.hypot(0.5 * (vx - vy), vxy)
        # noise of a second moment: Σ g² (k² − v)² σ² / S², by the integral over a Gaussian weight
        spread = w * w / 2.0 * 1.5 - w * middle + middle * middle
        error = sigma / total * math.sqrt(max(math.pi * w * spread, 0.0))
        minor, major = max(middle - apart, 0.0), middle + apart
        out[index, 0] = minor * w / (w - minor) if minor < 0.95 * w else np.inf
        out[index, 1] = major * w / (w - major) if major < 0.95 * w else np.inf
        out[index, 2] = error * (w / (w - min(minor, 0.95 * w))) ** 2
        out[index, 3] = highest / plain if plain > 0.0 else np.inf
        out[index, 4] = total / (sigma * math.sqrt(norm))
    return out


@njit(cache=True, error_model="numpy")
def measure_surroundings(
    image: FloatImage, level: FloatImage, xs: IntArray, ys: IntArray, radius: FloatArray
) -> FloatArray:
    """Median of a ring about candidates above the level, and its fourth highest sector above that; shape (N, 2).

    The ring begins 2 px beyond the candidate's radius, is 8 px wide and has eight sectors, whose maxima count. One
    neighbour fills two of them, three with its wings; branches and leaves fill most.
    """
    height, width = image.shape
    out = np.zeros((len(xs), 2))
    side = 2 * (_LARGEST_RADIUS_PX + 3 + _RING_PX) + 1
    sample = np.empty(side * side, np.float32)
    highest = np.empty(8)
    for index in range(len(xs)):
        inner = min(math.ceil(radius[index]), _LARGEST_RADIUS_PX) + 2
        outer = inner + _RING_PX
        x0, y0 = xs[index], ys[index]
        count = 0
        highest[:] = 0.0
        for y in range(max(y0 - outer, 0), min(y0 + outer + 1, height)):
            for x in range(max(x0 - outer, 0), min(x0 + outer + 1, width)):
                i, j = x - x0, y - y0
                distance = i * i + j * j
                if distance <= inner * inner or distance > outer * outer:
                    continue
                value = image[y, x] - level[y, x]
                if abs(value) < np.inf:
                    sample[count] = value
                    count += 1
                    sector = (4 if i > 0 else 0) + (2 if j > 0 else 0) + (1 if abs(i) > abs(j) else 0)
                    highest[sector] = max(highest[sector], np.float64(value))
        if count == 0:
            continue
        out[index, 0] = select_kth(sample, 0, count, count // 2)
        out[index, 1] = max(np.sort(highest)[4] - out[index, 0], 0.0)
    return out
