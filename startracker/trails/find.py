"""Find and measure the trailed stars of a frame, which share one motion."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.psf_fit import MISFIT_SIGMA, SYSTEMATIC_PX
from startracker.centroid.result import Centroids, misfit_of_brightest
from startracker.core import FloatArray
from startracker.detection.background import Background
from startracker.detection.forms import agrees
from startracker.detection.matched import DEFAULT_SIGMA_PX, quantiles
from startracker.detection.values import Image, as_pixels
from startracker.geometry.camera import Camera
from startracker.settings import DetectionSettings
from startracker.sorting import median
from startracker.trails.fit import measure_trails
from startracker.trails.lines import SHORTEST_PX, bin_residual, candidate_lines, lines_along
from startracker.trails.model import ANGLE, FLUX, HALF, SIGMA, residual_of
from startracker.trails.motion import CommonMotion, Signal, find_motion, lengths_of, within
from startracker.trails.turn import Trails

FloatImage = NDArray[np.float32]

_LARGEST_MAP_PX = 1200
"""Side of an image, px, above which it is searched in larger bins: the search takes as long, and finds only brighter
trails."""
_FITTED = 20
"""Largest number of lines to which the motion is fitted."""
_PIXEL_VARIANCE = 1.0 / 12.0
_WHOLE_PX = 25.0
"""Length, px, below which an object is a complete trail; longer trails break into fragments, which a bank of lines
turns into many."""
_WORST_CHI2 = 3.0
_MODEL_ERROR = 0.01
"""Share of a trail's light by which the model may differ from it without being rejected."""


def find_trails(
    image: Image,
    background: Background,
    settings: DetectionSettings | None = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
    known: FloatArray | None = None,
    direction_rad: float | None = None,
    camera: Camera | None = None,
) -> Trails | None:
    """Find and measure the trails of a frame, which share one motion of the camera.

    The image is divided by its noise and summed along lines of 8 px to 0.3 of its smaller side in all directions.
    Significant lines are fitted individually. If four of them, and most of the brightest, agree in one motion of the
    camera (`startracker.detection.forms`), the image is searched again for trails of this motion, down to
    `threshold_sigma` for the sum along a trail. The model of a trail is a line convolved with a Gaussian; overlapping
    neighbours are measured with each other's light subtracted.

    Parameters
    ----------
    image : array, shape (H, W)
        DN; pixels that are not finite are excluded.
    background : Background
        Of the same shape.
    settings : DetectionSettings, optional
        `threshold_sigma`, `max_stars`, `psf_sigma_px` (None: measured).
    saturation_dn, gain_e_per_dn : float, optional
        Saturated pixels are excluded; the gain determines the photon noise.
    known : array, shape (N, 4), optional
        Middle x and y and half the length along x and y of trails that are already known, px, brightest first. The
        motion is estimated from them if possible. Trails shorter than 25 px are measured as they are; longer ones are
        searched again.
    direction_rad : float, optional
        Direction of the trails, rad from x to y, to 8°, if it is known; it shortens the search.
    camera : Camera, optional
        Its projection stretches and rotates the trails over the field; None: a narrow field is assumed.

    Returns
    -------
    Trails or None
        None if there is no common motion: no trails, too few, or trails of different directions.

    Notes
    -----
    Across the trail the accuracy of a position is that of a star of the same signal-to-noise ratio: σ / SNR. Along the
    trail only the two ends carry information: the error is √(2π) σ / r px, where r is the signal per pixel of length
    over the noise of a pixel, if r is well above 1. Below that, the error grows as for a jump in white noise (Hinkley
    1970); the covariance includes both. Trails cut by the border have no known middle and are excluded.
    """
    settings = settings or DetectionSettings()
    pixels, given = as_pixels(image), settings.psf_sigma_px
    # The width that is fitted includes the pixel's.
    sigma = math.hypot(DEFAULT_SIGMA_PX if given is None else given, math.sqrt(_PIXEL_VARIANCE))
    saturation = math.inf if saturation_dn is None else float(saturation_dn)
    residual = residual_of(pixels, background.level_plane, saturation)
    signal = Signal(residual, background.noise_plane, 0.0 if gain_e_per_dn is None else 1.0 / gain_e_per_dn)
    lines = np.empty((0, 4)) if known is None else known
    motion_of = partial(find_motion, signal, sigma=sigma, measure_sigma=given is None, camera=camera)
    found = motion_of(lines[:_FITTED])
    if found is not None and median(np.hypot(*found.lines_at(lines[:, :2])[0].T)) < _WHOLE_PX:
        return _measure(signal, lines[:, :2], found, settings)
    unit = max(1, math.ceil(max(pixels.shape) / _LARGEST_MAP_PX))
    bins = bin_residual(residual, background.noise_plane, 2 * unit)
    if min(bins.shape) < 2.0 * SHORTEST_PX:
        return None
    bins /= _excess(bins)
    # A direction suggested by the objects comes from bright trails, which are visible in bins of twice the size as
    # well.
    if found is None and direction_rad is not None:
        found = motion_of(candidate_lines(_halved(bins), 2 * unit, direction_rad)[:_FITTED])
    if found is None:
        found = motion_of(candidate_lines(bins, unit)[:_FITTED])
    if found is None:
        return None
    starts = lines_along(bins, 2.0 * unit, found.motion, settings.threshold_sigma, found.sigma)
    return _measure(signal, starts, found, settings)


def _halved(bins: FloatImage) -> FloatImage:
    """Means of 2 × 2 bins, scaled so that the noise is unchanged."""
    height, width = (size // 2 * 2 for size in bins.shape)
    rows = bins[:height:2] + bins[1:height:2]
    return np.asarray(np.float32(0.5) * (rows[:, :width:2] + rows[:, 1:width:2]))


def _excess(bins: FloatImage) -> float:
    """Standard deviation of the bins, at least 1: the noise of neighbouring pixels of a photograph is correlated."""
    sample = bins.ravel()[:: max(1, bins.size // 8192) | 1].copy()
    middle, above = quantiles(sample, (0.5, 0.841345))
    return max(1.0, above - middle)


def _measure(signal: Signal, centres: FloatArray, found: CommonMotion, settings: DetectionSettings) -> Trails | None:
    """Measure the complete trails of the frame's motion at these centres (N, 2), px, most significant first."""
    most = settings.max_stars
    centres = centres[: 2 * most]
    lines, _ = found.lines_at(centres)
    starts = np.zeros((len(centres), 7))
    starts[:, :2], starts[:, SIGMA] = centres, found.sigma
    starts[:, ANGLE], starts[:, HALF] = np.arctan2(lines[:, 1], lines[:, 0]), 0.5 * np.hypot(*lines.T)
    threshold = settings.threshold_sigma
    fits = measure_trails(signal.residual, signal.noise, starts, signal.inverse_gain, threshold, most)
    table, covariance, chi2 = fits.table, fits.covariance, fits.chi2
    snr = table[:, FLUX] / np.sqrt(covariance[:, FLUX, FLUX])
    lines, variance = found.lines_at(table[:, :2])
    good = agrees(lengths_of(table), lines) & (snr > threshold)
    # χ² of a bright trail may be larger in proportion to the square of its light, because its model is not exact.
    good &= within(signal, table, table[:, SIGMA]) & (chi2 < _WORST_CHI2 * (1.0 + (_MODEL_ERROR * snr) ** 2))
    kept = np.flatnonzero(good)
    kept = kept[np.argsort(-table[kept, FLUX], kind="stable")][:most]
    if not len(kept):
        return None
    table, excess = table[kept], (chi2[kept] - 1.0) / np.sqrt(2.0 / fits.freedom[kept])
    wider = np.where(excess > MISFIT_SIGMA, chi2[kept], 1.0)
    fitted = covariance[kept, :2, :2] * wider[:, None, None]
    length_variance = np.where(fits.alone[kept], 0.0, variance[kept])
    stated = fitted + _ends_covariance(signal, table, fitted, length_variance) + SYSTEMATIC_PX**2 * np.eye(2)
    nearest = np.rint(table[:, :2]).astype(np.int64)
    saturated = ~np.isfinite(signal.residual[nearest[:, 1], nearest[:, 0]])
    misfit = misfit_of_brightest(table[:, FLUX], np.where(saturated, np.nan, excess))
    centroids = Centroids(table[:, :2].copy(), table[:, FLUX].copy(), stated, saturated, misfit=misfit)
    return Trails(centroids, found.motion, lengths_of(table), fits.alone[kept])


def _ends_covariance(signal: Signal, table: FloatArray, fitted: FloatArray, length_variance: FloatArray) -> FloatArray:
    """Addition to the covariance of least squares (N, 2, 2), px², for the ends of faint trails.

    Along the trail the variance is 26 / rate² if noise rather than the width of the star image blurs the ends (a jump
    in white noise; Hinkley 1970), and that of least squares if it is the width. In between it is the root of the sum of
    their squares, which simulations confirm within 10 %. A model whose length is wrong by δ fits equally well within ±
    δ / 2, which adds δ² / 12.
    """
    nearest = np.rint(table[:, :2]).astype(np.int64)
    noise = signal.noise[nearest[:, 1], nearest[:, 0]]
    rate = (table[:, FLUX] / (2.0 * table[:, HALF] * noise)) ** 2 / (math.sqrt(math.pi) * table[:, SIGMA])
    unit = lengths_of(table) / (2.0 * table[:, HALF, None])
    smooth = np.einsum("ni,nij,nj->n", unit, fitted, unit)
    # The middle cannot be worse than uniformly distributed over the trail, with a variance of (2 h)² / 12 = h² / 3.
    along = np.minimum(np.hypot(26.0 / rate**2, smooth) - smooth, table[:, HALF] ** 2 / 3.0)
    along += length_variance / 12.0
    return np.asarray(along[:, None, None] * unit[:, :, None] * unit[:, None, :])
