"""Guide stars expected on the image for a prediction, and the star candidates found in windows around them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.catalog.bodies import beside_bodies
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.sky_view import SkyView
from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray, IntArray
from startracker.detection import Background
from startracker.errors import InputError
from startracker.field_solution import IMAGE_FLOOR_PX, STATED_PX
from startracker.geometry.image_map import to_directions
from startracker.inputs import SAME_STAR_PX
from startracker.observer import Observer
from startracker.tracker import StarTracker
from startracker.tracking.matching import expected_stars, spreads
from startracker.tracking.windows import first_of_each, lay_out, to_image

_WINDOW_SIGMAS = 4.3
_SKIRT_PX = 5
"""Margin of a window for the star image, and for the border in which the background is measured."""
_EPOCH_STEP = 1e-3
"""Years in which all stars except the fastest three move by at most 5 mas, including parallax."""
_SHORT_STREAK_PX = 2.0
"""Maximum length of a streak that fits into the centroider's window."""
_LONGEST_STREAK_PX = 10.0
"""Maximum length of a streak in windows; longer ones are measured by their ends over the whole frame."""
_LARGEST_SHARE = 0.5
"""Fraction of the frame above which windows save no time."""
_MOSAIC_COLUMNS = 8
_ROUNDING = 0.29


@dataclass(frozen=True, eq=False)
class Expected:
    """Guide stars expected on the image: number, apparent direction (K, 3) in ICRS axes, and in camera axes."""

    index: IntArray
    directions: FloatArray
    predicted: FloatArray


@dataclass(frozen=True, eq=False)
class Candidates:
    """Star candidates of a frame."""

    xy: FloatArray
    flux: FloatArray
    """Pixels, (N, 2), and signal, (N,); NaN: not known."""
    vectors: FloatArray
    """Directions in the camera frame, (N, 3)."""
    gate_px: FloatArray
    sigma_px: FloatArray
    """Standard errors for the match, and as measured, (N,)."""
    stated_px: FloatArray
    """Standard errors to which the residuals are compared, (N,)."""
    windows: int
    """Number of windows; 0: the whole frame."""
    area_sr: float
    """Solid angle searched."""
    window_xy: FloatArray | None = None
    """Central pixels of the windows, (windows, 2)."""
    window_half_px: int = 0
    """A window has 2 half + 1 pixels per side."""
    common_px2: FloatArray | None = None
    """Covariance of an error common to all candidates (`Centroids.common_px2`), (2, 2)."""

    def select(self, rows: NDArray[Any]) -> Candidates:
        """Selection of the candidates."""
        columns = {f.name: getattr(self, f.name)[rows] for f in fields(self)[:6]}
        return replace(self, **columns)


class Sky:
    """Guide stars at the observer's epoch and position without aberration, cached until they have moved."""

    def __init__(self, guide: GuideDatabase, pixel_rad: float) -> None:
        self.guide, self.pixel_rad = guide, pixel_rad
        self._view: SkyView | None = None
        self._at: tuple[float, bool] | None = None

    def expected(self, matrix: FloatArray, observer: Observer | None, most: int) -> Expected:
        """The brightest guide stars on the image at an attitude (3, 3), without those beside a planet, Moon or Sun."""
        beta = np.zeros(3)
        if observer is not None and observer.velocity_km_s is not None:
            beta = np.asarray(observer.velocity_km_s, dtype=float) / SPEED_OF_LIGHT_KM_S
        index, directions, predicted = expected_stars(matrix, self._apparent_to(observer), beta, most)
        if observer is not None:
            beside = beside_bodies(directions, observer, self.pixel_rad)
            if beside.any():
                index, directions, predicted = index[~beside], directions[~beside], predicted[~beside]
        return Expected(index=index, directions=directions, predicted=predicted)

    def _apparent_to(self, observer: Observer | None) -> SkyView:
        if observer is None:
            at = (self.guide.epoch_jyear, False)
        else:
            at = (observer.epoch_jyear, observer.position_au is not None)
        if self._view is None or self._at is None or self._at[1] != at[1] or abs(self._at[0] - at[0]) > _EPOCH_STEP:
            view = self.guide.view
            if observer is not None:
                directions = self.guide.catalog.directions(observer.epoch_jyear, observer.position_au)
                view = view._replace(directions=np.ascontiguousarray(directions))
            self._view, self._at = view, at
        return self._view


def given_candidates(tracker: StarTracker, xy: FloatArray, flux: FloatArray | None, factor: float) -> Candidates:
    """Given centroids without errors; `factor` times the usual error is assumed."""
    camera = tracker.camera
    rows = first_of_each(np.ascontiguousarray(xy), camera.width, camera.height, 0.0, SAME_STAR_PX)
    points = xy[rows]
    stated, sigma = np.full(len(rows), STATED_PX), np.full(len(rows), factor * STATED_PX)
    seen = Candidates(
        xy=points,
        flux=np.full(len(rows), math.nan) if flux is None else flux[rows],
        vectors=to_directions(points, camera.image_map),
        gate_px=sigma,
        sigma_px=sigma,
        stated_px=stated,
        windows=0,
        area_sr=tracker.guide.solid_angle_sr,
    )
    return _with_direction(seen)


def streak_px(tracker: StarTracker, rate_rad_s: FloatArray, exposure_s: float) -> float:
    """Maximum length of a star image at a rate (3,), pixels."""
    turn = math.hypot(rate_rad_s[0], rate_rad_s[1]) + abs(rate_rad_s[2]) * tracker.guide.half_diagonal_rad
    return float(turn * exposure_s / tracker.camera.pixel_rad)


def window_half(
    tracker: StarTracker, expected: Expected, covariance: FloatArray, streak_px: float, largest_half: int
) -> int | None:
    """Half side of the windows around the expected stars; None if windows cannot be used.

    Parameters
    ----------
    covariance : (3, 3)
        Covariance of the predicted attitude: windows extend to 4.3 standard deviations of the least certain star.
    streak_px : float
        Length of a star image; above 10 px windows cannot be used.
    largest_half : int
        Maximum half side, excluding the streak.
    """
    camera, spread = tracker.camera, spreads(expected.predicted, covariance).covariance
    wide = math.sqrt(float(np.max(spread[:, 0] + spread[:, 2]))) / camera.pixel_rad
    half = math.ceil(_WINDOW_SIGMAS * wide) + tracker.centroid.window_px // 2 + _SKIRT_PX
    reach = half + math.ceil(0.5 * streak_px)
    share = len(expected.predicted) * (2 * reach + 1) ** 2 / (camera.width * camera.height)
    return None if streak_px > _LONGEST_STREAK_PX or half > largest_half or share > _LARGEST_SHARE else reach


def measure_windows(
    image: ArrayLike,
    tracker: StarTracker,
    expected: Expected,
    half: int | None,
    streak_px: float,
    factor: float,
    saturation_dn: float | None,
    gain_e_per_dn: float | None,
) -> Candidates | None:
    """Star candidates in windows around the expected stars, found and measured by the tracker's methods.

    Parameters
    ----------
    half : int, optional
        See `window_half`.
    streak_px : float
        Length of a star image.
    factor : float
        Ratio of actual to stated centroid errors.

    Returns
    -------
    Candidates, or None if windows cannot be used.
    """
    camera, pixels = tracker.camera, as_pixels(image)
    if half is None or pixels is None or pixels.shape != (camera.height, camera.width):
        return None
    centre = camera.project(expected.predicted)
    centre = np.rint(centre[np.isfinite(centre).all(axis=1)])
    centre = centre[camera.contains(centre)]
    if not len(centre):
        return None
    x, y = centre[:, 0].astype(np.int64), centre[:, 1].astype(np.int64)
    columns = min(_MOSAIC_COLUMNS, len(x))
    floor = _ROUNDING if pixels.dtype.kind in "ui" else 0.0
    mosaic, level, noise = lay_out(pixels, x, y, half, columns, floor)
    background = Background(level=level, noise=noise)
    try:
        spots = tracker._detect(mosaic, background, tracker.detection, saturation_dn)
        # any pixel of a streak may be the brightest: the window must contain all of it
        longer = max(math.ceil(0.5 * (streak_px - _SHORT_STREAK_PX)), 0)
        centroid = replace(tracker.centroid, window_px=tracker.centroid.window_px + 2 * longer)
        found = tracker._measure(mosaic, background, spots, centroid, gain_e_per_dn)
    except InputError:  # the error is reported for the full frame
        return None
    xy = to_image(found.xy, x, y, half, columns)
    # a star at the image border appears complete on the background of the mosaic
    room = float(tracker.centroid.window_px // 2)
    rows = first_of_each(xy, camera.width, camera.height, room, SAME_STAR_PX)
    variance = np.trace(found.covariance, axis1=1, axis2=2)[rows] / 2.0 + tracker.centroid.camera_model_px**2
    stated = np.sqrt(variance + (tracker.guide.catalog.position_sigma_rad / camera.pixel_rad) ** 2)
    seen = Candidates(
        xy[rows],
        found.flux[rows],
        camera.unproject(xy[rows]) if len(rows) else np.empty((0, 3)),
        np.sqrt(variance + IMAGE_FLOOR_PX**2),
        stated * max(factor, 1.0),
        stated,
        len(x),
        min(len(x) * ((2 * half + 1) * camera.pixel_rad) ** 2, tracker.guide.solid_angle_sr),
        centre,
        half,
        found.common_px2,
    )
    return _with_direction(seen)


def _with_direction(seen: Candidates) -> Candidates:
    if math.isfinite(np.add.reduce(seen.vectors, axis=None)):
        return seen
    return seen.select(np.isfinite(seen.vectors[:, 0]))


def as_pixels(image: ArrayLike) -> NDArray[Any] | None:
    """Image for kernels, without a copy if possible; None if it is not an image."""
    try:
        pixels = np.asarray(image)
        if np.ma.is_masked(image) and pixels.dtype.kind in "uif":
            pixels = np.ma.filled(np.ma.asarray(image).astype(np.float32), np.nan)
    except ValueError:
        return None
    if pixels.ndim != 2 or pixels.dtype.kind not in "uif":
        return None
    if not pixels.dtype.isnative or pixels.dtype.itemsize not in (1, 2, 4, 8) or pixels.dtype == np.float16:
        pixels = pixels.astype(np.float32)
    return pixels
