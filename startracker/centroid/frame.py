"""Steps that all centroiders share: checks of the input, measurement by moments, covariances of the results."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel
from startracker.centroid.bias import SMALLEST_SIGMA_PX, window_moments
from startracker.centroid.result import Centroids
from startracker.centroid.window import Peaks, Pixels, frame_widths, measure_stars
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.detection.background import Background
from startracker.detection.spots import Spots
from startracker.detection.tiles import sample_plane
from startracker.detection.values import Image, as_pixels
from startracker.errors import InputError
from startracker.settings import CentroidSettings

MODEL_STARS = 9
"""Number of the brightest clean stars from which the star image is measured."""
_APART_PX = 16.0
_UNKNOWN_SIGMA_PX = 1.0
SYSTEMATIC_PX = 0.005
"""Systematic error floor of a position, px: the actual star image differs slightly from the assumed one."""


class Prepared(NamedTuple):
    """Checked input of a centroider: a frame, the settings, and the half width of the window."""

    pixels: Pixels
    settings: CentroidSettings
    half: int


def prepare(
    image: Image, background: Background, settings: CentroidSettings | None, gain_e_per_dn: float | None
) -> Prepared:
    """Check the arguments of a centroider; see `first_moment` for their meaning and the errors raised."""
    settings = settings or CentroidSettings()
    given = settings.psf_sigma_px
    if given is not None and not SMALLEST_SIGMA_PX <= given < math.inf:
        raise InputError(
            f"centroid.psf_sigma_px is {given}; it must be at least {SMALLEST_SIGMA_PX} pixels, or left out"
        )
    if gain_e_per_dn is not None and not 0 < gain_e_per_dn < math.inf:
        raise InputError(f"the gain is {gain_e_per_dn} e⁻/DN; it must be a positive number")
    values = as_pixels(image)
    if values.shape != background.shape:
        raise InputError(f"the image is {values.shape} but its background {background.shape}; compute it again")
    gain = gain_e_per_dn or (_gain_from_background(background) if values.size else 1.0)
    level, noise = background.level_plane, background.noise_plane
    return Prepared(
        Pixels(values, level, noise, 1.0 / gain, float(settings.flat_field_error)), settings, settings.window_px // 2
    )


def measure_moments(frame: Prepared, spots: Spots) -> tuple[FloatArray, tuple[float, float]]:
    """Measurements (N, 6) in the order of the spots, see `startracker.centroid.window`, and the widths used, px.

    NaN where no star image could be measured.
    """
    given = frame.settings.psf_sigma_px
    sigma_x, sigma_y = (given, given) if given else _widths(frame, spots)
    peaks = Peaks(spots.x_peak, spots.y_peak, spots.pixels, spots.saturated)
    table = measure_stars(frame.pixels, peaks, frame.half, sigma_x, sigma_y, frame.settings.bias_correction)
    return table, (sigma_x, sigma_y)


def measure_psf_sigma(image: Image, background: Background, spots: Spots, window_px: int = 5) -> tuple[float, float]:
    """Widths (σ_x, σ_y), px, of a frame's star images: medians over its brightest clean stars.

    Centre and width are those of the pixel-integrated Gaussian with the same mean and variance over the window.
    Saturated stars and stars on the border are excluded. (1, 1) if no star can be measured.
    """
    return _widths(prepare(image, background, CentroidSettings(window_px=window_px), 1.0), spots)


def _widths(frame: Prepared, spots: Spots) -> tuple[float, float]:
    along_x, along_y = frame_widths(frame.pixels, spots.x_peak, spots.y_peak, spots.saturated | spots.edge, frame.half)
    return (_UNKNOWN_SIGMA_PX, _UNKNOWN_SIGMA_PX) if math.isnan(along_x) else (along_x, along_y)


@kernel
def brightest_alone(
    x: FloatArray, y: FloatArray, flux: FloatArray, unfit: BoolArray, looked_at: int, most: int
) -> IntArray:
    """Indices of the brightest isolated stars, at most `most`.

    The `looked_at` brightest stars that are not `unfit` are examined; isolated means that no other is within 16 px.
    """
    out, count = np.empty(most, np.int64), 0
    done = unfit.copy()
    for _ in range(looked_at):
        best = -1
        for n in range(len(x)):
            usable = not done[n] and math.isfinite(x[n] + y[n] + flux[n])
            if usable and (best < 0 or flux[n] > flux[best]):
                best = n
        if best < 0 or count == most:
            break
        done[best], alone = True, True
        for m in range(len(x)):
            near = abs(x[m] - x[best]) < _APART_PX and abs(y[m] - y[best]) < _APART_PX
            alone = alone and (not near or m == best)
        if alone:
            out[count] = best
            count += 1
    return out[:count]


def collect(
    table: FloatArray,
    sigmas: tuple[float, float],
    spots: Spots,
    half: int,
    together: IntArray | None = None,
    systematic_px: float = SYSTEMATIC_PX,
) -> Centroids:
    """Centroids from the finite rows of a table of measurements, with the error floor and the neighbours' light added.

    A position whose error exceeds the window is dropped, because the detection alone is more accurate. `together`
    numbers groups of stars that were fitted jointly, whose light does not disturb the others of the group.
    """
    finite = np.isfinite(table.sum(axis=1))
    order = np.argsort(np.where(finite, -table[:, 2], np.inf), kind="stable")[: np.count_nonzero(finite)]
    rows = table[order]
    covariance = _covariances(rows, sigmas, half, order if together is None else together[order], systematic_px)
    known = covariance[:, 0, 0] + covariance[:, 1, 1] <= 2.0 * (half + 0.5) ** 2
    if not known.all():
        order, rows, covariance = order[known], rows[known], covariance[known]
    return Centroids(np.ascontiguousarray(rows[:, :2]), rows[:, 2], covariance, spots.saturated[order])


@kernel
def _covariances(
    table: FloatArray, sigmas: tuple[float, float], half: int, together: IntArray, systematic_px: float
) -> FloatArray:
    """Covariances (N, 2, 2), px², of measurements, including the light of neighbours.

    The light of other stars in a star's window can shift its position by at most their share of the light × half a
    window on either axis.
    """
    out = np.empty((len(table), 2, 2))
    reach = half + 4.0 * max(sigmas[0], sigmas[1])
    for star in range(len(table)):
        x, y, more = table[star, 0], table[star, 1], systematic_px**2
        for other in range(len(table)):
            near = abs(table[other, 0] - x) < reach and abs(table[other, 1] - y) < reach
            if not near or together[star] == together[other]:
                continue
            dx, dy = table[other, 0] - np.rint(x), table[other, 1] - np.rint(y)
            light = window_moments(dx, sigmas[0], -half, half)[0] * window_moments(dy, sigmas[1], -half, half)[0]
            more += (half * light * table[other, 2] / table[star, 2]) ** 2
        out[star, 0, 0], out[star, 1, 1] = table[star, 3] + more, table[star, 4] + more
        out[star, 0, 1] = out[star, 1, 0] = table[star, 5]
    return out


def _gain_from_background(background: Background) -> float:
    """Gain in e⁻/DN, assuming that the noise of the background is its photon noise; an offset in the level makes it too
    large."""
    planes = background.level_plane, background.noise_plane
    level, noise = (float(np.median(sample_plane(plane, 16, 16).astype(np.float64))) for plane in planes)
    return max(level, noise) / noise**2
