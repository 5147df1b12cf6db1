"""Shapes of candidates: moments of their pixels under a Gaussian weight that is centred on them iteratively."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, IntArray
from startracker.detection.tiles import Plane
from startracker.detection.values import Image, is_value

SHAPE_COLUMNS = 5
"""Number of columns of `measure_shapes`: variance along the minor and the major axis, px², the standard error of the
former, share of the brightest pixel, signal-to-noise ratio."""
MINOR, MAJOR, MINOR_ERROR, PEAK_SHARE, SHAPE_SNR = range(SHAPE_COLUMNS)
_RECENTRINGS = 3


class Weight(NamedTuple):
    """Gaussian weight under which shapes are measured, with working space."""

    variance: float
    centred: FloatArray
    """exp(−k² / 2 variance) for k = 0 … n."""
    space: FloatArray
    """Working space (2 W + 2, W), W = 2 n + 1: signal of the window's pixels, whether they are usable, weights along x
    and y."""


def measure_shapes(
    image: Image, level: Plane, noise: Plane, xs: IntArray, ys: IntArray, weight_sigma: float
) -> FloatArray:
    """Shapes (N, 5) of candidates, `SHAPE_COLUMNS`, from moments under a Gaussian weight centred on each of them.

    A Gaussian of variance C measured under a weight of variance W has a variance of C W / (C + W) (Kaiser, Squires &
    Broadhurst 1995). This is inverted, so that the variances are those of the star image, including the pixel's 1/12
    px²; they are infinite for an image as wide as the weight, and NaN where the window has no signal. The standard
    error is due to the noise of the background.
    """
    return shapes_at(image, level, noise, np.column_stack([xs, ys]), weight_sigma)


def shapes_at(image: Image, level: Plane, noise: Plane, pixels: IntArray, weight_sigma: float) -> FloatArray:
    """`measure_shapes` for candidates at pixels (N, 2), x and y."""
    half, variance = max(2, math.ceil(2.0 * weight_sigma)), weight_sigma**2
    out = np.full((len(pixels), SHAPE_COLUMNS), np.nan)
    centred = np.array([math.exp(-0.5 * k * k / variance) for k in range(half + 1)])
    weight = Weight(variance, centred, np.empty((4 * half + 4, 2 * half + 1)))
    _measure(image, level, noise, pixels, weight, out)
    return out


@kernel_part
def _shifted_gaussian(centred: FloatArray, shift: float, variance: float, out: FloatArray) -> None:
    """exp(−(k − shift)² / 2 variance) for k = −n … n, from its values without a shift.

    By (k − d)² = k² − 2 k d + d² the shift is a factor that grows geometrically with k, which needs only two
    exponentials.
    """
    half = len(centred) - 1
    out[half] = math.exp(-0.5 * shift * shift / variance)
    ratio = math.exp(shift / variance)
    up, down = out[half], out[half]
    for k in range(1, half + 1):
        up *= ratio
        down /= ratio
        out[half + k], out[half - k] = up * centred[k], down * centred[k]


@kernel
def _read_window(
    image: Image, level: Plane, x0: int, y0: int, window: FloatArray, use: FloatArray
) -> tuple[float, float]:
    """Read the signal around a pixel and mark usable pixels; returns sum and maximum of the central 3 × 3 pixels."""
    height, width = image.shape
    half = len(window) // 2
    plain = highest = 0.0
    for j in range(len(window)):
        for i in range(len(window)):
            y, x = y0 - half + j, x0 - half + i
            window[j, i] = use[j, i] = 0.0
            if 0 <= y < height and 0 <= x < width and is_value(image[y, x]):
                signal = np.float64(image[y, x]) - np.float64(level[y, x])
                window[j, i], use[j, i] = signal, 1.0
                if abs(i - half) <= 1 and abs(j - half) <= 1:
                    plain += signal
                    highest = max(highest, signal)
    return plain, highest


@kernel
def _measure(image: Image, level: Plane, noise: Plane, pixels: IntArray, weight: Weight, shapes: FloatArray) -> None:
    """Shapes (N, 5) of candidates at pixels x, y (N, 2): see `measure_shapes`."""
    w, centred = weight.variance, weight.centred
    half, side = len(centred) - 1, 2 * len(centred) - 1
    window, use = weight.space[:side], weight.space[side : 2 * side]
    weight_x, weight_y = weight.space[2 * side], weight.space[2 * side + 1]
    for n in range(len(pixels)):
        plain, highest = _read_window(image, level, pixels[n, 0], pixels[n, 1], window, use)
        dx = dy = mx = my = total = sxx = syy = sxy = norm = 0.0
        for _ in range(_RECENTRINGS):
            _shifted_gaussian(centred, dx, w, weight_x)
            _shifted_gaussian(centred, dy, w, weight_y)
            total = sx = sy = sxx = syy = sxy = norm = 0.0
            for j in range(side):
                row = row_x = row_xx = row_norm = 0.0
                for i in range(side):
                    g, u = weight_x[i], i - half
                    signal = g * window[j, i]
                    row_norm += g * g * use[j, i]
                    row += signal
                    row_x += signal * u
                    row_xx += signal * u * u
                g, v = weight_y[j], j - half
                norm += g * g * row_norm
                total += g * row
                sx += g * row_x
                sy += g * row * v
                sxx += g * row_xx
                syy += g * row * v * v
                sxy += g * row_x * v
            if not total > 0.0:
                break
            mx, my = sx / total, sy / total
            # A star of the width of the weight, displaced by d, has its weighted mean at d/2: hence a step larger than
            # the mean. The centre may not leave the brightest pixel and its neighbours.
            dx = min(max(dx + 1.5 * (mx - dx), -1.5), 1.5)
            dy = min(max(dy + 1.5 * (my - dy), -1.5), 1.5)
        if not total > 0.0:
            continue
        vx, vy, vxy = sxx / total - mx * mx, syy / total - my * my, sxy / total - mx * my
        middle, apart = 0.5 * (vx + vy), math.hypot(0.5 * (vx - vy), vxy)
        # Noise of a second moment, Σ g² (k² − v)² σ² / S², with the sum replaced by the integral over a Gaussian
        # weight.
        sigma, spread = np.float64(noise[pixels[n, 1], pixels[n, 0]]), w * w / 2.0 * 1.5 - w * middle + middle * middle
        error = sigma / total * math.sqrt(max(math.pi * w * spread, 0.0))
        minor, major, widest = max(middle - apart, 0.0), middle + apart, 0.95 * w
        shapes[n, MINOR] = minor * w / (w - minor) if minor < widest else np.inf
        shapes[n, MAJOR] = major * w / (w - major) if major < widest else np.inf
        shapes[n, MINOR_ERROR] = error * (w / (w - min(minor, widest))) ** 2
        shapes[n, PEAK_SHARE] = highest / plain if plain > 0.0 else np.inf
        shapes[n, SHAPE_SNR] = total / (sigma * math.sqrt(norm))
