"""First moment over a small window, freed of its bias (Greyling 1995, section 4.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.bias import SMALLEST_SIGMA_PX, window_moments
from startracker.centroid.result import Centroids
from startracker.centroid.window import measure_stars, measure_widths
from startracker.detection.background import Background
from startracker.detection.plane import Plane, sample_plane
from startracker.detection.spots import Spots
from startracker.detection.values import Image, as_pixels, is_value
from startracker.errors import InputError
from startracker.kernels import kernel
from startracker.settings import CentroidSettings
from startracker.sorting import median

__all__ = [
    "SYSTEMATIC_PX",
    "Prepared",
    "collect",
    "first_moment",
    "measure_moments",
    "measure_psf_sigma",
    "prepare",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

_WIDTH_STARS = 15
"""Brightest clean stars of whose widths the median is taken."""
_UNKNOWN_SIGMA_PX = 1.0
_WIDEST_FOR_3_PX = 1.1
SYSTEMATIC_PX = 0.005
"""What no noise model knows (the star image is not quite the assumed one): floor of a position's standard deviation."""
_FLAT_TOP_ERROR_PX = 0.05
"""Above the 0.03 px rms of cut-off Gaussians, σ 0.7 to 1.8 px, 1.2 to 1000 times over (tests/statistical)."""


def first_moment(
    image: Image,
    background: Background,
    spots: Spots,
    settings: CentroidSettings | None = None,
    gain_e_per_dn: float | None = None,
) -> Centroids:
    """Centroids by the first moment of the signal over a window about the brightest pixel.

    The moment of a truncated window falls short of the offset (Greyling 1995, Table 4.1). For a star image that is a
    Gaussian integrated over pixels the shortfall along x depends on x alone, and is undone exactly, axis by axis, by
    solving m(d) = m for the offset d (see `startracker.centroid.bias`), windows cut off by the image's border included.
    Smear widens the Gaussian along its axis: widths are per axis. When the offset exceeds half a pixel the window is
    moved and measured again, so that it does not matter which of two equal pixels was taken for the brightest.

    Of a faint star the outer pixels of the window bring more noise than light: the 3 × 3 about its middle are taken
    where the corrected moment of these is the more certain one and star images are not wider than σ = 1.1 px (a wider
    one may be a short streak, whose middle pixels tell too little).

    The covariance is that of the moments under photon and background noise, times the slope of the correction, plus
    a floor of 0.005 px and, for a star with neighbours, the shift their light in its window can cause at most. A
    saturated star is measured over a window grown by its radius, uncorrected, with 0.05 px and a quarter of the
    difference of its two widths (bleeding) added.

    Images drawn out by 3 to 5 px are no Gaussians, and a window of five pixels does not hold them: errors are up to
    twice those stated. The fits of the star image know what they are.

    Parameters
    ----------
    image : array, shape (H, W)
        DN.
    background : Background
        Level and noise, of the same shape.
    spots : Spots
        Candidates.
    settings : CentroidSettings
        Window, correction and width; a width of None is measured from the frame (`measure_psf_sigma`).
    gain_e_per_dn : float, optional
        Conversion for the photon noise; None: the background's noise is taken for the photon noise of its level.

    Returns
    -------
    Centroids
        Brightest first. A candidate with a pixel in the window that is not finite gets its `weighted_moment`, which
        leaves such pixels out. Candidates without a positive signal, or whose moment no star in the window explains,
        are left out.

    Raises
    ------
    InputError
        Window not odd or below 3, width or gain not positive, shapes that differ.
    """
    frame = prepare(image, background, settings, gain_e_per_dn)
    if not len(spots):
        return Centroids.none()
    table, sigmas = measure_moments(frame, spots)
    if frame.settings.bias_correction and frame.half > 1 and max(sigmas) < _WIDEST_FOR_3_PX:
        closer, _ = measure_moments(replace(frame, half=1), spots)
        better = (closer[:, 3:5].sum(axis=1) < table[:, 3:5].sum(axis=1)) & ~spots.saturated
        table[better] = closer[better]
    lost = np.flatnonzero(~np.isfinite(table[:, 0]))
    if len(lost) and _any_gap(frame.image, spots.x_peak[lost], spots.y_peak[lost], frame.half):
        from startracker.centroid.psf_fit import weighted_table  # which begins with moments

        table[lost] = weighted_table(frame, spots, table, sigmas)[0][lost]
    return collect(table, sigmas, spots, frame.half)


@kernel
def _any_gap(image: Image, xs: IntArray, ys: IntArray, half: int) -> bool:
    """Whether a pixel in one of the windows is not finite, though most of that window is."""
    height, width = image.shape
    for n in range(len(xs)):
        gaps, total = 0, 0
        for y in range(max(ys[n] - half, 0), min(ys[n] + half + 1, height)):
            for x in range(max(xs[n] - half, 0), min(xs[n] + half + 1, width)):
                gaps += int(not is_value(image[y, x]))
                total += 1
        if 0 < 2 * gaps < total:
            return True
    return False


@dataclass(frozen=True, eq=False)
class Prepared:
    """Checked input of a centroider.

    Parameters
    ----------
    image : float32 or uint16 array, shape (H, W)
        DN.
    level, noise : Plane
        Background, DN.
    settings : CentroidSettings
        As given, or the default.
    half : int
        Half width of the window.
    inverse_gain : float
        DN an electron.
    """

    image: Image
    level: Plane
    noise: Plane
    settings: CentroidSettings
    half: int
    inverse_gain: float


def prepare(
    image: Image, background: Background, settings: CentroidSettings | None, gain_e_per_dn: float | None
) -> Prepared:
    """Check what a centroider is given; see `first_moment` for the meaning and the errors raised."""
    settings = settings or CentroidSettings()
    window = settings.window_px
    if window < 3 or window % 2 == 0:
        raise InputError(f"centroid.window_px is {window}; it must be an odd number of at least 3 pixels")
    given = settings.psf_sigma_px
    if given is not None and not SMALLEST_SIGMA_PX <= given < math.inf:
        raise InputError(
            f"centroid.psf_sigma_px is {given}; it must be at least {SMALLEST_SIGMA_PX} pixels, or left out"
        )
    if gain_e_per_dn is not None and not 0 < gain_e_per_dn < math.inf:
        raise InputError(f"the gain is {gain_e_per_dn} e⁻/DN; it must be a positive number")
    pixels = as_pixels(image)
    if pixels.shape != background.shape:
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; make it anew")
    gain = gain_e_per_dn or (_gain_from_background(background) if pixels.size else 1.0)
    return Prepared(pixels, background.level_plane, background.noise_plane, settings, window // 2, 1.0 / gain)


def measure_moments(frame: Prepared, spots: Spots) -> tuple[FloatArray, tuple[float, float]]:
    """Measurements (N, 6) in the order of the spots, see `startracker.centroid.window`, and the widths taken.

    NaN where nothing like a star image could be measured.
    """
    table, sigma_x, sigma_y = _measure_frame(
        frame.image,
        frame.level,
        frame.noise,
        spots.x_peak,
        spots.y_peak,
        spots.pixels,
        spots.saturated,
        spots.edge,
        frame.half,
        frame.settings.psf_sigma_px or math.nan,
        frame.settings.bias_correction,
        frame.inverse_gain,
    )
    return table, (sigma_x, sigma_y)


def _measure_frame(
    image: Image,
    level: Plane,
    noise: Plane,
    xs: IntArray,
    ys: IntArray,
    pixels: IntArray,
    saturated: Flags,
    edge: Flags,
    half: int,
    given: float,
    correct: bool,
    inverse_gain: float,
) -> tuple[FloatArray, float, float]:
    """Measurements (N, 6) and widths along x and y: `given`, or, where that is not a number, measured."""
    sigma_x, sigma_y = given, given
    if math.isnan(given):
        sigma_x, sigma_y = _frame_widths(image, level, noise, xs, ys, saturated, edge, half)
    table = measure_stars(
        image, level, noise, xs, ys, pixels, saturated, half, sigma_x, sigma_y, correct, inverse_gain,
        _FLAT_TOP_ERROR_PX,
    )  # fmt: skip
    # known no better than a star image, or a pixel, is wide: what is there is no star image
    limit = max(sigma_x, sigma_y, 1.0) ** 2
    table[(np.maximum(table[:, 3], table[:, 4]) > limit) & ~saturated] = np.nan
    return table, sigma_x, sigma_y


def _frame_widths(
    image: Image, level: Plane, noise: Plane, xs: IntArray, ys: IntArray, saturated: Flags, edge: Flags, half: int
) -> tuple[float, float]:
    """See `measure_psf_sigma`."""
    clean = np.flatnonzero(~(saturated | edge))[:_WIDTH_STARS]
    widths = measure_widths(image, level, noise, xs[clean], ys[clean], half)
    told = np.isfinite(widths[:, 0] + widths[:, 1])
    if not told.any():
        return _UNKNOWN_SIGMA_PX, _UNKNOWN_SIGMA_PX
    return median(widths[told, 0]), median(widths[told, 1])


def collect(
    table: FloatArray,
    sigmas: tuple[float, float],
    spots: Spots,
    half: int,
    together: IntArray | None = None,
    systematic_px: float = SYSTEMATIC_PX,
) -> Centroids:
    """Centroids of the finite rows of a table of measurements: with the floor and the neighbours' light added.

    `together` numbers stars that were measured jointly; their light does not disturb each other.
    """
    alone = np.arange(len(table)) if together is None else together
    order, covariance = _collect(table, *sigmas, half, alone, systematic_px)
    return Centroids(table[order, :2], table[order, 2], covariance, spots.saturated[order])


def measure_psf_sigma(image: Image, background: Background, spots: Spots, window_px: int = 5) -> tuple[float, float]:
    """Widths (σ_x, σ_y), pixels, of a frame's star images: medians over its brightest clean stars.

    The mean and variance of a star over its window give centre and width of the pixel-integrated Gaussian that has
    them; saturated stars and those on the border are left out. (1, 1) when no star tells.
    """
    level, noise = background.level_plane, background.noise_plane
    sigma_x, sigma_y = _frame_widths(
        as_pixels(image), level, noise, spots.x_peak, spots.y_peak, spots.saturated, spots.edge, window_px // 2
    )
    return sigma_x, sigma_y


def _collect(
    table: FloatArray, sigma_x: float, sigma_y: float, half: int, together: IntArray, systematic_px: float
) -> tuple[IntArray, FloatArray]:
    """Finite rows of a table of measurements, brightest first, and their covariances (M, 2, 2), see `collect`."""
    finite = np.isfinite(table).all(axis=1)
    order = np.argsort(np.where(finite, -table[:, 2], np.inf), kind="stable")[: np.count_nonzero(finite)]
    rows = table[order]
    more = systematic_px**2 + _intrusion(rows, sigma_x, sigma_y, half, together[order])
    covariance = np.empty((len(order), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = rows[:, 3] + more, rows[:, 4] + more
    covariance[:, 0, 1] = covariance[:, 1, 0] = rows[:, 5]
    return order, covariance


@kernel
def _intrusion(table: FloatArray, sigma_x: float, sigma_y: float, half: int, together: IntArray) -> FloatArray:
    """Variance (N,), px², of either axis for other stars' light in a star's window: (share × half a window)²."""
    variance = np.zeros(len(table))
    reach = half + 4.0 * max(sigma_x, sigma_y)
    for star in range(len(table)):
        x, y = table[star, 0], table[star, 1]
        for other in range(len(table)):
            near = abs(table[other, 0] - x) < reach and abs(table[other, 1] - y) < reach
            if not near or together[star] == together[other]:
                continue
            dx, dy = table[other, 0] - np.rint(x), table[other, 1] - np.rint(y)
            light = window_moments(dx, sigma_x, -half, half)[0] * window_moments(dy, sigma_y, -half, half)[0]
            variance[star] += (half * light * table[other, 2] / table[star, 2]) ** 2
    return variance


def _gain_from_background(background: Background) -> float:
    """Electrons a DN as if the background's noise were its photon noise; an offset in the level makes it too large."""
    planes = background.level_plane, background.noise_plane
    level, noise = (float(median(sample_plane(plane, 16, 16).astype(np.float64))) for plane in planes)
    return max(level, noise) / noise**2
