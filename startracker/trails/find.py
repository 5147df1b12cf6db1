"""Trailed stars of a frame: the motion that they share, found and measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.psf_fit import MISFIT_SIGMA, SYSTEMATIC_PX
from startracker.centroid.result import Centroids, misfit_of_brightest
from startracker.detection.background import Background
from startracker.detection.matched import DEFAULT_SIGMA_PX
from startracker.detection.motion import agrees, common_motion, motion_at
from startracker.detection.plane import Plane
from startracker.detection.values import Image, as_pixels
from startracker.display import fields_repr
from startracker.settings import DetectionSettings
from startracker.trails.fit import (
    ANGLE,
    FLUX,
    HALF,
    LINE,
    SIGMA,
    X,
    Y,
    best_stretch,
    fit_trail,
    measure_trails,
    residual_of,
)
from startracker.trails.lines import COARSE_SIGMA, SHORTEST_PX, bin_residual, candidate_lines, lines_along

__all__ = ["Trails", "find_trails"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_LARGEST_MAP_PX = 1200
"""Larger images are searched in larger squares: the search costs as much, and finds brighter trails only."""
_FITTED = 20
"""Lines of which the motion is fitted at most …"""
_ENOUGH = 12
"""… and so many of them suffice, of which `common_motion` needs 0.6 to agree."""
_WIDTH_TRAILS = 5
_PIXEL_VARIANCE = 1.0 / 12.0
_FEWEST = 4
_SHORTEST_MOTION_PX = 5.0
"""These lines were fitted, each above the noise as a whole: shorter ones than those of bare objects mean something."""
_WHOLE_PX = 25.0
"""Objects shorter than this are whole trails; longer trails come in pieces, of which a bank of lines makes more."""
_WORST_CHI2 = 3.0
_MODEL_ERROR = 0.01
"""Share of a trail's light by which the model may be wrong without its being something else."""
_CUT_PX = 4.0
"""A trail that ends nearer to the border may go on beyond."""
_LENGTH_ERROR_PX, _STRETCH, _TURN_PX = 0.3, 0.01, 0.1
"""What else trails may differ by: a flat image stretches towards its corners by the square of the angle."""
_CAUCHY = 2.4
"""Residual in standard errors at which a trail has half its weight (95 % efficiency)."""


@dataclass(frozen=True, eq=False)
class Trails:
    """Stars trailed along the motion of the frame.

    Parameters
    ----------
    centroids : Centroids
        Middles of the trails, where the stars stood in the middle of the exposure; brightest first.
    motion : (3,)
        (a, b, c): during the exposure what is at (x, y) from the image's middle moved by (a − c y, b + c x), pixels;
        forwards or backwards is not known.
    lengths : (N, 2)
        Of the trails along x and y, px.
    fitted_alone : bool (N,)
        Whether a trail's length and direction were fitted to itself, not taken from the motion.
    """

    centroids: Centroids
    motion: FloatArray
    lengths: FloatArray
    fitted_alone: NDArray[np.bool_]

    __repr__ = fields_repr


@dataclass(frozen=True, eq=False)
class _Frame:
    """What trails are fitted in: residual above the background and its noise, DN; DN an electron."""

    residual: FloatImage
    noise: Plane
    inverse_gain: float

    @property
    def middle(self) -> FloatArray:
        """Of the image (x, y), px."""
        return 0.5 * (np.array(self.residual.shape[::-1], dtype=float) - 1.0)


def find_trails(
    image: Image,
    background: Background,
    settings: DetectionSettings | None = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
    known: FloatArray | None = None,
    direction_rad: float | None = None,
) -> Trails | None:
    """Find and measure the trails of a frame, all of one motion of the camera.

    The image is divided by its noise and summed along lines of 8 px to 0.3 of its smaller side in all directions. The
    lines that stand out are fitted, each for itself; where four of them, and most of the brightest, agree in one
    motion of the camera (`startracker.detection.motion`), the image is searched again for trails of this motion, down
    to `threshold_sigma` along the whole trail. The model of a trail is a line convolved with a Gaussian; neighbours
    that overlap are measured with each other's light subtracted.

    Parameters
    ----------
    image : array, shape (H, W)
        DN; not finite: left out.
    background : Background
        Of the same shape.
    settings : DetectionSettings, optional
        `threshold_sigma`, `max_stars`, `psf_sigma_px` (None: measured).
    saturation_dn, gain_e_per_dn : float, optional
        Saturated pixels are excluded; the gain determines the photon noise.
    known : array, shape (N, 4), optional
        Middle x and y and half the length along x and y of trails found before, brightest first, from which the
        motion is estimated if possible. Those shorter than 25 px are measured as they are, longer ones searched again.
    direction_rad : float, optional
        Direction of the trails, from x to y, to 8°, where it is known: the search is then shorter.

    Returns
    -------
    Trails or None
        None where there is no common motion: no trails, too few, or of different directions.

    Notes
    -----
    Across the trail a position is as good as its signal-to-noise ratio: σ / SNR. Along it only the two ends have
    information, and their error is √(2π) σ / r px, with r the signal of a pixel's length of the trail over the noise of
    a pixel, as long as r is well above 1. Below, the error grows as of a jump in noise (Hinkley 1970); the covariance
    has both. Trails that the border cuts have no middle and are left out.
    """
    settings = settings or DetectionSettings()
    pixels, given = as_pixels(image), settings.psf_sigma_px
    sigma = math.hypot(DEFAULT_SIGMA_PX if given is None else given, math.sqrt(_PIXEL_VARIANCE))
    saturation = math.inf if saturation_dn is None else float(saturation_dn)
    residual = residual_of(pixels, background.level_plane, saturation)
    frame = _Frame(residual, background.noise_plane, 0.0 if gain_e_per_dn is None else 1.0 / gain_e_per_dn)
    lines = np.empty((0, 4)) if known is None else known
    found = _motion(frame, lines[:_FITTED], sigma, given is None)
    if found is not None and 2.0 * np.median(np.hypot(*lines[:, 2:].T)) < _WHOLE_PX:
        return _measure(frame, lines[:, :2], *found, settings)
    unit = max(1, math.ceil(max(pixels.shape) / _LARGEST_MAP_PX))
    bins = bin_residual(residual, background.noise_plane, 2 * unit)
    if min(bins.shape) < 2.0 * SHORTEST_PX:
        return None
    bins /= _excess(bins)
    if found is None and direction_rad is not None:  # then there are bright ones, which larger squares show, too
        larger = _halved(bins)
        found = _motion(frame, candidate_lines(larger, 2 * unit, direction_rad)[:_FITTED], sigma, given is None)
    if found is None:
        found = _motion(frame, candidate_lines(bins, unit)[:_FITTED], sigma, given is None)
    if found is None:
        return None
    motion, sigma = found
    starts = lines_along(bins, 2.0 * unit, motion, settings.threshold_sigma, sigma)
    return _measure(frame, starts, motion, sigma, settings)


def _halved(bins: FloatImage) -> FloatImage:
    """Squares of 2 × 2 bins, of the same noise."""
    height, width = (size // 2 * 2 for size in bins.shape)
    rows = bins[:height:2] + bins[1:height:2]
    return np.asarray(np.float32(0.5) * (rows[:, :width:2] + rows[:, 1:width:2]))


def _excess(bins: FloatImage) -> float:
    """Noise of the bins, at least 1: neighbouring pixels of a photograph are correlated."""
    sample = bins.ravel()[:: max(1, bins.size // 8192) | 1]
    middle, above = np.quantile(sample, (0.5, 0.841345))
    return max(1.0, float(above - middle))


# ---------------------------------------------------------------------- the motion
def _motion(frame: _Frame, lines: FloatArray, sigma: float, measure_sigma: bool) -> tuple[FloatArray, float] | None:
    """The motion that the lines share, and the width of the star image."""
    fits, errors = [], []
    for x, y, u, v in lines:
        half = math.hypot(u, v)
        start = np.array([x, y, 0.0, 0.0, math.atan2(v, u), half, sigma])
        # a piece of a trail may be half of it
        shift, length = best_stretch(
            frame.residual, frame.noise, start, 2.0 * half + 8.0, max(4, round(half)), math.ceil(4.0 * half) + 8
        )
        start[[X, Y]] += shift * np.array([u, v]) / half
        start[HALF] = max(0.5 * length, 2.0)
        made, covariance, chi2, _ = fit_trail(
            frame.residual, frame.noise, start, LINE, 3.0 + 0.05 * start[HALF], frame.inverse_gain
        )
        if not chi2 < math.inf or made[FLUX] ** 2 < COARSE_SIGMA**2 * covariance[FLUX, FLUX]:
            continue
        if _within(frame, made[None], _CUT_PX)[0]:
            fits.append(made)
            errors.append(4.0 * chi2 * np.array([covariance[HALF, HALF], made[HALF] ** 2 * covariance[ANGLE, ANGLE]]))
        if len(fits) == _ENOUGH:
            break
    if len(fits) < _FEWEST:
        return None
    order = np.argsort([-made[FLUX] for made in fits], kind="stable")
    table, variance = np.array(fits)[order], np.array(errors)[order]
    xy, trails = table[:, [X, Y]] - frame.middle, _lengths(table)
    motion = common_motion(xy, trails, _SHORTEST_MOTION_PX, _SHORTEST_MOTION_PX)
    if motion is None:
        return None
    fitting = agrees(trails, motion_at(xy, motion))
    variance += (_LENGTH_ERROR_PX + _STRETCH * 2.0 * table[:, HALF, None]) ** 2 * np.array([1.0, 0.0]) + _TURN_PX**2
    motion = _weighted_motion(xy[fitting], trails[fitting], variance[fitting], motion)
    if measure_sigma:
        sigma = float(np.median(table[fitting, SIGMA][:_WIDTH_TRAILS]))
    return motion, sigma


def _lengths(table: FloatArray) -> FloatArray:
    """Lengths (N, 2) along x and y of trails (N, 7), px."""
    unit = np.column_stack([np.cos(table[:, ANGLE]), np.sin(table[:, ANGLE])])
    return np.asarray(2.0 * table[:, HALF, None] * unit)


def _within(frame: _Frame, table: FloatArray, margin: FloatArray | float) -> NDArray[np.bool_]:
    """Which trails (N, 7) have both ends at least so far inside the image, px."""
    reach = 0.5 * np.abs(_lengths(table)) + np.reshape(margin, (-1, 1))
    inside = np.abs(table[:, [X, Y]] - frame.middle) + reach <= frame.middle
    return np.asarray(inside.all(axis=1))


def _weighted_motion(xy: FloatArray, trails: FloatArray, variance: FloatArray, motion: FloatArray) -> FloatArray:
    """The motion of trails whose lengths and directions are known to a variance (N, 2), px², outliers held down.

    Directions of long trails are known far better than their lengths; two trails in line look like one longer one.
    """
    along = trails / np.hypot(*trails.T)[:, None]
    axes = np.stack([along, np.column_stack([-along[:, 1], along[:, 0]])], axis=1)
    ones, zeros = np.ones(len(xy)), np.zeros(len(xy))
    design = np.stack([np.column_stack([ones, zeros, -xy[:, 1]]), np.column_stack([zeros, ones, xy[:, 0]])], axis=1)
    design = (axes @ design) / np.sqrt(variance)[:, :, None]
    for _ in range(8):
        sign = np.where((motion_at(xy, motion) * trails).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
        target = (axes @ (sign * trails)[:, :, None])[:, :, 0] / np.sqrt(variance)
        away = (design @ motion - target) / _CAUCHY
        weight = np.sqrt(1.0 / (1.0 + away**2))
        rows = (design * weight[:, :, None]).reshape(-1, 3)
        motion = np.asarray(np.linalg.lstsq(rows, (target * weight).reshape(-1), rcond=None)[0])
    return motion


# ---------------------------------------------------------------------- trails of one motion
def _measure(
    frame: _Frame, centres: FloatArray, motion: FloatArray, sigma: float, settings: DetectionSettings
) -> Trails | None:
    """Whole trails of the frame's motion about these centres, the most significant first."""
    most = max(settings.max_stars, 0)
    centres = centres[: 2 * most]
    trails = motion_at(centres - frame.middle, motion)
    starts = np.zeros((len(centres), 7))
    starts[:, :2], starts[:, SIGMA] = centres, sigma
    starts[:, ANGLE], starts[:, HALF] = np.arctan2(trails[:, 1], trails[:, 0]), 0.5 * np.hypot(*trails.T)
    threshold = settings.threshold_sigma
    fits = measure_trails(frame.residual, frame.noise, starts, frame.inverse_gain, threshold, most)
    table, covariance, chi2 = fits.table, fits.covariance, fits.chi2
    snr = table[:, FLUX] / np.sqrt(covariance[:, FLUX, FLUX])
    good = agrees(_lengths(table), motion_at(table[:, :2] - frame.middle, motion)) & (snr > threshold)
    good &= _within(frame, table, table[:, SIGMA]) & (chi2 < _WORST_CHI2 * (1.0 + (_MODEL_ERROR * snr) ** 2))
    kept = np.flatnonzero(good)
    kept = kept[np.argsort(-table[kept, FLUX], kind="stable")][:most]
    if not len(kept):
        return None
    table, excess = table[kept], (chi2[kept] - 1.0) / np.sqrt(2.0 / fits.freedom[kept])
    wider = np.where(excess > MISFIT_SIGMA, chi2[kept], 1.0)
    fitted = covariance[kept, :2, :2] * wider[:, None, None]
    stated = fitted + _ends_covariance(frame, table, fitted) + SYSTEMATIC_PX**2 * np.eye(2)
    nearest = np.rint(table[:, :2]).astype(np.int64)
    saturated = ~np.isfinite(frame.residual[nearest[:, 1], nearest[:, 0]])
    misfit = misfit_of_brightest(table[:, FLUX], np.where(saturated, np.nan, excess))
    centroids = Centroids(table[:, :2].copy(), table[:, FLUX].copy(), stated, saturated, misfit=misfit)
    return Trails(centroids, motion, _lengths(table), fits.alone[kept])


def _ends_covariance(frame: _Frame, table: FloatArray, fitted: FloatArray) -> FloatArray:
    """What a faint trail's ends add to the covariance of least squares (N, 2, 2), px².

    Along the trail the variance is 26 / rate² where noise, not the width of the star image, blurs the ends (a jump in
    white noise; Hinkley 1970), and that of least squares where it is the width; simulated, the root of the sum of their
    squares in between, within 10 %.
    """
    nearest = np.rint(table[:, :2]).astype(np.int64)
    noise = frame.noise[nearest[:, 1], nearest[:, 0]]
    rate = (table[:, FLUX] / (2.0 * table[:, HALF] * noise)) ** 2 / (math.sqrt(math.pi) * table[:, SIGMA])
    unit = _lengths(table) / (2.0 * table[:, HALF, None])
    smooth = np.einsum("ni,nij,nj->n", unit, fitted, unit)
    along = np.minimum(np.hypot(26.0 / rate**2, smooth) - smooth, table[:, HALF] ** 2 / 3.0)
    return np.asarray(along[:, None, None] * unit[:, :, None] * unit[:, None, :])
