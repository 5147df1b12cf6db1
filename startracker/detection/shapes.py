"""Shapes of candidates: moments of their pixels under a weight that follows them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.arrays import FloatArray, IntArray
from startracker.detection.plane import Plane
from startracker.detection.values import Image, is_value
from startracker.kernels import kernel, kernel_part

SHAPE_COLUMNS = 5
"""Columns of `measure_shapes`: variance along the minor and the major axis, their standard error, share of the
brightest pixel, signal-to-noise ratio."""
MINOR, MAJOR, MINOR_ERROR, PEAK_SHARE, SHAPE_SNR = range(SHAPE_COLUMNS)
_RECENTRINGS = 3


class Weight(NamedTuple):
    """Gaussian weight of a shape, with working space."""

    variance: float
    centred: FloatArray
    """exp(−k² / 2 variance) for k = 0 … n."""
    space: FloatArray
    """(2 W + 2, W), W = 2 n + 1: signal of the window's pixels, whether they are usable, weights along x and y."""


@kernel_part
def shape_weight(weight_sigma: float) -> Weight:
    """Weight of a width, px, in a window of twice as much to either side."""
    half, variance = max(2, math.ceil(2.0 * weight_sigma)), weight_sigma * weight_sigma
    centred, side = np.empty(half + 1), 2 * half + 1
    for k in range(half + 1):
        centred[k] = math.exp(-0.5 * k * k / variance)
    return Weight(variance, centred, np.empty((2 * side + 2, side)))


@kernel_part
def _shifted_gaussian(centred: FloatArray, shift: float, variance: float, out: FloatArray) -> None:
    """exp(−(k − shift)² / 2 variance) for k = −n … n, from its values for no shift: (k − d)² = k² − 2 k d + d²."""
    half = len(centred) - 1
    out[half] = math.exp(-0.5 * shift * shift / variance)
    ratio = math.exp(shift / variance)
    up, down = out[half], out[half]
    for k in range(1, half + 1):
        up *= ratio
        down /= ratio
        out[half + k], out[half - k] = up * centred[k], down * centred[k]


@kernel_part
def _read_window(
    image: Image, level: Plane, x0: int, y0: int, window: FloatArray, use: FloatArray
) -> tuple[float, float]:
    """Signal about a pixel, and which pixels are of use; the sum and the highest of the nine in the middle."""
    height, width = image.shape
    half, plain, highest = len(window) // 2, 0.0, 0.0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            y, x = y0 + j, x0 + i
            usable = 0 <= y < height and 0 <= x < width and is_value(image[y, x])
            signal = np.float64(image[y, x]) - np.float64(level[y, x]) if usable else 0.0
            window[j + half, i + half] = signal
            use[j + half, i + half] = 1.0 if usable else 0.0
            if abs(i) <= 1 and abs(j) <= 1:
                plain += signal
                highest = max(highest, signal)
    return plain, highest


@kernel
def measure_shape(image: Image, level: Plane, noise: Plane, x0: int, y0: int, weight: Weight, out: FloatArray) -> None:
    """Shape of a candidate, `SHAPE_COLUMNS`, by moments under a Gaussian weight that follows its centre.

    A Gaussian of variance C seen under a weight of variance W has C W / (C + W) (Kaiser, Squires & Broadhurst 1995);
    this is undone, so that the variances are those of the star image, the pixel's 1/12 included; infinite for what is
    as wide as the weight. NaN where the window holds no signal. The standard error is that of the background's noise.
    """
    w, centred, space = weight.variance, weight.centred, weight.space
    half = len(centred) - 1
    side = 2 * half + 1
    window, use, weight_x, weight_y = space[:side], space[side : 2 * side], space[2 * side], space[2 * side + 1]
    plain, highest = _read_window(image, level, x0, y0, window, use)
    dx, dy, mx, my, total = 0.0, 0.0, 0.0, 0.0, 0.0
    sxx, syy, sxy, norm = 0.0, 0.0, 0.0, 0.0
    for column in range(SHAPE_COLUMNS):
        out[column] = np.nan
    for attempt in range(_RECENTRINGS):
        _shifted_gaussian(centred, dx, w, weight_x)
        _shifted_gaussian(centred, dy, w, weight_y)
        total, sx, sy, sxx, syy, sxy, norm = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(-half, half + 1):
            row, row_x, row_xx, row_norm = 0.0, 0.0, 0.0, 0.0
            for i in range(-half, half + 1):
                g = weight_x[i + half]
                signal = g * window[j + half, i + half]
                row_norm += g * g * use[j + half, i + half]
                row += signal
                row_x += signal * i
                row_xx += signal * i * i
            g = weight_y[j + half]
            norm += g * g * row_norm
            total += g * row
            sx += g * row_x
            sy += g * row * j
            sxx += g * row_xx
            syy += g * row * j * j
            sxy += g * row_x * j
        if not total > 0.0:
            return
        mx, my = sx / total, sy / total
        if attempt < _RECENTRINGS - 1:
            # under the weight a shift shows at half its size
            dx = min(max(dx + 1.5 * (mx - dx), -1.5), 1.5)
            dy = min(max(dy + 1.5 * (my - dy), -1.5), 1.5)
    vx, vy, vxy = sxx / total - mx * mx, syy / total - my * my, sxy / total - mx * my
    middle, apart = 0.5 * (vx + vy), math.hypot(0.5 * (vx - vy), vxy)
    # noise of a second moment: Σ g² (k² − v)² σ² / S², by the integral over a Gaussian weight
    sigma, spread = np.float64(noise[y0, x0]), w * w / 2.0 * 1.5 - w * middle + middle * middle
    error = sigma / total * math.sqrt(max(math.pi * w * spread, 0.0))
    minor, major = max(middle - apart, 0.0), middle + apart
    out[MINOR] = minor * w / (w - minor) if minor < 0.95 * w else np.inf
    out[MAJOR] = major * w / (w - major) if major < 0.95 * w else np.inf
    out[MINOR_ERROR] = error * (w / (w - min(minor, 0.95 * w))) ** 2
    out[PEAK_SHARE] = highest / plain if plain > 0.0 else np.inf
    out[SHAPE_SNR] = total / (sigma * math.sqrt(norm))


@kernel
def measure_shapes(
    image: Image, level: Plane, noise: Plane, xs: IntArray, ys: IntArray, weight_sigma: float
) -> FloatArray:
    """Shapes (N, 5) of candidates by moments under a Gaussian weight that follows their centre, see `measure_shape`."""
    weight, out = shape_weight(weight_sigma), np.empty((len(xs), SHAPE_COLUMNS))
    for n in range(len(xs)):
        measure_shape(image, level, noise, xs[n], ys[n], weight, out[n])
    return out
