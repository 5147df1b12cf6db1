"""Kernels that measure trails: a line convolved with a Gaussian, fitted by least squares."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.values import Image, is_value
from startracker.kernels import kernel
from startracker.linalg import factorise, substitute

__all__ = ["ANGLE", "FLUX", "HALF", "LINE", "PLACE", "SHAPE", "SIGMA", "SKY", "X", "Y"]
__all__ += ["best_stretch", "fit_trail", "measure_trails", "residual_of"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]

X, Y, FLUX, SKY, ANGLE, HALF, SIGMA = range(7)
"""Parameters of a trail: middle, px; light and level beside it, DN; direction, rad; half length and width, px."""
PLACE, SHAPE, LINE = 4, 6, 7
"""How many of them, from the first on, are fitted: of a faint trail, of a bright one, of a line of unknown motion."""
_ACROSS_SIGMAS, _BEYOND_SIGMAS = 3.5, 5.0
_OUTLIER = 5.0
_FAR = 6.0
"""Standard deviations from its ends at which a trail is as good as infinite: 1e-9 of its light."""
_A_SIGMA = 64
_Z = np.arange(-_FAR, _FAR + 2.0 / _A_SIGMA, 1.0 / _A_SIGMA)
_DENSITY = np.exp(-0.5 * _Z**2) / math.sqrt(2.0 * math.pi)
_AREA = np.array([0.5 * math.erfc(-z / math.sqrt(2.0)) for z in _Z])
_FIRST_STEPS, _STEPS = 3, 10
"""At most, before pixels are tested for outliers and after: far from the minimum all of a bright trail would be."""
_CONVERGED = 1e-2
"""Decrease of χ² that is none: a position within 0.1 of its standard error of the minimum."""
_CLIP = 4.0
"""Noise in a pixel at most counted along a line, so that a hot pixel or a cosmic ray does not decide where it ends."""
_BRIGHT_SNR = 30.0
"""Above it a trail has its own direction and length, which are then known better than from the frame's motion."""
_SWEEPS = 2
_GOOD_CHI2, _ASIDE_SIGMAS = 2.0, 2.5
"""χ² a degree of freedom above which a fit is begun again so many widths beside its first start."""


class Measured(NamedTuple):
    """Fits of M trails.

    Parameters
    ----------
    table : (M, 7)
        Parameters.
    covariance : (M, 3, 3)
        Of x, y and flux.
    chi2, freedom : (M,)
        χ² a degree of freedom, and these.
    alone : bool (M,)
        Whether direction and length are those of the trail, not of the frame's motion.
    """

    table: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    freedom: IntArray
    alone: NDArray[np.bool_]


@kernel
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


@kernel
def _row_span(p: FloatArray, y: int, beyond: float, beside: float, width: int) -> tuple[int, int]:
    """First column, and last + 1, of a row in the slanted window of ± beyond along and ± beside across a trail."""
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    dy = y - p[Y]
    left, right = -2.0 * (beyond + beside), 2.0 * (beyond + beside)
    if abs(cos) > 1e-6:
        middle, reach = -dy * sin / cos, beyond / abs(cos)
        left, right = max(left, middle - reach), min(right, middle + reach)
    if abs(sin) > 1e-6:
        middle, reach = dy * cos / sin, beside / abs(sin)
        left, right = max(left, middle - reach), min(right, middle + reach)
    return max(0, math.ceil(p[X] + left)), min(width, math.floor(p[X] + right) + 1)


@kernel
def _rows(p: FloatArray, beyond: float, beside: float, height: int) -> tuple[int, int]:
    """First row, and last + 1, of that window."""
    high = beyond * abs(math.sin(p[ANGLE])) + beside * abs(math.cos(p[ANGLE]))
    return max(0, math.ceil(p[Y] - high)), min(height, math.floor(p[Y] + high) + 1)


@kernel
def _window(residual: FloatImage, noise: Plane, p: FloatArray, slack: float) -> FloatArray:
    """Columns x, y, value and variance (4, N) of the usable pixels about a trail."""
    height, width = residual.shape
    beyond = p[HALF] + _BEYOND_SIGMAS * p[SIGMA] + slack
    beside = _ACROSS_SIGMAS * p[SIGMA] + 1.0
    top, bottom = _rows(p, beyond, beside, height)
    size = 0
    for y in range(top, bottom):
        first, last = _row_span(p, y, beyond, beside, width)
        size += max(last - first, 0)
    pixels, count = np.empty((4, size)), 0
    for y in range(top, bottom):
        first, last = _row_span(p, y, beyond, beside, width)
        for x in range(first, last):
            if is_value(residual[y, x]):
                pixels[0, count], pixels[1, count] = x, y
                pixels[2, count], pixels[3, count] = residual[y, x], np.float64(noise[y, x]) ** 2
                count += 1
    return pixels[:, :count]


@kernel
def _normal(z: float) -> tuple[float, float]:
    """Integral and density of the normal distribution, interpolated from tables: within 3e-5."""
    part = (min(max(z, -_FAR), _FAR) + _FAR) * _A_SIGMA
    k = np.uint64(part)
    part -= k
    one = np.uint64(1)
    return _AREA[k] + part * (_AREA[k + one] - _AREA[k]), _DENSITY[k] + part * (_DENSITY[k + one] - _DENSITY[k])


@kernel
def _normal_equations(
    pixels: FloatArray, p: FloatArray, size: int, inverse_gain: float, outlier: float, normal: FloatArray,
    right: FloatArray,
) -> tuple[float, int]:  # fmt: skip
    """Normal equations of the first `size` parameters, χ² and the number of pixels within 5 standard errors.

    The light of a pixel is F / 2h · [Φ((s + h) / σ) − Φ((s − h) / σ)] · exp(−t² / 2σ²) / (σ √2π) + sky, with s along
    and t across the trail.
    """
    normal[:], right[:] = 0.0, 0.0
    slope = np.empty(LINE)
    cos, sin, flux, sky, half, sigma = math.cos(p[ANGLE]), math.sin(p[ANGLE]), p[FLUX], p[SKY], p[HALF], p[SIGMA]
    unit = 1.0 / (2.0 * half * sigma)
    chi2, count = 0.0, 0
    for k in range(pixels.shape[1]):
        dx, dy = pixels[0, k] - p[X], pixels[1, k] - p[Y]
        s, t = dx * cos + dy * sin, dy * cos - dx * sin
        across = unit * _normal(t / sigma)[1]
        front, back = (s + half) / sigma, (s - half) / sigma
        # most pixels of a long trail are far from its ends
        along, first, last = 1.0, 0.0, 0.0
        if front < _FAR:
            along, first = _normal(front)
        if back > -_FAR:
            beyond, last = _normal(back)
            along -= beyond
        share = across * along
        variance = pixels[3, k] + max(flux * share, 0.0) * inverse_gain
        rest = pixels[2, k] - flux * share - sky
        weight = 1.0 / variance
        error2 = rest * rest * weight
        count += error2 <= _OUTLIER**2
        chi2 += min(error2, outlier**2)
        # a hot pixel or a cosmic ray: of no use, and dear enough not to be thrown away for a better χ²
        if error2 > outlier**2:
            continue
        by_s, by_t = flux * across * (first - last) / sigma, -flux * share * t / sigma**2
        slope[X], slope[Y] = -by_s * cos + by_t * sin, -by_s * sin - by_t * cos
        slope[FLUX], slope[SKY] = share, 1.0
        if size > PLACE:
            slope[ANGLE] = by_s * t - by_t * s
            slope[HALF] = flux * (across * (first + last) / sigma - share / half)
            narrower = across * (back * last - front * first) + share * ((t / sigma) ** 2 - 1.0)
            slope[SIGMA] = flux * narrower / sigma
        for i in range(size):
            scaled = weight * slope[i]
            right[i] += scaled * rest
            for j in range(i + 1):
                normal[i, j] += scaled * slope[j]
    for i in range(size):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return chi2, count


@kernel
def _light(pixels: FloatArray, p: FloatArray, normal: FloatArray, right: FloatArray) -> None:
    """Set flux and sky to what suits the other parameters, in which the light is linear."""
    p[FLUX], p[SKY] = 1.0, 0.0
    _normal_equations(pixels, p, PLACE, 0.0, np.inf, normal, right)
    determinant = normal[FLUX, FLUX] * normal[SKY, SKY] - normal[FLUX, SKY] ** 2
    more = (right[FLUX] * normal[SKY, SKY] - right[SKY] * normal[FLUX, SKY]) / determinant
    p[SKY] = (right[SKY] * normal[FLUX, FLUX] - right[FLUX] * normal[FLUX, SKY]) / determinant
    p[FLUX] += more


@kernel
def fit_trail(
    residual: FloatImage, noise: Plane, start: FloatArray, size: int, slack: float, inverse_gain: float
) -> tuple[FloatArray, FloatArray, float, int]:
    """Least-squares fit of a trail (Levenberg 1944, Marquardt 1963).

    Parameters
    ----------
    residual : (H, W)
        From `residual_of`.
    noise : Plane
        Standard deviation of a pixel, DN.
    start : (7,)
        A flux that is not positive is estimated.
    size : int
        How many parameters are fitted: `PLACE`, `SHAPE` or `LINE`.
    slack : float
        How far, in pixels, the window reaches beyond the trail.
    inverse_gain : float
        DN an electron, for the photon noise; 0: none.

    Returns
    -------
    parameters (7,), covariance of those fitted (size, size), χ² a degree of freedom (infinite: no fit), degrees of
    freedom
    """
    p, trial = start.copy(), start.copy()
    pixels = _window(residual, noise, p, slack)
    normal, right, factor = np.zeros((LINE, LINE)), np.zeros(LINE), np.zeros((LINE, LINE))
    new_normal, new_right, step = np.zeros((LINE, LINE)), np.zeros(LINE), np.zeros(LINE)
    none = np.zeros((size, size))
    if pixels.shape[1] <= size:
        return p, none, np.inf, 0
    if not p[FLUX] > 0.0:
        _light(pixels, p, normal, right)
        if not p[FLUX] > 0.0:
            return p, none, np.inf, 0
    chi2, count = np.inf, 0
    for outlier, steps in ((np.inf, _FIRST_STEPS if size == PLACE else _STEPS), (_OUTLIER, _STEPS)):
        chi2, count = _normal_equations(pixels, p, size, inverse_gain, outlier, normal, right)
        damping, done = 1e-3, False
        for _ in range(steps):
            factor[:], step[:] = normal, right
            for i in range(size):
                factor[i, i] *= 1.0 + damping
            if not factorise(factor, size):
                return p, none, np.inf, 0
            substitute(factor, size, step)
            gain = 0.0
            for i in range(size):
                gain += step[i] * right[i]
            done = not gain > _CONVERGED
            if done:
                break
            trial[:] = p
            trial[:size] += step[:size]
            trial[HALF] = max(trial[HALF], 0.5)
            trial[SIGMA] = min(max(trial[SIGMA], 0.3), 4.0 * start[SIGMA])
            new_chi2, new_count = _normal_equations(pixels, trial, size, inverse_gain, outlier, new_normal, new_right)
            if new_chi2 > chi2:
                damping *= 10.0
                continue
            done = chi2 - new_chi2 < _CONVERGED
            p[:], normal[:], right[:] = trial, new_normal, new_right
            chi2, count, damping = new_chi2, new_count, 0.1 * damping
            if done:
                break
        if done and count == pixels.shape[1]:
            break
    factor[:] = normal
    if count <= size or not factorise(factor, size):
        return p, none, np.inf, 0
    covariance = np.eye(size)
    for i in range(size):
        substitute(factor, size, covariance[i])
    return p, covariance, chi2 / (count - size), count - size


@kernel
def _subtract(residual: FloatImage, p: FloatArray, sign: float) -> None:
    """Subtract a trail from the residual in place (`sign` −1: add it again); its sky is left."""
    sigma = p[SIGMA]
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    beyond, beside = p[HALF] + _FAR * sigma, _FAR * sigma
    top, bottom = _rows(p, beyond, beside, residual.shape[0])
    unit = sign * p[FLUX] / (2.0 * p[HALF] * sigma)
    for y in range(top, bottom):
        first, last = _row_span(p, y, beyond, beside, residual.shape[1])
        for x in range(first, last):
            s, t = (x - p[X]) * cos + (y - p[Y]) * sin, (y - p[Y]) * cos - (x - p[X]) * sin
            front, back = (s + p[HALF]) / sigma, (s - p[HALF]) / sigma
            along = _normal(front)[0] - _normal(back)[0]
            residual[y, x] -= np.float32(unit * along * _normal(t / sigma)[1])


@kernel
def best_stretch(
    residual: FloatImage, noise: Plane, p: FloatArray, reach: float, shortest: int, longest: int
) -> tuple[float, float]:
    """Middle and length of the stretch of a trail's line with the largest sum / √length, px from the trail's middle.

    The sum is that of the residual over the noise, clipped, weighted across the line with a Gaussian a little wider
    than the star image.

    Parameters
    ----------
    reach : float
        How far from the trail's middle the stretch may reach, px.
    shortest, longest : int
        Of its length, px.
    """
    cos, sin, around = math.cos(p[ANGLE]), math.sin(p[ANGLE]), math.ceil(reach)
    total = np.zeros(2 * around + 2)
    for k in range(2 * around + 1):
        s, light = k - around, 0.0
        for t in range(-2, 3):
            x, y = round(p[X] + s * cos - t * sin), round(p[Y] + s * sin + t * cos)
            if 0 <= x < residual.shape[1] and 0 <= y < residual.shape[0] and is_value(residual[y, x]):
                weight = math.exp(-0.5 * (t / (p[SIGMA] + 0.5)) ** 2)
                light += weight * min(max(residual[y, x] / noise[y, x], -_CLIP), 2.0 * _CLIP)
        total[k + 1] = total[k] + light
    best, begin, end = -np.inf, 0, len(total) - 1
    for length in range(shortest, min(longest + 1, len(total))):
        scale = 1.0 / math.sqrt(length)
        for first in range(len(total) - length):
            score = scale * (total[first + length] - total[first])
            if score > best:
                best, begin, end = score, first, first + length
    return 0.5 * (begin + end) - around - 0.5, float(end - begin)


@kernel
def _overlap(p: FloatArray, other: FloatArray) -> bool:
    """Whether the light of another trail reaches into the window of a trail."""
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    dx, dy = other[X] - p[X], other[Y] - p[Y]
    along = p[HALF] + other[HALF] + 2.0 * _BEYOND_SIGMAS * p[SIGMA]
    across = 2.0 * (_ACROSS_SIGMAS * p[SIGMA] + 2.0)
    return bool(abs(dx * cos + dy * sin) < along and abs(dy * cos - dx * sin) < across)


@kernel
def measure_trails(
    residual: FloatImage, noise: Plane, starts: FloatArray, inverse_gain: float, threshold: float, most: int
) -> Measured:
    """Fits of trails, each with the light of the others subtracted; the residual is left without them.

    Parameters
    ----------
    starts : (N, 7)
        Brightest first.
    threshold : float
        Least signal-to-noise ratio.
    most : int
        Trails wanted.
    """
    found, covariances = np.empty_like(starts), np.empty((len(starts), 3, 3))
    chi2s, freedoms = np.empty(len(starts)), np.empty(len(starts), np.int64)
    alone = np.zeros(len(starts), np.bool_)
    count = 0
    for n in range(len(starts)):
        if count == most:
            break
        start, length = starts[n].copy(), round(2.0 * starts[n, HALF])
        # noise gives the fit of a long trail several minima along it: begin at the deepest within some pixels
        away = min(max(0.05 * length, 3.0), 6.0)
        shift, _ = best_stretch(residual, noise, start, start[HALF] + away, length, length)
        start[X] += shift * math.cos(start[ANGLE])
        start[Y] += shift * math.sin(start[ANGLE])
        p, covariance, chi2, freedom = fit_trail(residual, noise, start, PLACE, 2.0, inverse_gain)
        for side in (-1.0, 1.0):
            # a search of clipped light finds bright trails to within some widths only
            if chi2 > _GOOD_CHI2:
                aside, off = start.copy(), side * _ASIDE_SIGMAS * start[SIGMA]
                aside[X] -= off * math.sin(start[ANGLE])
                aside[Y] += off * math.cos(start[ANGLE])
                other = fit_trail(residual, noise, aside, PLACE, 2.0, inverse_gain)
                if other[2] < chi2:
                    p, covariance, chi2, freedom = other
        strong = chi2 < np.inf and p[FLUX] >= threshold * math.sqrt(covariance[FLUX, FLUX])
        if not strong or math.hypot(p[X] - starts[n, X], p[Y] - starts[n, Y]) > 0.5 * p[HALF]:
            continue
        _subtract(residual, p, 1.0)
        found[count], covariances[count], chi2s[count], freedoms[count] = p, covariance[:3, :3], chi2, freedom
        count += 1
    for sweep in range(_SWEEPS):
        for n in range(count):
            crowded = False
            for other in range(count):
                crowded |= other != n and _overlap(found[n], found[other])
            bright = found[n, FLUX] > _BRIGHT_SNR * math.sqrt(covariances[n, FLUX, FLUX])
            if not (crowded or (bright and sweep == 0)):
                continue
            _subtract(residual, found[n], -1.0)
            size = SHAPE if bright else PLACE
            p, covariance, chi2, freedom = fit_trail(residual, noise, found[n], size, 2.0, inverse_gain)
            if chi2 < np.inf:
                found[n], covariances[n], chi2s[n], freedoms[n] = p, covariance[:3, :3], chi2, freedom
                alone[n] = bright
            _subtract(residual, found[n], 1.0)
    return Measured(found[:count], covariances[:count], chi2s[:count], freedoms[:count], alone[:count])
