"""Centroiders that use the image of a star: weighted moment, least squares, maximum likelihood."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel
from startracker.centroid.asymmetry import (
    EXAMINED,
    EXAMINED_ASYMMETRIC,
    correct_asymmetry,
    measure_difference,
    reference_psf,
    unknown_reference,
)
from startracker.centroid.frame import Prepared, collect, measure_moments, prepare
from startracker.centroid.psf_kernel import Starts, fit_stars, group_stars, weighted_moments
from startracker.centroid.psf_model import PsfModel, gaussian_psf, load_psf
from startracker.centroid.psf_shape import frame_psf
from startracker.centroid.result import Centroids, misfit_of_brightest
from startracker.centroid.skewness import skewness_covariance
from startracker.centroid.window import MEASURED, Peaks, Pixels
from startracker.core import FloatArray, IntArray
from startracker.detection.background import Background
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.errors import InputError
from startracker.settings import CentroidSettings

_LARGEST_HALF_PX = 8
_WIDTHS = 2.5
"""Half width of the window in units of σ of the star image."""
_CEILING_SHARE = 0.9
"""Share of a saturated star's highest signal above which pixels may be saturated, because full wells differ."""
SYSTEMATIC_PX = 0.001
"""Floor of a position's standard deviation, px: twice the interpolation error of the table. It is smaller than for
moments, because a deviation from the assumed star image shows in the residuals of the fit and enlarges the
covariance."""
MISFIT_SIGMA = 4.0
"""Excess of a fit's χ² over its mean, in standard deviations, above which the covariance is multiplied by χ²/ν."""
_SURELY_HOT = 10.0
"""Likelihood ratio of a hot pixel to a star above which a detection is rejected."""
_ASTRAY_PX = 1.5
_UNDERSAMPLED_PX2 = 0.35
"""Variance along the narrower axis, px², above which an error of the image's width or shape does not move a star by its
position within the pixel: exp(−2 π² 0.35) is 0.001."""


def weighted_moment(
    image: Image,
    background: Background,
    spots: Spots,
    settings: CentroidSettings | None = None,
    gain_e_per_dn: float | None = None,
) -> Centroids:
    """Centroids by the first moment under a Gaussian weight that follows the star (XWIN of Bertin & Arnouts).

    The weight has the widths and the orientation of the star image, so that for faint stars the result is as accurate
    as a fit, and distant pixels of the window contribute no noise. The moment that the star image itself has at the
    position found is subtracted (``bias_correction``), including the effects of bad pixels and borders.

    Parameters, errors raised and result are those of `startracker.centroid.first_moment`; pixels that are not finite
    are excluded from the sums. A star for which the iteration fails, or whose image is saturated, gets its
    `first_moment`.
    """
    frame = prepare(image, background, settings, gain_e_per_dn)
    if not len(spots):
        return Centroids.none()
    moments, sigmas = measure_moments(frame, spots)
    table, psf = weighted_table(frame, spots, moments, sigmas)
    return collect(table, _widths(psf), spots, max(frame.half, math.ceil(psf.sigma_px)))


def weighted_table(
    frame: Prepared, spots: Spots, moments: FloatArray, sigmas: tuple[float, float]
) -> tuple[FloatArray, PsfModel]:
    """Measurements (N, 6) by weighted moments, with `moments` (N, 6) where these fail, and the star image."""
    psf, starts = _start(frame, spots, moments, sigmas)
    samples = psf.samples._replace(table=psf.table)
    table = np.asarray(weighted_moments(frame.pixels, samples, starts, psf.shape, frame.settings.bias_correction))
    failed = ~np.isfinite(table).all(axis=1) | spots.saturated
    table[failed] = moments[failed]
    return table, psf


def least_squares(
    image: Image,
    background: Background,
    spots: Spots,
    settings: CentroidSettings | None = None,
    gain_e_per_dn: float | None = None,
) -> Centroids:
    """Centroids by a weighted least-squares fit of the star image, Gauss–Newton in x, y and flux.

    Minimises Σ (d − F p)² / v. The variance v = noise² + F₀ p₀ / gain is fixed after the third step, because weights
    that follow the data favour pixels whose noise is negative. Everything else is as in `maximum_likelihood`.
    """
    return _fit(image, background, spots, settings, gain_e_per_dn, reweigh=False)


def maximum_likelihood(
    image: Image,
    background: Background,
    spots: Spots,
    settings: CentroidSettings | None = None,
    gain_e_per_dn: float | None = None,
) -> Centroids:
    """Centroids of maximum likelihood under Poisson and Gaussian noise, by Fisher scoring in x, y and flux.

    A pixel's electrons plus its background variance are treated as Poisson distributed (Snyder, Hammoud & White 1993):
    the score is Σ ∂μ (d − μ) / v(μ) and the Fisher matrix Σ ∂μ ∂μᵀ / v(μ), with μ = F p and v = noise² + μ / gain +
    (flat-field error × μ)². Its inverse, with flux and neighbours marginalised, is the covariance, which is therefore
    the Cramér–Rao bound (Winick 1986) for the assumed image.

    The star image is the setting ``psf``, or is measured in the frame (`startracker.centroid.psf_shape`). Stars whose
    windows overlap are fitted together, up to eight. Pixels that are not finite are excluded, and for a saturated star
    also those within a tenth of its highest signal. Windows extend to 2½ σ, and are at least ``window_px`` wide.

    The covariance has a floor of 0.001 px. It is multiplied by χ² per degree of freedom if that exceeds one by more
    than four standard deviations, unless the brightest stars all misfit (`Centroids.misfit`): then the assumed image is
    wrong, which need not move the stars, and their residuals show how large the errors are. A star that cannot be
    fitted gets its `first_moment`. Unless the assumed image is wrong, a detection is dropped if it is ten times
    likelier to be a hot pixel than a star (from both likelihoods, and the numbers of hot pixels and stars found), or if
    its position is less certain than the width of a star image.

    Parameters
    ----------
    image, background, spots, settings, gain_e_per_dn
        As for `startracker.centroid.first_moment`.

    Returns
    -------
    Centroids
        Brightest first.

    Raises
    ------
    InputError
        As for `startracker.centroid.first_moment`; a star image that cannot be read; a negative flat-field error.
    """
    return _fit(image, background, spots, settings, gain_e_per_dn, reweigh=True)


def _fit(
    image: Image,
    background: Background,
    spots: Spots,
    settings: CentroidSettings | None,
    gain_e_per_dn: float | None,
    *,
    reweigh: bool,
) -> Centroids:
    frame = prepare(image, background, settings, gain_e_per_dn)
    if not len(spots):
        return Centroids.none()
    moments, sigmas = measure_moments(frame, spots)
    psf, starts = _start(frame, spots, moments, sigmas)
    fits = _fit_image(frame, spots, moments, psf, starts, reweigh)
    common = None
    if frame.settings.psf is None:
        unfit = spots.saturated | spots.edge
        common = skewness_covariance(frame.pixels, fits.table, unfit, int(starts.half.min()), psf.shape)
        if gain_e_per_dn is None:  # a gain guessed from the background leaves the contrast of stars unknown
            _add_width_error(frame, psf, starts, fits, reweigh, False)
        else:
            psf, fits, error = _symmetric_positions(frame, spots, moments, psf, starts, fits, reweigh)
            common = common + error
    stars = collect(fits.table, _widths(psf), spots, frame.half, fits.group, SYSTEMATIC_PX)
    return replace(stars, common_px2=common if common is not None and common.any() else None, misfit=fits.misfit)


def _symmetric_positions(
    frame: Prepared, spots: Spots, moments: FloatArray, psf: PsfModel, starts: Starts, fits: _Fits, reweigh: bool
) -> tuple[PsfModel, _Fits, FloatArray]:
    """Star image and fits without the displacement by an asymmetric image (`startracker.centroid.asymmetry`), and the
    covariance (2, 2), px², of the error that all positions share."""
    pixels, unfit, half = frame.pixels, spots.saturated | spots.edge, int(starts.half.min())
    found = measure_difference(pixels, psf, fits.table, unfit, half)
    if not found.asymmetric > EXAMINED_ASYMMETRIC:
        _add_width_error(frame, psf, starts, fits, reweigh, False)
        return psf, fits, np.zeros((2, 2))
    other, common = reference_psf(pixels, psf, fits.table, unfit, half), np.zeros((2, 2))
    if other is None:
        common = unknown_reference(psf, found)
    else:
        psf, starts = other, starts._replace(half=np.maximum(starts.half, _half_of(frame, other)))
        fits = _fit_image(frame, spots, moments, psf, starts, reweigh)
        found = measure_difference(pixels, psf, fits.table, unfit, int(starts.half.min()), EXAMINED)
        fits = fits._replace(misfit=_unexplained(fits.misfit, psf))
    moved = _add_width_error(frame, psf, starts, fits, reweigh, True)
    near = (np.abs(moved) < _ASTRAY_PX).all(axis=1)
    if near.any():  # the error of the width moves an asymmetric image as a whole
        shared = np.median(moved[near], axis=0)
        common = common + np.outer(shared, shared)
    return psf, fits, common + correct_asymmetry(found, pixels, psf, fits.table, unfit)


def _unexplained(misfit: float | None, psf: PsfModel) -> float | None:
    """Misfit of the brightest stars without that of an asymmetric image, whose displacements are corrected.

    Where pixels resolve the image, its shape displaces stars according to their brightness only: the misfit then shows
    no further errors, and the covariances contain the uncertainty of the correction.
    """
    xx, yy, _ = psf.shape
    return misfit if misfit is None or min(xx, yy) < _UNDERSAMPLED_PX2 else min(misfit, 0.0)


def _add_width_error(
    frame: Prepared, psf: PsfModel, starts: Starts, fits: _Fits, reweigh: bool, asymmetric: bool
) -> FloatArray:
    """Shift (N, 2) of the stars, px, if the image is wider by its standard error; added to the covariances, in place.

    Of symmetric images only undersampled ones have this error: it depends on the position within the pixel, and its
    mean over these is zero.
    """
    xx, yy, xy = psf.shape
    undersampled = 0.0 < min(xx, yy) < _UNDERSAMPLED_PX2
    if not ((undersampled or asymmetric) and any(psf.width_error)):
        return np.zeros((len(fits.table), 2))
    wider = gaussian_psf(xx + psf.width_error[0], yy + psf.width_error[1], xy, radius_px=psf.radius_px)
    moved: FloatArray = fit_stars(frame.pixels, wider.samples, starts, fits.group, reweigh)[:, :2] - fits.table[:, :2]
    if undersampled:
        fits.table[:, 3:5] += np.where(np.abs(moved) < _ASTRAY_PX, np.square(moved), 0.0)
    return moved


class _Fits(NamedTuple):
    """Measurements (N, 6) from fits of one star image, the group (N,) in which each star was fitted, and the misfit."""

    table: FloatArray
    group: IntArray
    misfit: float | None


def _fit_image(
    frame: Prepared, spots: Spots, moments: FloatArray, psf: PsfModel, starts: Starts, reweigh: bool
) -> _Fits:
    """Fit one star image to all stars of a frame."""
    group = group_stars(starts.x, starts.y, starts.half + math.ceil(_WIDTHS * psf.sigma_px))
    fits = fit_stars(frame.pixels, psf.samples, starts, group, reweigh)
    # χ² minus its degrees of freedom ν, in units of its standard deviation √(2ν).
    excess = (fits[:, 6] - fits[:, 7]) / np.sqrt(2.0 * fits[:, 7])
    misfit = misfit_of_brightest(fits[:, 2], np.where(spots.saturated | spots.edge, np.nan, excess))
    blends = misfit is None or misfit < MISFIT_SIGMA
    hot = (1 + spots.rejected.get("hot pixel", 0)) / (1 + len(spots)) / _SURELY_HOT
    table = _accepted(fits, moments, group, blends, psf.shape[0] + psf.shape[1], 2.0 * math.log(hot))
    return _Fits(table, group, misfit)


@kernel
def _accepted(
    fits: FloatArray, moments: FloatArray, group: IntArray, blends: bool, image_px2: float, odds_hot: float
) -> FloatArray:
    """Measurements (N, 6) by fits, with a larger covariance where χ² is too large; by moments where a fit failed.

    A star measured by moments leaves its group. `blends` is True if the assumed star image is right, so that a large χ²
    means a blend. Then three kinds of detections become NaN: hot pixels, where `odds_hot` is twice the logarithm of
    their prior odds; windows that no star fits but one bright pixel explains; and fits whose χ² makes the error exceed
    the width of the star image, with variances of sum `image_px2`, because a pixel's residual then has more light than
    the star.
    """
    out = np.empty((len(fits), MEASURED))
    for n in range(len(fits)):
        misfit, factor, finite = fits[n, 6] / fits[n, 7], 1.0, True
        most = 1.0 + MISFIT_SIGMA * math.sqrt(2.0 / fits[n, 7])
        if blends and misfit > most:
            factor = misfit
        for k in range(MEASURED):
            out[n, k] = fits[n, k] * (factor if k > 2 else 1.0)
            finite = finite and math.isfinite(out[n, k])
        hot = fits[n, 8] < (fits[n, 6] + odds_hot if finite else most * fits[n, 7])
        if blends and (hot or out[n, 3] + out[n, 4] > image_px2):
            out[n, 0] = np.nan
        elif not finite:
            group[n] = len(fits) + n
            for k in range(MEASURED):
                out[n, k] = moments[n, k]
    return out


def _start(frame: Prepared, spots: Spots, moments: FloatArray, sigmas: tuple[float, float]) -> tuple[PsfModel, Starts]:
    """Star image, and the approximate positions and windows of the fits."""
    if frame.settings.flat_field_error >= 1.0:
        raise InputError(
            f"centroid.flat_field_error is {frame.settings.flat_field_error}; it must be from 0 to below 1"
        )
    peaks = Peaks(spots.x_peak, spots.y_peak, spots.pixels, spots.saturated)
    starts = _start_values(frame.pixels, peaks, moments)
    if frame.settings.psf is None:
        # The image must cover the windows. One that is longer than the moments indicate is truncated, which does no
        # harm.
        wide = max(frame.half, math.ceil(_WIDTHS * max(sigmas))) + int(starts.half.max()) + 3.0
        psf = frame_psf(frame, spots, starts, sigmas, min(wide, _LARGEST_HALF_PX + 2.0))
    else:
        psf = load_psf(frame.settings.psf)
    return psf, starts._replace(half=np.minimum(_half_of(frame, psf) + starts.half, _reach_of(psf)))


def _reach_of(psf: PsfModel) -> int:
    """Largest half width of a window: the pixel in its corner must lie in the table even if the star moves by one
    pixel."""
    return min(_LARGEST_HALF_PX, math.floor(psf.radius_px - 1.0))


def _half_of(frame: Prepared, psf: PsfModel) -> int:
    """Half width, px, of the windows of stars that are not saturated."""
    return min(max(frame.half, math.ceil(_WIDTHS * psf.sigma_px)), _reach_of(psf))


def _start_values(pixels: Pixels, peaks: Peaks, moments: FloatArray) -> Starts:
    """Approximate positions; the half widths are the radii of the flat tops only, px, 0 for stars that are not
    saturated."""
    x, y = moments[:, :2].T.copy()
    starts = Starts(x, y, np.zeros(len(x), np.int64), np.full(len(x), np.inf))
    _fill_starts(pixels, peaks, starts)
    return starts


@kernel
def _fill_starts(pixels: Pixels, peaks: Peaks, starts: Starts) -> None:
    """Replace unusable moments by the brightest pixels, and fill in radii and ceilings of flat tops."""
    for n in range(len(starts.x)):
        x, y = peaks.x[n], peaks.y[n]
        off = max(abs(starts.x[n] - x), abs(starts.y[n] - y))
        # A moment that is displaced by neighbours is not a valid starting value.
        if not math.isfinite(starts.x[n]) or (off > _ASTRAY_PX and not peaks.saturated[n]):
            starts.x[n], starts.y[n] = x, y
        if peaks.saturated[n]:
            starts.half[n] = math.ceil(math.sqrt(peaks.pixels[n] / math.pi))
            sky = np.float64(pixels.level[y, x])
            starts.ceiling[n] = sky + _CEILING_SHARE * (np.float64(pixels.image[y, x]) - sky)


def _widths(psf: PsfModel) -> tuple[float, float]:
    return math.sqrt(psf.shape[0]), math.sqrt(psf.shape[1])
