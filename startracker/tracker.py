"""The star tracker: image or centroids in, attitude with its uncertainty out; in every case a status and a reason."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker import centroid as centroiding
from startracker import detection as detecting
from startracker import estimation as estimating
from startracker import identification as identifying
from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError
from startracker.identification.observed import Identification, Observed, Prior
from startracker.observer import Observer
from startracker.refine import refine
from startracker.registry import lookup
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings
from startracker.solution import MatchedStars, Solution, Status

__all__ = ["StarTracker"]

FloatArray = NDArray[np.float64]

STATED_PX = 0.15
"""Centroid error taken for centroids that come without one; identification tries up to ten times as much."""
IMAGE_FLOOR_PX = 0.1
"""Added to the centroids' errors for identification alone: what camera model and blends may add."""
SAME_STAR_PX = 0.75
"""Two centroids closer than this are one star found twice."""
_SATURATED_SHARE = 0.05
_WHITE_SHARE = 0.5
_AXES = math.sqrt(3.0)


class StarTracker:
    """Star tracker of one camera.

    Parameters
    ----------
    camera : Camera
        Calibrated camera.
    catalog : str or StarCatalog
        Name (``hipparcos``, ``bsc5``) or a table of one's own.
    magnitude_limit : float
        Faintest guide star, V; best a little beyond what the camera detects.
    detector, centroider, identifier, estimator : str
        Algorithms by name: the ``METHODS`` of `startracker.detection`, `centroid`, `identification`, `estimation`, or
        what other packages offer.
    detection, centroid, identification : settings
        Knobs of the stages.

    Raises
    ------
    InputError
        For an unknown name, or a magnitude limit that leaves no stars.
    """

    def __init__(
        self,
        camera: Camera,
        catalog: str | StarCatalog = "hipparcos",
        magnitude_limit: float = 6.0,
        detector: str = "components",
        centroider: str = "moment",
        identifier: str = "match_groups",
        estimator: str = "svd",
        *,
        detection: DetectionSettings | None = None,
        centroid: CentroidSettings | None = None,
        identification: IdentificationSettings | None = None,
    ) -> None:
        self.camera = camera
        self.detection = detection or DetectionSettings()
        self.centroid = centroid or CentroidSettings()
        self.identification = identification or IdentificationSettings()
        self._detect = lookup("detectors", detecting.METHODS, detector)
        self._measure = lookup("centroiders", centroiding.METHODS, centroider)
        self._identify = lookup("identifiers", identifying.METHODS, identifier)
        self._estimate = lookup("estimators", estimating.METHODS, estimator)
        table = load_catalog(catalog) if isinstance(catalog, str) else catalog
        self.guide = GuideDatabase.build(table, camera, magnitude_limit, self.identification)

    # ------------------------------------------------------------------ what users call
    def solve(
        self,
        image: ArrayLike,
        *,
        prior: Attitude | None = None,
        prior_deg: float = 1.0,
        observer: Observer | None = None,
        saturation_dn: float | None = None,
        gain_e_per_dn: float | None = None,
    ) -> Solution:
        """Attitude of an image.

        Parameters
        ----------
        image : array_like, shape (H, W)
            Any unit (DN); H and W are the camera's. NaN marks bad pixels.
        prior : Attitude, optional
            ICRS to camera, from other sensors or the last frame.
        prior_deg : float
            Largest error of the prior about each axis, degrees.
        observer : Observer, optional
            Epoch, velocity and position: space motion, aberration and parallax are then taken account of. Without it
            the stars stand as at the catalogue's epoch, and the attitude is off by the aberration (20″) and more.
        saturation_dn, gain_e_per_dn : float, optional
            Of the detector, where known.

        Returns
        -------
        Solution
            Never raises for what the image shows: the status and the reason tell.
        """
        clock = _Clock()
        pixels, fault = _as_pixels(image, self.camera)
        if pixels is None:
            return self._unsolved(Status.BAD_IMAGE, fault, clock)
        share, level = _saturated_share(np.asarray(image), pixels, saturation_dn)
        if share > _WHITE_SHARE:
            return self._unsolved(Status.SATURATED, _says_saturated(share, level), clock)
        if float(np.nanmax(pixels)) == float(np.nanmin(pixels)):
            return self._unsolved(Status.NO_STARS, f"every pixel is {float(np.nanmax(pixels)):g}", clock)
        try:
            background = detecting.estimate(pixels, self.detection.background_tile_px)
            clock.lap("background")
            spots = self._detect(pixels, background, self.detection, saturation_dn)
            clock.lap("detection")
            found = self._measure(pixels, background, spots, self.centroid, gain_e_per_dn)
            clock.lap("centroid")
        except InputError as error:
            return self._unsolved(Status.BAD_IMAGE, str(error), clock)
        variance = np.trace(found.covariance, axis1=1, axis2=2) / 2.0
        solution = self._solve(found.xy, found.flux, variance, _prior(prior, prior_deg), observer, clock)
        if not solution.solved and share > _SATURATED_SHARE:
            reason = f"{_says_saturated(share, level)}; {solution.reason}"
            return self._unsolved(Status.SATURATED, reason, clock, solution.centroids)
        return solution

    def solve_centroids(
        self,
        xy: ArrayLike,
        flux: ArrayLike | None = None,
        *,
        prior: Attitude | None = None,
        prior_deg: float = 1.0,
        observer: Observer | None = None,
    ) -> Solution:
        """Attitude of star positions measured elsewhere.

        Parameters
        ----------
        xy : array_like, shape (N, 2)
            Pixels (x, y) = (column, row), the first pixel's centre at (0, 0). NaN, repeated and outside ones are
            left out.
        flux : array_like, shape (N,), optional
            Signal, any linear unit. Without it the order counts as the order of brightness, magnitudes do not.
        prior, prior_deg, observer
            As in `solve`.

        Raises
        ------
        InputError
            When the arrays' shapes do not fit.
        """
        clock = _Clock()
        points, signal = clean_centroids(xy, flux, self.camera)
        solution = self._solve(points, signal, None, _prior(prior, prior_deg), observer, clock)
        left_out = np.size(xy) // 2 - len(points)
        if left_out and not solution.solved:
            reason = f"{solution.reason} ({left_out} centroids not finite, outside the image or repeated)"
            solution = replace(solution, reason=reason)
        return solution

    # ------------------------------------------------------------------ the stages after the centroids
    def _solve(
        self,
        xy: FloatArray,
        flux: FloatArray | None,
        variance_px2: FloatArray | None,
        prior: Prior | None,
        observer: Observer | None,
        clock: _Clock,
    ) -> Solution:
        guide = self.guide.seen_by(observer)
        vectors = self.camera.unproject(xy) if len(xy) else np.empty((0, 3))
        usable = np.flatnonzero(np.isfinite(vectors).all(axis=1))  # beyond the lens model's fold there are none
        stated = np.full(len(xy), STATED_PX) if variance_px2 is None else np.sqrt(variance_px2 + IMAGE_FLOOR_PX**2)
        observed = Observed(
            vectors[usable], None if flux is None else flux[usable], stated[usable] * self.camera.pixel_rad
        )
        found = self._identify(observed, guide, self.identification, prior)
        if prior is not None and found.status in (Status.NO_MATCH, Status.AMBIGUOUS):
            elsewhere = self._identify(observed, guide, self.identification, None)
            if elsewhere.status is Status.SOLVED:
                found = _beside_prior(elsewhere)
        clock.lap("identification")
        if found.status is not Status.SOLVED:
            return self._unsolved(found.status, found.reason, clock, xy)
        pairs = np.stack([usable[found.pairs[:, 0]], found.pairs[:, 1]], axis=1)
        refined = refine(pairs, xy, variance_px2, self.camera, guide, self._estimate)
        used, chosen = refined.pairs[:, 0], refined.pairs[:, 1]
        stars = MatchedStars(
            xy[used],
            guide.catalog.id[chosen],
            guide.catalog.star_name[chosen],
            guide.v_mag[chosen],
            np.full(len(used), np.nan) if flux is None else flux[used],
            refined.residual_px,
        )
        clock.lap("attitude")
        return Solution(
            Status.SOLVED,
            found.reason,
            Attitude.from_matrix(refined.matrix),
            refined.covariance,
            stars,
            xy,
            self.camera.fov_deg,
            self.camera.parity,
            clock.times_ms(),
            self.camera,
        )

    def _unsolved(self, status: Status, reason: str, clock: _Clock, xy: FloatArray | None = None) -> Solution:
        points = np.empty((0, 2)) if xy is None else xy
        return Solution(
            status,
            reason,
            centroids=points,
            fov_deg=self.camera.fov_deg,
            parity=self.camera.parity,
            times_ms=clock.times_ms(),
            camera=self.camera,
        )


@dataclass
class _Clock:
    """Milliseconds of each stage."""

    laps: dict[str, float] = field(default_factory=dict)
    start: float = field(default_factory=time.perf_counter)
    last: float = field(default_factory=time.perf_counter)

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = (now - self.last) * 1e3
        self.last = now

    def times_ms(self) -> dict[str, float]:
        return {**self.laps, "total": (time.perf_counter() - self.start) * 1e3}


def clean_centroids(
    xy: ArrayLike, flux: ArrayLike | None, camera: Camera
) -> tuple[FloatArray, FloatArray | None]:
    """Centroids (N, 2) fit for use, brightest first, and their flux: finite, on the image, no star twice.

    A flux that is not a positive number counts as the faintest of all.
    """
    points = np.asarray(xy, dtype=float)
    if points.size == 0:
        points = points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"centroids must have the shape (N, 2), columns x and y; got {points.shape}")
    signal = None if flux is None else np.asarray(flux, dtype=float).reshape(-1)
    if signal is not None and len(signal) != len(points):
        raise InputError(f"there are {len(points)} centroids, but {len(signal)} fluxes")
    keep = np.flatnonzero(np.isfinite(points).all(axis=1) & camera.contains(points))
    points = points[keep]
    if signal is not None:
        signal = signal[keep]
        good = np.isfinite(signal) & (signal > 0)
        if good.any():
            signal = np.where(good, signal, signal[good].min() * 0.5)
            # position breaks ties, so that the order of the rows means nothing
            order = np.lexsort((points[:, 0], points[:, 1], -signal))
            points, signal = points[order], signal[order]
        else:
            signal = None
    alone = [
        k for k in range(len(points)) if not np.any(np.abs(points[:k] - points[k]).max(axis=1, initial=0) < SAME_STAR_PX)
    ]
    return points[alone], None if signal is None else signal[alone]


def _prior(attitude: Attitude | None, prior_deg: float) -> Prior | None:
    if attitude is None:
        return None
    if not (math.isfinite(prior_deg) and prior_deg > 0):
        raise InputError(f"prior_deg must be a positive angle in degrees; got {prior_deg}")
    # at the limit about all three axes at once
    return Prior(attitude, min(math.radians(prior_deg) * _AXES, math.pi))


def _beside_prior(found: Identification) -> Identification:
    reason = f"{found.reason}; found over the whole sky, not within the prior"
    return Identification(found.status, reason, found.pairs, found.log_false_alarm)


def _as_pixels(image: ArrayLike, camera: Camera) -> tuple[NDArray[np.float32] | None, str]:
    try:
        pixels = np.asarray(image)
        if pixels.dtype.kind not in "buif":
            return None, f"an image needs real numbers; got {pixels.dtype}"
        pixels = pixels.astype(np.float32, copy=False)
    except (TypeError, ValueError):
        return None, "an image must be an array of numbers"
    if pixels.ndim != 2:
        return None, f"an image must have two dimensions (rows, columns); got {pixels.shape}"
    if pixels.shape != (camera.height, camera.width):
        return None, (
            f"the image is {pixels.shape[1]}×{pixels.shape[0]} pixels, the camera {camera.width}×{camera.height}: "
            "give the camera that took it"
        )
    if not np.isfinite(pixels).any():
        return None, "no pixel of the image is a finite number"
    return np.ascontiguousarray(np.where(np.isfinite(pixels), pixels, np.nan)), ""


def _saturated_share(
    image: NDArray[np.generic], pixels: NDArray[np.float32], saturation_dn: float | None
) -> tuple[float, float]:
    """Share of pixels at saturation and that level: as given, the largest number of the type, or a flat top."""
    top = float(np.nanmax(pixels))
    level = saturation_dn
    if level is None and image.dtype.kind == "u":
        level = float(np.iinfo(image.dtype).max)
    if level is None:
        level = top if top > 0 else math.inf
    return float(np.mean(pixels >= level)), level


def _says_saturated(share: float, level: float) -> str:
    return f"{100 * share:.0f} % of the pixels are at or above {level:g}: saturated; expose for less time"
