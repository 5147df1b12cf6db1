"""The model of a trail, a line convolved with a Gaussian: its pixels, its light in them, and its slopes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import FloatArray, IntArray
from startracker.detection.plane import Plane
from startracker.detection.values import Image, is_value
from startracker.kernels import kernel, kernel_part, kernel_with, pixel_kernel

FloatImage = NDArray[np.float32]

X, Y, FLUX, SKY, ANGLE, HALF, SIGMA = range(7)
"""Parameters of a trail: middle, px; light and level beside it, DN; direction, rad; half length and width, px."""
POSITION, TURNED, SHAPE, LINE = 4, 5, 6, 7
"""How many of them, from the first on, are fitted: of a faint trail; of a line of unknown length; of a bright trail; of
one that gives the motion and the width."""
_ACROSS_SIGMAS, _BEYOND_SIGMAS = 3.5, 5.0
_OUTLIER = 5.0
_FAR = 6.0
"""Standard deviations from its ends at which a trail is as good as infinite: 1e-9 of its light."""
_A_SIGMA = 64
_Z = np.arange(-_FAR, _FAR + 2.0 / _A_SIGMA, 1.0 / _A_SIGMA)
_DENSITY = np.exp(-0.5 * _Z**2) / math.sqrt(2.0 * math.pi)
_AREA = np.array([0.5 * math.erfc(-z / math.sqrt(2.0)) for z in _Z])
WORK_ROWS = LINE + 6
_WEIGHT, _REST, _SCALED, _ALONG, _FIRST, _LAST = range(LINE, WORK_ROWS)
"""Rows of the working space after the slopes: weights, residuals, their products with a slope; integral along the
trail, and the densities at its two ends."""


@pixel_kernel
def residual_of(image: Image, level: Plane, saturation: float) -> FloatImage:
    """Image minus background, DN; not a number where the image is not finite or saturated."""
    height, width = image.shape
    out, full, gap = np.empty((height, width), np.float32), np.float32(saturation), np.float32(np.nan)
    for y in range(height):
        pixels, row, share = image[y], out[y], level.share[y]
        upper, lower = level.lines[level.cell[y]], level.lines[min(level.cell[y] + 1, len(level.lines) - 1)]
        for x in range(width):
            signal = np.float32(pixels[x]) - (upper[x] + share * (lower[x] - upper[x]))
            row[x] = signal if is_value(pixels[x]) & (np.float32(pixels[x]) < full) else gap
    return out


@kernel_part
def _row_spans(p: FloatArray, beyond: float, beside: float, height: int, width: int) -> tuple[int, IntArray]:
    """First row, and of each row the first column and the last + 1 (N, 2), of the slanted window of ± beyond along and
    ± beside across a trail."""
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    high = beyond * abs(sin) + beside * abs(cos)
    top, bottom = max(0, math.ceil(p[Y] - high)), min(height, math.floor(p[Y] + high) + 1)
    spans = np.empty((max(bottom - top, 0), 2), np.int64)
    for k in range(len(spans)):
        dy = top + k - p[Y]
        left, right = -2.0 * (beyond + beside), 2.0 * (beyond + beside)
        if abs(cos) > 1e-6:
            middle, reach = -dy * sin / cos, beyond / abs(cos)
            left, right = max(left, middle - reach), min(right, middle + reach)
        if abs(sin) > 1e-6:
            middle, reach = dy * cos / sin, beside / abs(sin)
            left, right = max(left, middle - reach), min(right, middle + reach)
        spans[k, 0], spans[k, 1] = max(0, math.ceil(p[X] + left)), min(width, math.floor(p[X] + right) + 1)
    return top, spans


@kernel_part
def window_pixels(residual: FloatImage, noise: Plane, p: FloatArray, slack: float) -> FloatArray:
    """Columns x, y, value and variance (4, N) of the usable pixels about a trail."""
    beyond, beside = p[HALF] + _BEYOND_SIGMAS * p[SIGMA] + slack, _ACROSS_SIGMAS * p[SIGMA] + 1.0
    top, spans = _row_spans(p, beyond, beside, residual.shape[0], residual.shape[1])
    count = 0
    for j in range(len(spans)):
        for x in range(spans[j, 0], spans[j, 1]):
            count += int(is_value(residual[top + j, x]))
    pixels, k = np.empty((4, count)), np.uint64(0)
    for j in range(len(spans)):
        y = top + j
        cell, share = noise.cell[y], noise.share[y]
        below = min(cell + 1, len(noise.lines) - 1)
        for x in range(spans[j, 0], spans[j, 1]):
            if is_value(residual[y, x]):
                upper = noise.lines[cell, x]
                sigma = np.float64(upper + share * (noise.lines[below, x] - upper))
                pixels[0, k], pixels[1, k], pixels[2, k], pixels[3, k] = x, y, residual[y, x], sigma * sigma
                k += np.uint64(1)
    return pixels


@kernel_part
def _decay(u: float) -> float:
    """exp(−u) of 0 ≤ u, to 1e-5 up to u = 18 and less than 1e-7 beyond: (e^(−u / 32))³², which is vectorised."""
    v = min(u, 18.0) * (-1.0 / 32.0)
    root = 1.0 + v * (1.0 + v * (1 / 2 + v * (1 / 6 + v * (1 / 24 + v * (1 / 120 + v * (1 / 720 + v * (1 / 5040)))))))
    two = root * root
    four = two * two
    eight = four * four
    sixteen = eight * eight
    return sixteen * sixteen


@kernel
def _interpolated(table: FloatArray, z: float) -> float:
    """Density or integral of the normal distribution from its table: within 3e-5."""
    part = (min(max(z, -_FAR), _FAR) + _FAR) * _A_SIGMA
    k = np.uint64(part)
    value: float = table[k] + (part - k) * (table[k + np.uint64(1)] - table[k])
    return value


@kernel_with(fastmath={"reassoc"})
def linearise(
    pixels: FloatArray, p: FloatArray, size: int, inverse_gain: float, outlier: float, work: FloatArray
) -> tuple[float, int]:
    """χ² of a trail in its pixels (4, N), and the number of pixels within 5 standard errors.

    `work` (`WORK_ROWS`, N) gets the slopes by the first `size` parameters, the weights and the residuals. The light of
    a pixel is F / 2h · [Φ((s + h) / σ) − Φ((s − h) / σ)] · exp(−t² / 2σ²) / (σ √2π) + sky, with s along and t across
    the trail.
    """
    cos, sin, flux, sky, half = math.cos(p[ANGLE]), math.sin(p[ANGLE]), p[FLUX], p[SKY], p[HALF]
    narrow = 1.0 / p[SIGMA]
    unit, end = narrow / (2.0 * half * math.sqrt(2.0 * math.pi)), half * narrow
    xs, ys, values, variances = pixels[0], pixels[1], pixels[2], pixels[3]
    along, first, last = work[_ALONG], work[_FIRST], work[_LAST]
    count = np.uint64(pixels.shape[1])
    for k in range(count):
        along[k] = ((xs[k] - p[X]) * cos + (ys[k] - p[Y]) * sin) * narrow
    for k in range(count):
        # most pixels of a long trail are far from its ends
        s, along[k], first[k], last[k] = along[k], 1.0, 0.0, 0.0
        if s + end < _FAR:
            along[k], first[k] = _interpolated(_AREA, s + end), _interpolated(_DENSITY, s + end)
        if s - end > -_FAR:
            along[k], last[k] = along[k] - _interpolated(_AREA, s - end), _interpolated(_DENSITY, s - end)
    chi2, usable, limit = 0.0, 0, outlier**2
    for k in range(count):
        t = ((ys[k] - p[Y]) * cos - (xs[k] - p[X]) * sin) * narrow
        across = unit * _decay(0.5 * t * t)
        share = across * along[k]
        rest = values[k] - flux * share - sky
        weight = 1.0 / (variances[k] + max(flux * share, 0.0) * inverse_gain)
        error2 = rest * rest * weight
        usable += int(error2 <= _OUTLIER**2)
        chi2 += min(error2, limit)
        # a hot pixel or a cosmic ray: of no use, and dear enough not to be thrown away for a better χ²
        work[_WEIGHT, k], work[_REST, k] = weight if error2 <= limit else 0.0, rest
        by_s, by_t = flux * across * (first[k] - last[k]) * narrow, -flux * share * t * narrow
        work[X, k], work[Y, k] = by_t * sin - by_s * cos, -by_s * sin - by_t * cos
        work[FLUX, k], work[SKY, k] = share, 1.0
    if size > POSITION:
        _by_form(pixels, p, work)
    return chi2, usable


@kernel
def _by_form(pixels: FloatArray, p: FloatArray, work: FloatArray) -> None:
    """Slopes by direction, half length and width, the others being known."""
    cos, sin, narrow = math.cos(p[ANGLE]), math.sin(p[ANGLE]), 1.0 / p[SIGMA]
    flux, half, end = p[FLUX], p[HALF], p[HALF] / p[SIGMA]
    for k in range(np.uint64(pixels.shape[1])):
        dx, dy = pixels[0, k] - p[X], pixels[1, k] - p[Y]
        s, t = (dx * cos + dy * sin) * narrow, (dy * cos - dx * sin) * narrow
        share, first, last = work[FLUX, k], work[_FIRST, k], work[_LAST, k]
        across = narrow / (2.0 * half * math.sqrt(2.0 * math.pi)) * _decay(0.5 * t * t)
        work[ANGLE, k] = work[Y, k] * dx - work[X, k] * dy
        work[HALF, k] = flux * (across * (first + last) * narrow - share / half)
        ends = (s - end) * last - (s + end) * first
        work[SIGMA, k] = flux * narrow * (across * ends + share * (t * t - 1.0))


# sums in any order: added up in the order of the pixels each sum waits for the one before
@kernel_with(fastmath={"reassoc"})
def normal_equations(work: FloatArray, size: int, normal: FloatArray, right: FloatArray) -> None:
    """Normal matrix, its lower half, and right side of what `linearise` has set."""
    weight, rest, scaled = work[_WEIGHT], work[_REST], work[_SCALED]
    for i in range(size):
        slope, total = work[i], 0.0
        for k in range(len(weight)):
            scaled[k] = weight[k] * slope[k]
            total += scaled[k] * rest[k]
        right[i] = total
        for j in range(i + 1):
            other, total = work[j], 0.0
            for k in range(len(weight)):
                total += scaled[k] * other[k]
            normal[i, j] = total


@kernel_part
def set_light(pixels: FloatArray, p: FloatArray, work: FloatArray) -> None:
    """Set flux and sky to what suits the other parameters, in which the light is linear."""
    p[FLUX], p[SKY] = 1.0, 0.0
    linearise(pixels, p, POSITION, 0.0, np.inf, work)
    normal, right = np.empty((POSITION, POSITION)), np.empty(POSITION)
    normal_equations(work, POSITION, normal, right)
    determinant = normal[FLUX, FLUX] * normal[SKY, SKY] - normal[SKY, FLUX] ** 2
    more = (right[FLUX] * normal[SKY, SKY] - right[SKY] * normal[SKY, FLUX]) / determinant
    p[SKY] = (right[SKY] * normal[FLUX, FLUX] - right[FLUX] * normal[SKY, FLUX]) / determinant
    p[FLUX] += more


@kernel
def subtract_trail(residual: FloatImage, p: FloatArray, sign: float) -> None:
    """Subtract a trail from the residual in place (`sign` −1: add it again); its sky is left."""
    cos, sin, narrow = math.cos(p[ANGLE]), math.sin(p[ANGLE]), 1.0 / p[SIGMA]
    end = p[HALF] * narrow
    top, spans = _row_spans(p, p[HALF] + _FAR * p[SIGMA], _FAR * p[SIGMA], residual.shape[0], residual.shape[1])
    unit = sign * p[FLUX] * narrow / (2.0 * p[HALF] * math.sqrt(2.0 * math.pi))
    for j in range(len(spans)):
        dy = top + j - p[Y]
        for x in range(spans[j, 0], spans[j, 1]):
            s, t = ((x - p[X]) * cos + dy * sin) * narrow, (dy * cos - (x - p[X]) * sin) * narrow
            along = 1.0
            if s + end < _FAR:
                along = _interpolated(_AREA, s + end)
            if s - end > -_FAR:
                along -= _interpolated(_AREA, s - end)
            residual[top + j, x] -= np.float32(unit * along * _decay(0.5 * t * t))


@kernel_part
def is_near(p: FloatArray, other: FloatArray) -> bool:
    """Whether the light of another trail reaches into the window of a trail."""
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    dx, dy = other[X] - p[X], other[Y] - p[Y]
    along = p[HALF] + other[HALF] + 2.0 * _BEYOND_SIGMAS * p[SIGMA]
    across = 2.0 * (_ACROSS_SIGMAS * p[SIGMA] + 2.0)
    return bool(abs(dx * cos + dy * sin) < along and abs(dy * cos - dx * sin) < across)
