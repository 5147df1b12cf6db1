"""Skewness that all star images of a frame share, and how far it moves centroids that a symmetric image is fitted to.

Jitter within one exposure, or coma, makes all star images skew alike. A fit of a symmetric image is then off the
image's mean by a shift that is nearly the same for all stars: the attitude turns, and no residual of the positions
shows it. The pixels do. To first order a star's image is (Gram-Charlier series; Kendall & Stuart 1977, *The Advanced
Theory of Statistics 1*, § 6.17)

    F (G − κ_abc/6 ∂_abc G),     κ = (κ_xxx, κ_xxy, κ_xyy, κ_yyy)

with G the Gaussian of the frame and κ the third cumulants, px³. With D the derivatives of F G by flux and position, K
those by κ, and W the weights of a fit, the fit without κ finds the position off by A κ, A = (Dᵀ W D)⁻¹ Dᵀ W K. The
weights depend on the brightness: |A| is smallest for a star whose photon noise outweighs the rest, largest for a faint
one.

A jittered star's true position is the mean of its image. With coma it is what the camera was calibrated with, centroids
of stars of good signal (`REFERENCE_CONTRAST`), whose shift A₀ κ is part of its distortion. One frame cannot say which
it is. The shift against such stars, (A − A₀) κ, is an error in both cases and is taken off; A₀ κ is in the covariance
of an error that all positions share.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.cholesky import factorise, substitute
from startracker.centroid.window import read_pixels
from startracker.detection.plane import Plane
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = ["REFERENCE_CONTRAST", "correct_skewness", "shifts"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

REFERENCE_CONTRAST = 50.0
"""Photon noise over background noise (variances) in the brightest pixel of the stars that calibrations rest upon."""
_STARS, _FEWEST = 9, 3
_APART_PX = 16.0
_NARROWEST = 0.3
"""Variance along the narrower axis, px²: pixels do not resolve the third moments of a narrower image."""
_LONGEST = 1.5**2
"""Ratio of the variances along the axes from which the image may be a streak."""
_PARAMETERS, _CUMULANTS = 10, 4
_FIRST = _PARAMETERS - _CUMULANTS
_LEAST_CHI2 = 7.8
"""χ² of κ (four degrees of freedom) that noise exceeds once in ten times."""
_PIXEL = 1.0 / 12.0


@kernel
def _expansion(u: float, v: float, xx: float, yy: float, xy: float, out: FloatArray) -> None:
    """A unit Gaussian at (u, v) from its centre, and what one unit of x, y, its variances and covariance, and its third
    cumulants adds, to `out` (10,); the pixel's width is taken into the variances."""
    xx, yy = xx + _PIXEL, yy + _PIXEL
    determinant = xx * yy - xy * xy
    a, b, c = yy / determinant, xx / determinant, -xy / determinant
    s, t = a * u + c * v, c * u + b * v
    g = math.exp(-0.5 * (s * u + t * v)) / (2.0 * math.pi * math.sqrt(determinant))
    out[0], out[1], out[2] = g, g * s, g * t
    out[3], out[4], out[5] = 0.5 * g * (s * s - a), 0.5 * g * (t * t - b), g * (s * t - c)
    out[6], out[7] = g * s * (s * s - 3.0 * a) / 6.0, g * (t * (s * s - a) - 2.0 * c * s) / 2.0
    out[8], out[9] = g * (s * (t * t - b) - 2.0 * c * t) / 2.0, g * t * (t * t - 3.0 * b) / 6.0


@kernel
def shifts(
    variance: float, flux: float, half: int, xx: float, yy: float, xy: float, inverse_gain: float, flat_error: float
) -> FloatArray:
    """A (2, 4), px per px³: how far a fit of a Gaussian is off the mean of an image, by its third cumulants.

    Parameters
    ----------
    variance : float
        Of a pixel in the dark, DN².
    flux : float
        Of the star, DN.
    half : int
        Half width of the fit's window.
    xx, yy, xy : float
        Variances and covariance of the Gaussian, px².
    inverse_gain, flat_error : float
        DN an electron, and the relative error of the flat field: of the weights.
    """
    found: FloatArray = _shifts(_expansions(half, xx, yy, xy), variance, flux, inverse_gain, flat_error)
    return found


@kernel
def _expansions(half: int, xx: float, yy: float, xy: float) -> FloatArray:
    """`_expansion` of a star in the middle of a pixel (W², 10), for all pixels of its window."""
    side = 2 * half + 1
    out = np.empty((side * side, _PARAMETERS))
    for n in range(side * side):
        _expansion(float(n % side - half), float(n // side - half), xx, yy, xy, out[n])
    return out


@kernel
def _shifts(expansions: FloatArray, variance: float, flux: float, inverse_gain: float, flat_error: float) -> FloatArray:
    """`shifts` by the expansions over the window."""
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
    if factorise(normal, 3):
        for k in range(_CUMULANTS):
            row[0], row[1], row[2] = right[k, 0], right[k, 1], right[k, 2]
            substitute(normal, 3, row)
            out[0, k], out[1, k] = row[1], row[2]
    return out


@kernel
def _chosen(table: FloatArray, unfit: BoolArray) -> IntArray:
    """Brightest stars with no other nearby."""
    out, count = np.empty(_STARS, np.int64), 0
    looked_at = np.zeros(len(table), np.bool_)
    for _ in range(min(3 * _STARS, len(table))):
        best = -1
        for n in range(len(table)):
            usable = not (looked_at[n] or unfit[n]) and math.isfinite(table[n, 0] + table[n, 1] + table[n, 2])
            if usable and (best < 0 or table[n, 2] > table[best, 2]):
                best = n
        if best < 0 or count == _STARS:
            break
        looked_at[best], alone = True, True
        for m in range(len(table)):
            near = abs(table[m, 0] - table[best, 0]) < _APART_PX and abs(table[m, 1] - table[best, 1]) < _APART_PX
            alone = alone and (not near or m == best)
        if alone:
            out[count] = best
            count += 1
    return out[:count]


@kernel
def common_skewness(
    image: Image,
    level: Plane,
    noise: Plane,
    table: FloatArray,
    stars: IntArray,
    half: int,
    xx: float,
    yy: float,
    xy: float,
    inverse_gain: float,
    flat_error: float,
) -> tuple[FloatArray, FloatArray, float, float]:
    """Third cumulants κ (4,) that stars share, their covariance (4, 4), χ² of κ, and the variance of a dark pixel.

    Weighted least squares in each star's flux, position and variances, and the κ of all. The covariance is as much
    larger as the stars' own κ scatter about it. All zero where fewer than three stars count.
    """
    height, width = image.shape
    side = 2 * half + 1
    signal, dark = np.empty(side * side), np.empty(side * side)
    normal, right, column = np.empty((_PARAMETERS, _PARAMETERS)), np.empty(_PARAMETERS), np.empty(_PARAMETERS)
    total, sums, square, count, variance = np.zeros((_CUMULANTS, _CUMULANTS)), np.zeros(_CUMULANTS), 0.0, 0, 0.0
    for n in stars:
        x, y, flux = table[n, 0], table[n, 1], table[n, 2]
        left, top = round(x) - half, round(y) - half
        if left < 0 or top < 0 or left + side > width or top + side > height:
            continue
        if read_pixels(image, level, noise, left, top, side, side, np.inf, signal, dark) < side * side:
            continue
        normal[:], right[:], pixel = 0.0, 0.0, np.uint64(0)
        for j in range(side):
            for i in range(side):
                _expansion(left + i - x, top + j - y, xx, yy, xy, column)
                light = flux * column[0]
                weight = flux / (dark[pixel] + light * inverse_gain + (flat_error * light) ** 2)
                residual = signal[pixel] - light
                for p in range(_PARAMETERS):
                    scaled = weight * column[p]
                    right[p] += scaled * residual
                    for q in range(p + 1):
                        normal[p, q] += scaled * flux * column[q]
                pixel += np.uint64(1)
        if not factorise(normal, _PARAMETERS):
            continue
        # the last rows of Cholesky's factor are that of κ's normal matrix, the others eliminated
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
        variance += dark[0]
        count += 1
    mean, covariance = sums.copy(), np.zeros((_CUMULANTS, _CUMULANTS))
    if count < _FEWEST or not factorise(total, _CUMULANTS):
        return np.zeros(_CUMULANTS), covariance, 0.0, 1.0
    substitute(total, _CUMULANTS, mean)
    chi2 = 0.0
    for p in range(_CUMULANTS):
        chi2 += mean[p] * sums[p]
    factor = max((square - chi2) / (_CUMULANTS * (count - 1.0)), 1.0)
    for p in range(_CUMULANTS):
        covariance[p, p] = factor
        substitute(total, _CUMULANTS, covariance[p])
    return mean, covariance, chi2 / factor, variance / count


@kernel
def correct_skewness(
    image: Image,
    level: Plane,
    noise: Plane,
    table: FloatArray,
    unfit: BoolArray,
    half: int,
    shape: tuple[float, float, float],
    inverse_gain: float,
    flat_error: float,
) -> FloatArray:
    """Take the shift against stars of `REFERENCE_CONTRAST` off the positions of fits; the rest as a covariance.

    κ is left out where it may be noise, and shrunk by 1 − (7.8/χ²)² where it is not, which is steady at the limit.

    Parameters
    ----------
    table : (N, 6)
        Fits; their positions are corrected in place.
    unfit : bool (N,)
        Stars that are saturated or at the border.
    half : int
        Half width of the fits' windows.
    shape : (float, float, float)
        Variances along x and y and covariance of the star image, px².

    Returns
    -------
    (2, 2) array
        Covariance of an error that all positions share, px²; zero where the images are not skew.
    """
    xx, yy, xy = shape
    common = np.zeros((2, 2))
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    if not middle - spread > _NARROWEST or middle + spread > _LONGEST * (middle - spread):
        return common
    stars = _chosen(table, unfit)
    mean, covariance, chi2, dark = common_skewness(
        image, level, noise, table, stars, half, xx, yy, xy, inverse_gain, flat_error
    )
    if not chi2 > _LEAST_CHI2:
        return common
    kept = 1.0 - (_LEAST_CHI2 / chi2) ** 2
    peak = 1.0 / (2.0 * math.pi * math.sqrt((xx + _PIXEL) * (yy + _PIXEL) - xy * xy))
    at_reference = REFERENCE_CONTRAST * dark / (inverse_gain * peak) if inverse_gain > 0.0 else 0.0
    expansions = _expansions(half, xx, yy, xy)
    reference = _shifts(expansions, dark, at_reference, inverse_gain, 0.0)
    for n in range(len(table)):
        if not (math.isfinite(table[n, 0] + table[n, 2]) and table[n, 2] > 0.0) or unfit[n]:
            continue
        here = _shifts(expansions, dark, table[n, 2], inverse_gain, flat_error)
        for axis in range(2):
            for k in range(_CUMULANTS):
                table[n, axis] -= kept * (here[axis, k] - reference[axis, k]) * mean[k]
    for a in range(2):
        for b in range(2):
            for k in range(_CUMULANTS):
                for m in range(_CUMULANTS):
                    square = kept * covariance[k, m] + kept * kept * mean[k] * mean[m]
                    common[a, b] += reference[a, k] * square * reference[b, m]
    return common
