"""Star image of a frame, measured from its brightest stars: an elliptical or a smeared Gaussian."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.centroid.bias import SMALLEST_SIGMA_PX
from startracker.centroid.frame import MODEL_STARS, Prepared, brightest_alone
from startracker.centroid.psf_kernel import Starts, fit_stars
from startracker.centroid.psf_model import PsfModel, gaussian_psf
from startracker.centroid.psf_sums import normal_equations
from startracker.centroid.window import Pixels, read_pixels
from startracker.core import FloatArray, IntArray
from startracker.detection.spots import Spots
from startracker.geometry.linalg import factorise, substitute

Shape: TypeAlias = tuple[float, float, float]

_LOOKED_AT, _FEWEST_ALONE = 18, 3
LARGEST_HALF_PX = 8
_NODES = np.polynomial.legendre.leggauss(3)[0] / 2.0
_WEIGHTS = np.polynomial.legendre.leggauss(3)[1] / 2.0
_STEPS = 40
_CONVERGED = 1e-3
_LEAST_SNR = 12.0
"""Least signal-to-noise ratio of a star, unless it is one of the three brightest: among fainter objects the selection
by noise favours narrow ones, some of which are noise alone."""
_NARROW = 0.11
"""Variance along the narrower axis, px², below which pixels do not resolve the orientation."""
_DAMPED = 12
"""Number of steps after which the steps are halved."""
_LONGEST_STEP, _SHORTEST = 0.4, 1e-3
"""Longest step, in units of the smaller variance or of 1 px², whichever is smaller, and shortest factor of a step."""
_LENGTHS = (0.9, 1.0, 1.1)
_LEAST_CHI2 = 9.0
"""Square of the covariance over its variance, from nine stars, below which the covariance is set to zero."""
_STREAK_RATIO = 1.5
"""Ratio of the axes above which a line is tried in place of an ellipse."""


class _Space(NamedTuple):
    """Working space of `fit_gaussian` for N stars and windows of M pixels, W wide."""

    pixels: FloatArray
    """(4, M)."""
    slopes: FloatArray
    """(6, M)."""
    factors: FloatArray
    """(6, 3 W)."""
    at: FloatArray
    """Position and flux (N, 5) of each star, and the central pixel of its window; NaN if the star is excluded."""
    normal: FloatArray
    """Normal equations (N, 6, 6) in x, y, ln(flux), xx, yy, xy, factorised."""
    right: FloatArray
    """(N, 6)."""


def fit_gaussian(
    pixels: Pixels, starts: Starts, stars: IntArray, half: int, shape: Shape, contrast: float = 0.0
) -> tuple[Shape, tuple[float, float]]:
    """Pixel-integrated Gaussian that fits all of some stars.

    Gauss–Newton in x, y and ln(flux) of each star and the common xx, yy, xy, weighted with the noise of the model; a
    star that does not fit, such as a star of another image, gets a weight reduced in proportion to its χ². A single
    undersampled star hardly shows its width if it is centred on a pixel, and its orientation then depends on the
    position within the pixel: medians of fits to single stars are too wide, and have random orientations. A wrong
    orientation displaces all stars of an asymmetric image, by half a pixel per px². So the covariance is multiplied by
    1 − (9 s²/xy²)², where s² is its variance from the scatter of the stars (Huber 1967, *Proc. Fifth Berkeley Symposium
    1*, 221). It is set to zero if the image is so narrow that two orientations fit, each with a different position.

    Parameters
    ----------
    pixels, starts
        The frame, and approximate positions.
    stars : int (N,)
        Stars to fit.
    half : int
        Half width of their windows, px.
    shape : (float, float, float)
        Initial variances along x and y and covariance, px².
    contrast : float
        Ratio of photon to background noise (variances) in the brightest pixel for which the weights are computed; 0:
        the actual ratio of each star.
    """
    side, found, count = 2 * half + 1, np.full(6, np.nan), len(stars)
    factors = np.empty((3 + len(_NODES), len(_NODES) * side))
    x, y = starts.x[stars], starts.y[stars]
    at = np.column_stack([x, y, np.ones(count), np.rint(x), np.rint(y)])
    normal, right = np.empty((count, 6, 6)), np.empty((count, 6))
    space = _Space(np.empty((4, side**2)), np.empty((6, side**2)), factors, at, normal, right)
    _fit_gaussian(pixels, contrast, half, shape, space, found)
    xx, yy, xy, error_xx, error_yy, variance = found.tolist()
    if count >= _FEWEST_ALONE and xy != 0.0:
        xy *= max(1.0 - (_LEAST_CHI2 * variance / (xy * xy)) ** 2, 0.0) if min(xx, yy) > _NARROW else 0.0
    return (xx, yy, xy), (math.sqrt(error_xx), math.sqrt(error_yy))


@kernel
def _fit_gaussian(pixels: Pixels, contrast: float, half: int, shape: Shape, space: _Space, found: FloatArray) -> None:
    """Fill the shape of some stars and the variances of its three parts, (6,), if they can be fitted."""
    (a, b, c), at, total, change, own = shape, space.at, np.empty((3, 3)), np.empty(3), np.empty((len(space.at), 3))
    for step in range(_STEPS):
        total[:], change[:], used = 0.0, 0.0, 0
        for n in range(len(at)):
            if not math.isfinite(at[n, 0] + at[n, 1]):
                continue
            weight = _equations_of_star(pixels, contrast, half, (a, b, c), space, n, step == 0)
            if not weight > 0.0:
                at[n, 0] = np.nan
                continue
            used += 1
            # After Cholesky's factorisation with the star's own unknowns first, the last rows hold the normal matrix of
            # the shape with these eliminated.
            factor, right = space.normal[n], space.right[n]
            for p in range(3):
                own[n, p] = 0.0
                for m in range(p + 1):
                    own[n, p] += weight * factor[3 + p, 3 + m] * right[3 + m]
                    for q in range(m, 3):
                        total[p, q] += weight * factor[3 + p, 3 + m] * factor[3 + q, 3 + m]
                change[p] += own[n, p]
        if step == 0:  # the first step only finds the fluxes
            continue
        if used == 0 or not factorise(total, len(total)):
            return
        substitute(total, len(total), change)
        largest = max(abs(change[0]), abs(change[1]), abs(change[2]))
        if not math.isfinite(largest):
            return
        part = 1.0 if step < _DAMPED else 0.5  # fits of faint stars may oscillate
        short = min(part, _LONGEST_STEP * min(a, b, 1.0) / largest) if largest > 0.0 else 1.0
        while short > _SHORTEST and not _is_ellipse(
            a + short * change[0], b + short * change[1], c + short * change[2]
        ):
            short *= 0.5
        for p in range(3):
            change[p] *= short
        a, b, c = a + change[0], b + change[1], c + change[2]
        if not _is_ellipse(a, b, c):
            return
        farthest = _move_stars(space, change, min(a, b, 1.0), half, part)
        if max(largest, farthest) < _CONVERGED or (step > _DAMPED and largest < _CONVERGED):
            found[0], found[1], found[2] = a, b, c
            found[3:] = 0.0
            # Sandwich estimate (Huber 1967): the scatter of the stars' contributions to the last step.
            for n in range(len(at)):
                if math.isfinite(at[n, 0]):
                    substitute(total, len(total), own[n])
                    for p in range(3):
                        found[3 + p] += own[n, p] ** 2 * used / max(used - 1.0, 0.5)
            return


@kernel_part
def _is_ellipse(xx: float, yy: float, xy: float) -> bool:
    """Whether the variances and the covariance are those of an ellipse that is not too narrow."""
    return xx > 0.0 and xx * yy - xy * xy > SMALLEST_SIGMA_PX**4


@kernel
def _move_stars(space: _Space, change: FloatArray, scale: float, half: int, part: float) -> float:
    """Move the stars by the steps that correspond to a change (3,) of the shape; returns the longest full step."""
    step, longest = np.empty(3), 0.0
    for n in range(len(space.at)):
        star, factor = space.at[n], space.normal[n]
        if not math.isfinite(star[0] + star[1]):
            continue
        largest = 0.0
        # Back substitution of the star's three unknowns, with the change of the shape given.
        for p in range(2, -1, -1):
            step[p] = space.right[n, p]
            for q in range(p + 1, 6):
                step[p] -= factor[q, p] * (step[q] if q < 3 else change[q - 3])
            step[p] /= factor[p, p]
            largest = max(largest, abs(step[p]))
        short = min(part, _LONGEST_STEP * scale / largest) if largest > 0.0 else 1.0
        star[0], star[1], star[2] = (
            star[0] + short * step[0],
            star[1] + short * step[1],
            star[2] * math.exp(short * step[2]),
        )
        if max(abs(star[0] - star[3]), abs(star[1] - star[4])) < half:
            longest = max(longest, largest)
        else:
            star[0] = np.nan
    return longest


@kernel
def _equations_of_star(
    pixels: Pixels, contrast: float, half: int, shape: Shape, space: _Space, n: int, is_first: bool
) -> float:
    """Compute and factorise the normal equations of star n, in `space.normal` and `space.right`.

    Returns their weight, the inverse of χ² per degree of freedom, at most 1; 0 if there are none. On the first call
    only the flux is computed.
    """
    height, width = pixels.image.shape
    x, y, flux, middle, row = space.at[n]
    left, top = max(int(middle) - half, 0), max(int(row) - half, 0)
    wide, high = min(int(middle) + half + 1, width) - left, min(int(row) + half + 1, height) - top
    count, work, slopes, normal, right = wide * high, space.pixels, space.slopes, space.normal[n], space.right[n]
    if wide < 2 or high < 2:
        return 0.0
    signal, dark, weights, residuals = work[0, :count], work[1, :count], work[2, :count], work[3, :count]
    read_pixels(pixels, left, top, wide, high, np.inf, signal, dark)
    _gaussian_slopes((left - x, top - y), wide, high, shape, slopes, space.factors)
    above, below, chi2, used, peak = 0.0, 0.0, 0.0, 0, 0.0
    for k in range(count):
        peak = max(peak, slopes[2, k])
    for k in range(count):
        light = max(signal[k], 0.0) if is_first else flux * slopes[2, k]
        more = light * pixels.inverse_gain
        if contrast > 0.0 and not is_first:
            more = contrast * dark[k] * max(slopes[2, k], 0.0) / peak
        weights[k] = 1.0 / (dark[k] + more)
        above += weights[k] * slopes[2, k] * signal[k]
        below += weights[k] * slopes[2, k] * slopes[2, k]
        residuals[k] = signal[k] - light
        chi2 += weights[k] * residuals[k] * residuals[k]
        used += weights[k] > 0.0
    if is_first:
        space.at[n, 2] = above / below
        return above if n < _FEWEST_ALONE or above > _LEAST_SNR * math.sqrt(below) else 0.0
    # A loop, because for an array expression numba also compiles the text of its error, which takes seconds.
    for m in range(6):
        for k in range(count):
            slopes[m, k] *= flux
    normal_equations(slopes, weights, residuals, normal, right)
    # A minute ridge, so that an unknown without information does not stop the factorisation.
    for m in range(6):
        normal[m, m] *= 1.0 + 1e-9
        if not normal[m, m] > 0.0:
            normal[m, m] = 1.0
    if not factorise(normal, len(normal)):
        return 0.0
    for p in range(6):
        for q in range(p):
            right[p] -= normal[p, q] * right[q]
        right[p] /= normal[p, p]
    return 1.0 / max(chi2 / max(used - 6.0, 1.0), 1.0)


@kernel
def _gaussian_slopes(
    corner: tuple[float, float], wide: int, high: int, shape: Shape, out: FloatArray, factors: FloatArray
) -> None:
    """Derivatives (6, N) of a unit Gaussian with respect to x, y, ln(flux), xx, yy, xy in the pixels of a window.

    The first pixel is at `corner` from the centre of the star; pixels are integrated with 3 × 3 Gauss–Legendre nodes.
    The Gaussian is a product of a factor of x, a factor of y and a factor of both, which is updated from pixel to pixel
    by multiplication.
    """
    nodes, (left, top), (a, b, c) = len(_NODES), corner, shape
    along_x, along_y, step_y, both = factors[0], factors[1], factors[2], factors[3:]
    determinant = a * b - c * c
    ia, ib, ic = b / determinant, a / determinant, -c / determinant
    scale = 1.0 / (2.0 * math.pi * math.sqrt(determinant))
    for k in range(nodes * wide):
        u = left + k // nodes + _NODES[k % nodes]
        along_x[k] = scale * _WEIGHTS[k % nodes] * math.exp(-0.5 * ia * u * u)
        step_y[k] = math.exp(-ic * u) if k < nodes else math.exp(-ic) * step_y[k - nodes]
    for t in range(nodes):
        v = top + _NODES[t]
        step_x = math.exp(-ic * v)
        for k in range(nodes * wide):
            both[t, k] = math.exp(-ic * (left + _NODES[k]) * v) if k < nodes else step_x * both[t, k - nodes]
    for k in range(nodes * high):
        v = top + k // nodes + _NODES[k % nodes]
        along_y[k] = _WEIGHTS[k % nodes] * math.exp(-0.5 * ib * v * v)
    pixel = np.uint64(0)
    for j in range(high):
        for i in range(wide):
            total, u1, v1, uu, uv, vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for t in range(nodes):
                v = top + j + _NODES[t]
                row, row_u, row_uu = 0.0, 0.0, 0.0
                for s in range(nodes):
                    k, u = i * nodes + s, left + i + _NODES[s]
                    p = along_x[k] * both[t, k]
                    row, row_u, row_uu = row + p, row_u + p * u, row_uu + p * u * u
                    both[t, k] *= step_y[k]
                g = along_y[j * nodes + t]
                total, u1, uu = total + g * row, u1 + g * row_u, uu + g * row_uu
                v1, uv, vv = v1 + g * row * v, uv + g * row_u * v, vv + g * row * v * v
            # With the inverse covariance matrix (ia, ic; ic, ib), the derivatives are moments of the light in the
            # pixel.
            out[0, pixel], out[1, pixel], out[2, pixel] = ia * u1 + ic * v1, ic * u1 + ib * v1, total
            out[3, pixel] = 0.5 * (ia * ia * uu + 2.0 * ia * ic * uv + ic * ic * vv - ia * total)
            out[4, pixel] = 0.5 * (ic * ic * uu + 2.0 * ic * ib * uv + ib * ib * vv - ib * total)
            out[5, pixel] = ia * ic * uu + (ia * ib + ic * ic) * uv + ic * ib * vv - ic * total
            pixel += np.uint64(1)


def frame_psf(frame: Prepared, spots: Spots, starts: Starts, sigmas: tuple[float, float], reach_px: float) -> PsfModel:
    """Star image of a frame.

    It is the ellipse of the brightest clean stars (`fit_gaussian`). If the ellipse is elongated, a round Gaussian moved
    along a line replaces it if it has the smaller χ² for the same stars. The length L of the line follows from L² = 12
    × the difference of the principal variances, and is then refined by a parabola through χ² at this length and at a
    tenth less and more.

    Parameters
    ----------
    starts : Starts
        Approximate positions of the spots.
    sigmas : (float, float)
        Widths along x and y from the moments, px: the starting values, and the result if no star can be measured.
    reach_px : float
        Least half width of the table.
    """
    half = min(max(frame.half, math.ceil(2.5 * max(sigmas))), LARGEST_HALF_PX)
    unfit = spots.saturated | spots.edge
    chosen = brightest_alone(starts.x, starts.y, spots.flux, unfit, _LOOKED_AT, MODEL_STARS)
    if len(chosen) < _FEWEST_ALONE:
        chosen = np.flatnonzero(~unfit & np.isfinite(starts.x + starts.y))[:MODEL_STARS]
    xx, yy, xy = start = max(sigmas[0], SMALLEST_SIGMA_PX) ** 2, max(sigmas[1], SMALLEST_SIGMA_PX) ** 2, 0.0
    found, errors = fit_gaussian(frame.pixels, starts, chosen, half, start)
    if found[0] * found[1] - found[2] ** 2 > SMALLEST_SIGMA_PX**4:
        xx, yy, xy = found
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    radius = max(reach_px, 2.5 * math.sqrt(middle + spread) + 2.0)
    known = errors if math.isfinite(errors[0] + errors[1]) else (0.0, 0.0)
    ellipse = gaussian_psf(xx, yy, xy, radius_px=radius, width_error=known)
    minor, major = middle - spread, middle + spread
    if major < _STREAK_RATIO**2 * minor or math.isnan(found[0]):
        return ellipse
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    window = min(math.ceil(2.5 * math.sqrt(major)), LARGEST_HALF_PX)
    stars = Starts(starts.x[chosen], starts.y[chosen], np.full(len(chosen), window), np.full(len(chosen), np.inf))
    length = math.sqrt(12.0 * (major - minor))
    along, across = length * math.cos(angle), length * math.sin(angle)
    round_one = gaussian_psf(minor, minor, radius_px=radius)
    lines = [round_one.smeared(f * along, f * across) for f in _LENGTHS]
    misfits = [_misfit(frame, model, stars) for model in lines]
    if min(misfits) > _misfit(frame, ellipse, stars):
        return ellipse
    square, slope, _ = np.polyfit(_LENGTHS, misfits, 2)
    if not square > 0:
        return lines[int(np.argmin(misfits))]
    best = min(max(-0.5 * slope / square, 2 * _LENGTHS[0] - _LENGTHS[1]), 2 * _LENGTHS[2] - _LENGTHS[1])
    return round_one.smeared(best * along, best * across)


def _misfit(frame: Prepared, model: PsfModel, stars: Starts) -> float:
    """Median χ² per degree of freedom of stars; a star that cannot be fitted counts as a very bad fit."""
    fits = fit_stars(frame.pixels, model.samples, stars, np.arange(len(stars.x)), True)
    return float(np.median(np.nan_to_num(fits[:, 6] / fits[:, 7], nan=1e6)))
