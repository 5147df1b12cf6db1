"""Kernels that look at a candidate's pixels: weighted moments, and what surrounds it."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.scan import filter_stamp
from startracker.detection.tiles import select_kth
from startracker.detection.values import Image, is_value

__all__ = ["SHAPE_COLUMNS", "find_clutter", "measure_shapes", "ring_pixels"]

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


@njit(cache=True, error_model="numpy")
def measure_shapes(
    image: Image,
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
    side = 2 * half + 1
    w = weight_sigma * weight_sigma
    out = np.full((len(xs), SHAPE_COLUMNS), np.nan)
    centred, weight_x, weight_y = np.empty(half + 1), np.empty(side), np.empty(side)
    for k in range(half + 1):
        centred[k] = math.exp(-0.5 * k * k / w)
    # signal of the window's pixels; those that are not finite or lie beyond the border have no use
    window, use = np.empty((side, side)), np.empty((side, side))
    for index in range(len(xs)):
        x0, y0 = xs[index], ys[index]
        plain, highest = 0.0, 0.0
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
        dx, dy = 0.0, 0.0
        sigma = np.float64(noise[y0, x0])
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


@cache
def ring_pixels() -> tuple[IntArray, IntArray]:
    """Offsets (ring, n, 2) along y and x of the pixels of rings, sector by sector, and where sectors end (ring, 8).

    The first ring lies outside radius 2 px, every further one a pixel further out.
    """
    outermost = _LARGEST_RADIUS_PX + 2 + _RING_PX
    j, i = np.mgrid[-outermost : outermost + 1, -outermost : outermost + 1].reshape(2, -1)
    sector = np.where(i > 0, 4, 0) + np.where(j > 0, 2, 0) + np.where(abs(i) > abs(j), 1, 0)
    order = np.argsort(sector, kind="stable")
    i, j, sector = i[order], j[order], sector[order]
    rings = [
        np.flatnonzero((i * i + j * j > inner**2) & (i * i + j * j <= (inner + _RING_PX) ** 2))
        for inner in range(2, _LARGEST_RADIUS_PX + 3)
    ]
    offsets = np.zeros((len(rings), max(map(len, rings)), 2), np.int64)
    for ring, inside in enumerate(rings):
        offsets[ring, : len(inside)] = np.column_stack([j, i])[inside]
    ends = [np.searchsorted(sector[inside], range(8), "right") for inside in rings]
    return offsets, np.array(ends, np.int64)


@njit(cache=True, error_model="numpy")
def find_clutter(
    image: Image,
    level: Plane,
    half: FloatImage,
    xs: IntArray,
    ys: IntArray,
    radius: FloatArray,
    judged: NDArray[np.bool_],
    offsets: IntArray,
    ends: IntArray,
    quiet: float,
    isolation: float,
    most: int,
) -> NDArray[np.bool_]:
    """Whether candidates fail to stand out of the ring around them; shape (N,), false for those not `judged`.

    The ring begins 2 px beyond the candidate's radius, is 8 px wide and has eight sectors, whose maxima count. One
    neighbour fills two of them, three with its wings; branches and leaves fill most. The candidate must be `isolation`
    times as high as the fourth highest where that exceeds `quiet`, both above the ring's median. The search ends when
    `most` candidates are found to stand out.

    All this is asked of the image after the filter `half`, see `startracker.detection.scan`.
    """
    out = np.zeros(len(xs), np.bool_)
    largest = 2 * (_LARGEST_RADIUS_PX + 2 + _RING_PX) + 1
    stamp, working = np.empty(largest**2, np.float32), np.empty((2 * len(half) - 1) * largest, np.float32)
    sample = np.empty(offsets.shape[1] + 1, np.float32)
    highest = np.empty(8)
    clear = 0
    for index in range(len(xs)):
        if clear >= most:
            break
        clear += 1
        if not judged[index]:
            continue
        ring = min(math.ceil(radius[index]), _LARGEST_RADIUS_PX)
        outer = ring + 2 + _RING_PX
        x0, y0 = xs[index], ys[index]
        side = 2 * outer + 1
        filter_stamp(image, level, half, x0, y0, outer, working, stamp)
        middle = outer * side + outer
        count, n = 0, 0
        for sector in range(8):
            top = np.float32(0.0)
            while n < ends[ring, sector]:
                value = stamp[middle + offsets[ring, n, 0] * side + offsets[ring, n, 1]]
                sample[count] = value
                finite = abs(value) < np.inf
                count += finite
                top = value if finite and value > top else top
                n += 1
            highest[sector] = top
        fourth = np.sort(highest)[4]
        # the median is below a value when more than half of the sample is
        below = 0
        for k in range(count):
            below += sample[k] < fourth - quiet
        if below <= count // 2:
            continue
        median = select_kth(sample, 0, count, count // 2)
        signal = np.float64(stamp[middle]) - median
        out[index] = signal < isolation * (fourth - median)
        clear -= out[index]
    return out
