"""Model of a trail, a line convolved with a Gaussian: its pixels, its light in them, and the derivatives."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part, kernel_with
from startracker.core import FloatArray, IntArray
from startracker.detection.tiles import Plane
from startracker.detection.values import Image, is_value

FloatImage = NDArray[np.float32]

_Line = tuple[float, float, float, float, float, float]
"""Middle x and y, cosine and sine of the direction, half length, 1 / width."""
_Light = tuple[float, float, float]
"""Light of the trail and level beside it, DN, and DN per electron."""

X, Y, FLUX, SKY, ANGLE, HALF, SIGMA = range(7)
"""Indices of a trail's parameters: middle, px; light and level beside it, DN; direction, rad; half length and width,
px."""
POSITION, TURNED, SHAPE, LINE = 4, 5, 6, 7
"""Number of parameters, from the first on, that are fitted: for a faint trail; for a line of unknown length; for a
bright trail; for a trail from which motion and width are determined."""
_ACROSS_SIGMAS, _BEYOND_SIGMAS = 3.5, 5.0
_OUTLIER = 5.0
_FAR = 6.0
"""Distance from its ends, in standard deviations, beyond which a trail is negligibly different from an infinite one:
1e-9 of its light."""
_A_SIGMA = 64
_Z = np.arange(-_FAR, _FAR + 2.0 / _A_SIGMA, 1.0 / _A_SIGMA)
_DENSITY = np.exp(-0.5 * _Z**2) / math.sqrt(2.0 * math.pi)
_AREA = np.array([0.5 * math.erfc(-z / math.sqrt(2.0)) for z in _Z])
BLOCK, WORK_ROWS = 64, LINE + 6
_BLOCK = np.uint64(BLOCK)
_WEIGHT, _REST, _SCALED, _ALONG, _FIRST, _LAST = range(LINE, WORK_ROWS)
"""Rows of the working space after the derivatives: weights, residuals, their products with a derivative; integral along
the trail, and the densities at its two ends."""


@kernel
def residual_of(image: Image, level: Plane, saturation: float) -> FloatImage:
    """Image minus background, DN; NaN where the image is not finite or is saturated."""
    height, width = image.shape
    out, full, gap = np.empty((height, width), np.float32), np.float32(saturation), np.float32(np.nan)
    for y in range(height):
        pixels, row, share = image[y], out[y], level.share[y]
        upper, lower = level.lines[level.cell[y]], level.lines[min(level.cell[y] + 1, len(level.lines) - 1)]
        for x in range(width):
            signal = np.float32(pixels[x]) - (upper[x] + share * (lower[x] - upper[x]))
            row[x] = signal if is_value(pixels[x]) & (np.float32(pixels[x]) < full) else gap
    return out


@kernel
def _row_spans(p: FloatArray, beyond: float, beside: float, height: int, width: int) -> tuple[int, IntArray]:
    """Rows and columns of the slanted window that extends ± `beyond` along and ± `beside` across a trail.

    Returns the first row, and the first column and last column + 1 of each row (N, 2).
    """
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    high = beyond * abs(sin) + beside * abs(cos)
    top, bottom = max(0, math.ceil(p[Y] - high)), min(height, math.floor(p[Y] + high) + 1)
    spans = np.empty((max(bottom - top, 0), 2), np.int64)
    for k in range(len(spans)):
        dy = top + k - p[Y]
        left, right = -np.inf, np.inf
        if abs(cos) > 1e-6:
            middle, reach = -dy * sin / cos, beyond / abs(cos)
            left, right = max(left, middle - reach), min(right, middle + reach)
        if abs(sin) > 1e-6:
            middle, reach = dy * cos / sin, beside / abs(sin)
            left, right = max(left, middle - reach), min(right, middle + reach)
        first = max(0, math.ceil(p[X] + left))
        spans[k, 0], spans[k, 1] = first, max(first, min(width, math.floor(p[X] + right) + 1))
    return top, spans


@kernel
def window_pixels(residual: FloatImage, noise: Plane, p: FloatArray, slack: float) -> tuple[FloatArray, int]:
    """Columns x, y, value and variance (4, N) of the pixels around a trail, and how many of them are usable.

    The pixels are sorted from the beginning to the end of the trail and padded to complete blocks; the variance of
    those that are not usable is infinite.
    """
    beyond, beside = p[HALF] + _BEYOND_SIGMAS * p[SIGMA] + slack, _ACROSS_SIGMAS * p[SIGMA] + 1.0
    height, width = residual.shape
    flat = abs(math.cos(p[ANGLE])) > abs(math.sin(p[ANGLE]))
    line = p.copy()
    # Column by column for a trail nearer the x axis, so that only a few blocks are near an end of the trail.
    if flat:
        line[X], line[Y], line[ANGLE], height, width = p[Y], p[X], 0.5 * math.pi - p[ANGLE], width, height
    top, spans = _row_spans(line, beyond, beside, height, width)
    pixels = np.zeros((4, (spans[:, 1].sum() - spans[:, 0].sum() + BLOCK - 1) // BLOCK * BLOCK))
    pixels[3] = np.inf
    usable, k = 0, np.uint64(0)
    for j in range(len(spans)):
        if spans[j, 0] == spans[j, 1]:
            continue
        middle = (spans[j, 0] + spans[j, 1]) // 2  # the noise hardly varies across a trail
        sigma = np.float64(noise[middle, top + j] if flat else noise[top + j, middle])
        for i in range(spans[j, 0], spans[j, 1]):
            x, y = (top + j, i) if flat else (i, top + j)
            good = is_value(residual[y, x])
            pixels[0, k], pixels[1, k] = x, y
            pixels[2, k], pixels[3, k] = residual[y, x] if good else 0.0, sigma * sigma if good else np.inf
            usable += int(good)
            k += np.uint64(1)
    return pixels, usable


@kernel_part
def _decay(u: float) -> float:
    """exp(−u) for u ≥ 0, computed as (e^(−u/32))³², which the compiler vectorises.

    The relative error is 1.4e-5 up to u = 18; beyond, the value is less than 1e-7.
    """
    v = min(u, 18.0) * (-1.0 / 32.0)
    root = 1.0 + v * (1.0 + v * (1 / 2 + v * (1 / 6 + v * (1 / 24 + v * (1 / 120 + v * (1 / 720 + v * (1 / 5040)))))))
    two = root * root
    four = two * two
    eight = four * four
    sixteen = eight * eight
    return sixteen * sixteen


@kernel
def _interpolated(table: FloatArray, z: float) -> float:
    """Density or integral of the Gaussian from its table, to 3e-5."""
    part = (min(max(z, -_FAR), _FAR) + _FAR) * _A_SIGMA
    k = np.uint64(part)
    value: float = table[k] + (part - k) * (table[k + np.uint64(1)] - table[k])
    return value


# With sums in the order of the pixels each addition waits for the one before; "reassoc" allows vectorisation.
@kernel_with(fastmath={"reassoc"})
def linearise(
    pixels: FloatArray, p: FloatArray, size: int, inverse_gain: float, outlier: float, work: FloatArray,
    normal: FloatArray, right: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    """χ² of a trail in its pixels (4, N), and the number of pixels beyond 5 standard errors.

    Sets the normal matrix (lower half) and the right side for the first `size` parameters. The light of a pixel is F /
    2h · [Φ((s + h) / σ) − Φ((s − h) / σ)] · exp(−t² / 2σ²) / (σ √2π) + sky, with s along and t across the trail. Pixels
    are processed in blocks, so that `work` (`WORK_ROWS`, `BLOCK`) stays in the nearest cache.
    """
    chi2, outliers = 0.0, 0
    line = p[X], p[Y], math.cos(p[ANGLE]), math.sin(p[ANGLE]), p[HALF], 1.0 / p[SIGMA]
    light = p[FLUX], p[SKY], inverse_gain
    normal[:], right[:] = 0.0, 0.0
    for first in range(0, pixels.shape[1], BLOCK):
        begin = np.uint64(first)
        _share_along(pixels, begin, line, work)
        block_chi2, beyond = _slopes(pixels, begin, line, light, outlier, work)
        chi2, outliers = chi2 + block_chi2, outliers + beyond
        if size > POSITION:
            _slopes_by_form(pixels, begin, line, light, work)
        for i in range(size):
            total = 0.0
            for k in range(_BLOCK):
                work[_SCALED, k] = work[_WEIGHT, k] * work[i, k]
                total += work[_SCALED, k] * work[_REST, k]
            right[i] += total
            for j in range(i + 1):
                total = 0.0
                for k in range(_BLOCK):
                    total += work[_SCALED, k] * work[j, k]
                normal[i, j] += total
    return chi2, outliers


@kernel
def _share_along(pixels: FloatArray, begin: np.uint64, line: _Line, work: FloatArray) -> None:
    """Integral along the trail, and the densities at its two ends, for a block of pixels."""
    x, y, cos, sin, half, narrow = line
    end, starts, ends = half * narrow, 0, 0
    for k in range(_BLOCK):
        s = ((pixels[0, begin + k] - x) * cos + (pixels[1, begin + k] - y) * sin) * narrow
        work[_SCALED, k], work[_ALONG, k], work[_FIRST, k], work[_LAST, k] = s, 1.0, 0.0, 0.0
        starts, ends = starts + int(s + end < _FAR), ends + int(s - end > -_FAR)
    # Blocks without a pixel within `_FAR` widths of an end, which are most of a long trail, need no tables.
    if starts > 0:
        for k in range(_BLOCK):
            z = work[_SCALED, k] + end
            work[_ALONG, k], work[_FIRST, k] = _interpolated(_AREA, z), _interpolated(_DENSITY, z)
    if ends > 0:
        for k in range(_BLOCK):
            z = work[_SCALED, k] - end
            work[_ALONG, k] -= _interpolated(_AREA, z)
            work[_LAST, k] = _interpolated(_DENSITY, z)


@kernel
def _slopes(
    pixels: FloatArray, begin: np.uint64, line: _Line, light: _Light, outlier: float, work: FloatArray
) -> tuple[float, int]:
    """χ² of a block of pixels and its number of outliers; sets residuals, weights and derivatives by position and
    light."""
    (x, y, cos, sin, half, narrow), (flux, sky, inverse_gain) = line, light
    unit, chi2, outliers, limit = narrow / (2.0 * half * math.sqrt(2.0 * math.pi)), 0.0, 0, outlier**2
    for k in range(_BLOCK):
        t = ((pixels[1, begin + k] - y) * cos - (pixels[0, begin + k] - x) * sin) * narrow
        across = unit * _decay(0.5 * t * t)
        share = across * work[_ALONG, k]
        rest = pixels[2, begin + k] - flux * share - sky
        weight = 1.0 / (pixels[3, begin + k] + max(flux * share, 0.0) * inverse_gain)
        error2 = rest * rest * weight
        outliers += int(error2 > _OUTLIER**2)
        chi2 += min(error2, limit)
        # An outlier, such as a hot pixel or a cosmic ray, gets no weight, but its limited contribution to χ² remains,
        # so that a fit cannot lower χ² by rejecting pixels.
        work[_WEIGHT, k], work[_REST, k] = weight if error2 <= limit else 0.0, rest
        by_s, by_t = flux * across * (work[_FIRST, k] - work[_LAST, k]) * narrow, -flux * share * t * narrow
        work[X, k], work[Y, k] = by_t * sin - by_s * cos, -by_s * sin - by_t * cos
        work[FLUX, k], work[SKY, k] = share, 1.0
    return chi2, outliers


@kernel_part
def _slopes_by_form(pixels: FloatArray, begin: np.uint64, line: _Line, light: _Light, work: FloatArray) -> None:
    """Derivatives in a block with respect to direction, half length and width, after those by position and light."""
    (x, y, cos, sin, half, narrow), flux = line, light[0]
    end, unit = half * narrow, narrow / (2.0 * half * math.sqrt(2.0 * math.pi))
    for k in range(_BLOCK):
        dx, dy = pixels[0, begin + k] - x, pixels[1, begin + k] - y
        s, t = (dx * cos + dy * sin) * narrow, (dy * cos - dx * sin) * narrow
        share, first, last = work[FLUX, k], work[_FIRST, k], work[_LAST, k]
        across = unit * _decay(0.5 * t * t)
        work[ANGLE, k] = work[Y, k] * dx - work[X, k] * dy
        work[HALF, k] = flux * (across * (first + last) * narrow - share / half)
        ends = (s - end) * last - (s + end) * first
        work[SIGMA, k] = flux * narrow * (across * ends + share * (t * t - 1.0))


@kernel_part
def set_light(pixels: FloatArray, p: FloatArray, work: FloatArray, normal: FloatArray, right: FloatArray) -> None:
    """Set flux and sky, in which the light is linear, to their least-squares values for the other parameters."""
    p[FLUX], p[SKY] = 1.0, 0.0
    linearise(pixels, p, POSITION, 0.0, np.inf, work, normal, right)
    determinant = normal[FLUX, FLUX] * normal[SKY, SKY] - normal[SKY, FLUX] ** 2
    more = (right[FLUX] * normal[SKY, SKY] - right[SKY] * normal[SKY, FLUX]) / determinant
    p[SKY] = (right[SKY] * normal[FLUX, FLUX] - right[FLUX] * normal[SKY, FLUX]) / determinant
    p[FLUX] += more


@kernel
def subtract_trail(residual: FloatImage, p: FloatArray, sign: float) -> None:
    """Subtract a trail from the residual in place (`sign` −1: add it back); its sky is not subtracted."""
    cos, sin, narrow = math.cos(p[ANGLE]), math.sin(p[ANGLE]), 1.0 / p[SIGMA]
    end = p[HALF] * narrow
    top, spans = _row_spans(p, p[HALF] + _FAR * p[SIGMA], _FAR * p[SIGMA], residual.shape[0], residual.shape[1])
    unit = sign * p[FLUX] * narrow / (2.0 * p[HALF] * math.sqrt(2.0 * math.pi))
    x0 = p[X]
    for j in range(len(spans)):
        y, dy = np.uint64(top + j), top + j - p[Y]
        for x in range(np.uint64(spans[j, 0]), np.uint64(spans[j, 1])):
            dx = np.float64(x) - x0
            s, t = (dx * cos + dy * sin) * narrow, (dy * cos - dx * sin) * narrow
            along = _interpolated(_AREA, s + end) - _interpolated(_AREA, s - end)
            residual[y, x] -= np.float32(unit * along * _decay(0.5 * t * t))


@kernel_part
def is_near(p: FloatArray, other: FloatArray) -> bool:
    """Whether the light of another trail extends into the window of a trail."""
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    dx, dy = other[X] - p[X], other[Y] - p[Y]
    along = p[HALF] + other[HALF] + 2.0 * _BEYOND_SIGMAS * p[SIGMA]
    across = 2.0 * (_ACROSS_SIGMAS * p[SIGMA] + 2.0)
    return bool(abs(dx * cos + dy * sin) < along and abs(dy * cos - dx * sin) < across)
