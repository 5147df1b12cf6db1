"""Skewness that all star images of a frame share, and the shift it causes in centroids that assume a symmetric image.

Jitter within one exposure, or coma, skews all star images of a frame in the same way. A fit of a symmetric image then
deviates from the image's mean by a shift that is nearly the same for all stars: it rotates the attitude, and the
residuals of the positions do not show it. The pixels do. To first order a star's image is (Gram–Charlier series;
Kendall & Stuart 1977, *The Advanced Theory of Statistics 1*, § 6.17)

    F (G − κ_abc/6 ∂_abc G),     κ = (κ_xxx, κ_xxy, κ_xyy, κ_yyy)

with G the Gaussian of the frame and κ the third cumulants, px³. Let D be the derivatives of F G with respect to flux
and position, K those with respect to κ, and W the weights of a fit. A fit without κ then has a position error of A κ, A
= (Dᵀ W D)⁻¹ Dᵀ W K. The weights depend on the brightness: |A| is smallest for a star dominated by its photon noise, and
largest for a faint one.

The true position of a jittered star is the mean of its image. With coma it is the position with which the camera was
calibrated, that of centroids of stars of good signal (`REFERENCE_CONTRAST`), whose shift A₀ κ is part of the
distortion. One frame cannot distinguish the two. The shift relative to such stars, (A − A₀) κ, is an error in both
cases and is measured and subtracted (`startracker.centroid.asymmetry`); A₀ κ is included in the covariance of an error
that all positions share.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.centroid.frame import MODEL_STARS, brightest_alone
from startracker.centroid.window import Pixels, read_pixels
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.geometry.linalg import factorise, substitute

Shape: TypeAlias = tuple[float, float, float]
"""Variances along x and y and covariance of the star image, px²."""

REFERENCE_CONTRAST = 50.0
"""Ratio of photon to background noise (variances) in the brightest pixel of the stars on which calibrations are
based."""
_LOOKED_AT, _FEWEST = 27, 3
_NARROWEST = 0.3
"""Variance along the narrower axis, px², below which pixels do not resolve the third moments of an image."""
_LONGEST = 1.5**2
"""Ratio of the variances along the axes above which the image may be a streak."""
_PARAMETERS, _CUMULANTS = 10, 4
_FIRST = _PARAMETERS - _CUMULANTS
_LEAST_CHI2 = 7.8
"""χ² of κ (four degrees of freedom) that noise exceeds with a probability of 0.1."""
_PIXEL = 1.0 / 12.0


@kernel
def _expansion(u: float, v: float, shape: Shape, out: FloatArray) -> None:
    """Gram–Charlier expansion (10,) of a unit Gaussian at (u, v), px, from its centre, into `out`.

    Its value, and its derivatives with respect to x, y, xx, yy, xy and the four third cumulants. The pixel's variance,
    1/12 px², is added to the variances.
    """
    xx, yy, xy = shape[0] + _PIXEL, shape[1] + _PIXEL, shape[2]
    determinant = xx * yy - xy * xy
    a, b, c = yy / determinant, xx / determinant, -xy / determinant
    s, t = a * u + c * v, c * u + b * v
    g = math.exp(-0.5 * (s * u + t * v)) / (2.0 * math.pi * math.sqrt(determinant))
    out[0], out[1], out[2] = g, g * s, g * t
    out[3], out[4], out[5] = 0.5 * g * (s * s - a), 0.5 * g * (t * t - b), g * (s * t - c)
    out[6], out[7] = g * s * (s * s - 3.0 * a) / 6.0, g * (t * (s * s - a) - 2.0 * c * s) / 2.0
    out[8], out[9] = g * (s * (t * t - b) - 2.0 * c * t) / 2.0, g * t * (t * t - 3.0 * b) / 6.0


@kernel_part
def expansions_of(half: int, shape: Shape) -> FloatArray:
    """`_expansion` of a star centred on a pixel, (W², 10), for all pixels of its window."""
    side = 2 * half + 1
    out = np.empty((side * side, _PARAMETERS))
    for n in range(side * side):
        _expansion(float(n % side - half), float(n // side - half), shape, out[n])
    return out


@kernel
def shifts(expansions: FloatArray, variance: float, flux: float, inverse_gain: float, flat_error: float) -> FloatArray:
    """Matrix A (2, 4), px per px³: shift of a Gaussian fit from the mean of an image, per unit of its third cumulants.

    Parameters
    ----------
    expansions : (W², 10)
        Expansion of the Gaussian over the window, see `expansions_of`.
    variance : float
        Variance of a pixel in the dark, DN².
    flux : float
        Flux of the star, DN.
    inverse_gain, flat_error : float
        DN per electron and relative error of the flat field, which determine the weights.
    """
    normal, row = np.zeros((3, 3)), np.empty(3)
    right = np.zeros((_CUMULANTS, 3))
    for n in range(len(expansions)):
        column = expansions[n]
        light = flux * column[0]
        weight = 1.0 / (variance + light * inverse_gain + (flat_error * light) ** 2)
        for p in range(3):
            scaled = weight * column[p]
            for q in range(p + 1):
                normal[p, q] += scaled * column[q]
            for k in range(_CUMULANTS):
                right[k, p] += scaled * column[_FIRST + k]
    out = np.zeros((2, _CUMULANTS))
    if factorise(normal, len(normal)):
        for k in range(_CUMULANTS):
            for p in range(3):
                row[p] = right[k, p]
            substitute(normal, len(normal), row)
            out[0, k], out[1, k] = row[1], row[2]
    return out


@kernel
def common_skewness(
    pixels: Pixels, table: FloatArray, stars: IntArray, half: int, shape: Shape
) -> tuple[FloatArray, FloatArray, float, float]:
    """Third cumulants κ (4,) that stars share, their covariance (4, 4), χ² of κ, and the variance of a dark pixel.

    Weighted least squares in each star's flux, position and variances, and the common κ. The covariance is scaled by
    the scatter of the stars' own κ. All values are zero if fewer than three stars can be used.
    """
    side = 2 * half + 1
    work, column = np.empty((2, side * side)), np.empty(_PARAMETERS)
    normal, right = np.empty((_PARAMETERS, _PARAMETERS)), np.empty(_PARAMETERS)
    total, sums, square, count, variance = np.zeros((_CUMULANTS, _CUMULANTS)), np.zeros(_CUMULANTS), 0.0, 0, 0.0
    for n in stars:
        if not _equations_of_star(pixels, table[n], half, shape, normal, right, work, column):
            continue
        if not factorise(normal, len(normal)):
            continue
        # The last rows of Cholesky's factor hold the normal matrix of κ with the other unknowns eliminated.
        for p in range(_PARAMETERS):
            for q in range(p):
                right[p] -= normal[p, q] * right[q]
            right[p] /= normal[p, p]
        for p in range(_CUMULANTS):
            square += right[_FIRST + p] ** 2
            for m in range(p + 1):
                sums[p] += normal[_FIRST + p, _FIRST + m] * right[_FIRST + m]
                for q in range(m, _CUMULANTS):
                    total[p, q] += normal[_FIRST + p, _FIRST + m] * normal[_FIRST + q, _FIRST + m]
        variance += work[1, 0]
        count += 1
    mean, covariance = sums.copy(), np.zeros((_CUMULANTS, _CUMULANTS))
    if count < _FEWEST or not factorise(total, len(total)):
        return np.zeros(_CUMULANTS), covariance, 0.0, 1.0
    substitute(total, len(total), mean)
    chi2 = 0.0
    for p in range(_CUMULANTS):
        chi2 += mean[p] * sums[p]
    factor = max((square - chi2) / (_CUMULANTS * (count - 1.0)), 1.0)
    for p in range(_CUMULANTS):
        covariance[p, p] = factor
        substitute(total, len(total), covariance[p])
    return mean, covariance, chi2 / factor, variance / count


@kernel
def _equations_of_star(
    pixels: Pixels,
    star: FloatArray,
    half: int,
    shape: Shape,
    normal: FloatArray,
    right: FloatArray,
    work: FloatArray,
    column: FloatArray,
) -> bool:
    """Normal equations of one star's flux, position, variances and third cumulants; returns whether its window is
    complete.

    `work` (2, W²) receives the pixels' signal and variance in the dark; `column` (10,) is working space.
    """
    side = 2 * half + 1
    x, y, flux, signal, dark = star[0], star[1], star[2], work[0], work[1]
    left, top = round(x) - half, round(y) - half
    if left < 0 or top < 0 or left + side > pixels.image.shape[1] or top + side > pixels.image.shape[0]:
        return False
    if read_pixels(pixels, left, top, side, side, np.inf, signal, dark) < side * side:
        return False
    normal[:], right[:], pixel = 0.0, 0.0, np.uint64(0)
    for j in range(side):
        for i in range(side):
            _expansion(left + i - x, top + j - y, shape, column)
            light = flux * column[0]
            weight = flux / (dark[pixel] + light * pixels.inverse_gain + (pixels.flat_error * light) ** 2)
            residual = signal[pixel] - light
            for p in range(_PARAMETERS):
                scaled = weight * column[p]
                right[p] += scaled * residual
                for q in range(p + 1):
                    normal[p, q] += scaled * flux * column[q]
            pixel += np.uint64(1)
    return True


def skewness_covariance(pixels: Pixels, table: FloatArray, unfit: BoolArray, half: int, shape: Shape) -> FloatArray:
    """Covariance (2, 2), px², of the shift A₀ κ that all positions share; zero if the images are not skewed.

    κ is ignored if it may be noise, and otherwise multiplied by 1 − (7.8/χ²)², which is continuous at that limit.

    Parameters
    ----------
    table : (N, 6)
        Fits, see `startracker.centroid.psf_kernel.FITTED`.
    unfit : bool (N,)
        Stars that are saturated or at the border.
    half : int
        Half width of the fits' windows, px.
    shape : (float, float, float)
        Variances along x and y and covariance of the fitted image, px².
    """
    xx, yy, xy = shape
    common = np.zeros((2, 2))
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    # The first test excludes undersampled images, the second streaks.
    if not middle - spread > _NARROWEST or middle + spread > _LONGEST * (middle - spread):
        return common
    x, y, flux = np.ascontiguousarray(table[:, :3].T)  # strided columns would need another compilation
    stars = brightest_alone(x, y, flux, unfit, _LOOKED_AT, MODEL_STARS)
    _fill_covariance(pixels, table, stars, half, shape, common)
    return common


@kernel
def _fill_covariance(
    pixels: Pixels, table: FloatArray, stars: IntArray, half: int, shape: Shape, common: FloatArray
) -> None:
    """Add the covariance of `skewness_covariance`, from the skewness of some stars, to `common`."""
    mean, covariance, chi2, dark = common_skewness(pixels, table, stars, half, shape)
    if not chi2 > _LEAST_CHI2:
        return
    xx, yy, xy = shape
    kept, inverse_gain = 1.0 - (_LEAST_CHI2 / chi2) ** 2, pixels.inverse_gain
    peak = 1.0 / (2.0 * math.pi * math.sqrt((xx + _PIXEL) * (yy + _PIXEL) - xy * xy))
    # Flux of a star of the reference contrast, whose peak photon noise is that multiple of the background noise.
    at_reference = REFERENCE_CONTRAST * dark / (inverse_gain * peak) if inverse_gain > 0.0 else 0.0
    reference = shifts(expansions_of(half, shape), dark, at_reference, inverse_gain, 0.0)
    for a in range(2):
        for b in range(2):
            for k in range(_CUMULANTS):
                for m in range(_CUMULANTS):
                    square = kept * covariance[k, m] + kept * kept * mean[k] * mean[m]
                    common[a, b] += reference[a, k] * square * reference[b, m]
