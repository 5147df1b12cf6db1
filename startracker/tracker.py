"""The star tracker: image or centroids in, attitude with its uncertainty out; in every case a status and a reason."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from startracker import centroid as centroiding
from startracker import detection as detecting
from startracker import estimation as estimating
from startracker import identification as identifying
from startracker.attitude import Attitude
from startracker.blind import FreeSearch
from startracker.camera import Camera
from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError
from startracker.explain import attitude_steps, hints, identification_steps, listed_step, search_step
from startracker.front_end import (
    SATURATED_SHARE,
    Clock,
    FoundStars,
    clean_centroids,
    find_stars,
    look_again,
    says_saturated,
)
from startracker.identification.free_scale import FEWEST_MATCHED
from startracker.identification.observed import Identification, Observed, Prior
from startracker.image_map import ImageMap, to_directions
from startracker.observer import Observer
from startracker.refine import refine
from startracker.registry import lookup
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings
from startracker.solution import MatchedStars, Solution, Status
from startracker.trace import Step, Steps
from startracker.whole_field import MISFIT_PX, is_whole, misfit_px

__all__ = ["StarTracker"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

STATED_PX = 0.15
"""Centroid error taken for centroids that come without one; identification tries up to ten times as much."""
IMAGE_FLOOR_PX = 0.1
"""Added to the centroids' errors for identification alone: what camera model and blends may add."""
WORST_PX = 5.0
"""A centroid with a larger error says nothing worth knowing."""
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
    focal_error : float
        Relative error of the camera's focal length, at most. Above zero the focal length and a radial distortion are
        fitted to each frame (six stars are needed); 0: the camera is taken for calibrated.

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
        identifier: str = "adaptive",
        estimator: str = "svd",
        *,
        detection: DetectionSettings | None = None,
        centroid: CentroidSettings | None = None,
        identification: IdentificationSettings | None = None,
        focal_error: float = 0.0,
    ) -> None:
        if not 0.0 <= focal_error < 1.0:
            raise InputError(f"focal_error must be a relative error from 0 to below 1; got {focal_error}")
        self.camera = camera
        self.focal_error = focal_error
        self.catalog = catalog
        self.detection = detection or DetectionSettings()
        self.centroid = centroid or CentroidSettings()
        self.identification = identification or IdentificationSettings()
        self._detect = lookup("detectors", detecting.DETECTORS, detector)
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
        clock = Clock()
        found = find_stars(
            image,
            self._detect,
            self._measure,
            self.detection,
            self.centroid,
            clock,
            shape=(self.camera.height, self.camera.width),
            saturation_dn=saturation_dn,
            gain_e_per_dn=gain_e_per_dn,
        )
        if found.status is not None:
            told = (*found.steps, *hints(found.status, 0, known_camera=True))
            return replace(self._unsolved(found.status, found.reason, clock), steps=told)
        hint = _prior(prior, prior_deg)
        solution, found, steps = self._solve_looks(found, hint, observer, clock, saturation_dn, gain_e_per_dn)
        if not solution.solved and found.saturated_share > SATURATED_SHARE:
            reason = f"{says_saturated(found.saturated_share, found.saturation_dn)}; {solution.reason}"
            solution = replace(solution, status=Status.SATURATED, reason=reason)
        tips = hints(
            solution.status, len(found.xy), known_camera=True, saturated=found.saturated, settings=self.detection
        )
        return replace(solution, steps=Steps(steps, solution.steps, partial(attitude_steps, solution), tips))

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
        clock = Clock()
        points, signal = clean_centroids(xy, flux, self.camera)
        guide = self.guide.seen_by(observer)
        solution = self._solve(points, signal, None, _prior(prior, prior_deg), observer, guide, clock)
        left_out = np.size(xy) // 2 - len(points)
        if left_out and not solution.solved:
            reason = f"{solution.reason} ({left_out} centroids not finite, outside the image or repeated)"
            solution = replace(solution, reason=reason)
        steps = (
            listed_step(np.size(xy) // 2, points, signal),
            *solution.steps,
            *attitude_steps(solution),
            *hints(solution.status, len(points), known_camera=True),
        )
        return replace(solution, steps=steps)

    # ------------------------------------------------------------------ spots or streaks
    def _solve_looks(
        self,
        spots: FoundStars,
        prior: Prior | None,
        observer: Observer | None,
        clock: Clock,
        saturation_dn: float | None,
        gain_e_per_dn: float | None,
    ) -> tuple[Solution, FoundStars, Sequence[Step]]:
        """Solution, the stars that it is of, and the steps that led to these: from spots, or from streaks.

        Pieces of streaks lie near their stars and all off alike: the field is found, and the attitude off by half a
        streak. Streaks are looked for where the frame seems smeared, or spots do not solve it as a whole field; where
        there are some, spots count only if they do.
        """

        guide = self.guide.seen_by(observer)

        def solve(look: FoundStars) -> Solution:
            return self._solve(look.xy, look.flux, look.variance_px2, prior, observer, guide, clock)

        def streaks() -> FoundStars | None:
            known = {"saturation_dn": saturation_dn, "gain_e_per_dn": gain_e_per_dn}
            return look_again(spots, self.detection, self.camera, clock, **known)

        drawn = streaks() if spots.smeared else None
        steps: Sequence[Step] = spots.steps
        if drawn is not None:  # their own measurement is far better, and most often there
            solution, steps = solve(drawn), drawn.steps
            if solution.solved:
                return solution, drawn, steps
            steps = (*steps, *solution.steps, *spots.steps)
        solution = solve(spots)
        if solution.solved and is_whole(solution, spots.flux, guide):
            return solution, spots, steps
        if not spots.smeared:
            drawn = streaks()
            if drawn is not None:
                again = solve(drawn)
                if again.solved or not solution.solved:
                    return again, drawn, (*steps, *solution.steps, *attitude_steps(solution), *drawn.steps)
        if solution.solved and (drawn is not None or misfit_px(solution) > MISFIT_PX):
            within = f"they fit within {misfit_px(solution):.1f} px and leave out bright ones, as pieces of streaks do"
            refused = self._unsolved(Status.NO_MATCH, f"{solution.reason}; but {within}", clock, spots.xy)
            solution = replace(refused, steps=(*solution.steps, *attitude_steps(solution)))
        return solution, spots, steps

    # ------------------------------------------------------------------ the stages after the centroids
    def _solve(
        self,
        xy: FloatArray,
        flux: FloatArray | None,
        variance_px2: FloatArray | None,
        prior: Prior | None,
        observer: Observer | None,
        guide: GuideDatabase,
        clock: Clock,
    ) -> Solution:
        tried: Sequence[Step] = ()
        if self.focal_error > 0.0 and len(xy) >= FEWEST_MATCHED:
            camera, error = self.camera, self.focal_error
            search = FreeSearch(
                xy,
                flux,
                camera.width,
                camera.height,
                self.catalog,
                self.identification,
                observer,
                variance_px2=variance_px2,
                rough=camera,
            )
            fov = camera.fov_deg
            band = (fov * (1.0 - error), fov, fov * (1.0 + error))
            solution = search.run((band,), (camera.parity,))
            clock.lap("free_scale")
            tried = (
                search_step(search.trials, (band,), (camera.parity,)),
                Step("identification", solution.reason),
            )
            if solution.solved:
                return replace(solution, times_ms=clock.times_ms(), steps=tried)
        stated = np.full(len(xy), STATED_PX) if variance_px2 is None else np.sqrt(variance_px2 + IMAGE_FLOOR_PX**2)
        directions, usable, vectors, sigma = _seen(xy, stated, self.camera.pixel_rad, self.camera.image_map)
        observed = Observed(vectors, None if flux is None else flux[usable], sigma)
        found = self._identify(observed, guide, self.identification, prior)
        if prior is not None and found.status in (Status.NO_MATCH, Status.AMBIGUOUS):
            elsewhere = self._identify(observed, guide, self.identification, None)
            if elsewhere.status is Status.SOLVED:
                found = _beside_prior(elsewhere)
        clock.lap("identification")
        faintest = float(guide.v_mag[-1])  # brightest first
        told = partial(identification_steps, found.steps, found.reason, len(guide.v_mag), faintest, self.camera)
        tried = Steps(tried, told)
        if found.status is not Status.SOLVED:
            return replace(self._unsolved(found.status, found.reason, clock, xy), steps=tried)
        pairs = found.pairs.copy()
        pairs[:, 0] = usable[pairs[:, 0]]
        camera, free = self.camera, found.focal != 1.0
        if free:
            camera = replace(camera, fx=camera.fx * found.focal, fy=camera.fy * found.focal)
        try:
            known = None if free else directions
            refined = refine(pairs, xy, variance_px2, camera, guide, self._estimate, free, directions=known)
        except InputError as error:  # an estimator that cannot do this field, as plate constants of a mirrored one
            return self._unsolved(Status.NO_MATCH, f"{found.reason}; but the estimator says: {error}", clock, xy)
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
            found.reason + _off_focus(refined.camera.fx / self.camera.fx),
            Attitude.from_matrix(refined.matrix),
            refined.covariance,
            stars,
            xy,
            refined.camera.fov_deg,
            self.camera.parity,
            clock.times_ms(),
            refined.camera,
            tried,
        )

    def _unsolved(self, status: Status, reason: str, clock: Clock, xy: FloatArray | None = None) -> Solution:
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


@njit(cache=True, error_model="numpy")
def _seen(
    xy: FloatArray, stated_px: FloatArray, pixel_rad: float, image: ImageMap
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Directions (N, 3) of centroids, those that are of use (M,), and directions and standard errors, rad, of these."""
    directions = to_directions(xy, image)
    usable, sigma, count = np.empty(len(xy), np.int64), np.empty(len(xy)), 0
    for n in range(len(xy)):
        # beyond the lens model's fold there are no directions, NaN on all axes
        if math.isfinite(directions[n, 2]) and stated_px[n] < WORST_PX:
            usable[count], sigma[count] = n, stated_px[n] * pixel_rad
            count += 1
    usable = usable[:count]
    return directions, usable, directions[usable], sigma[:count]


def _prior(attitude: Attitude | None, prior_deg: float) -> Prior | None:
    if attitude is None:
        return None
    if not (math.isfinite(prior_deg) and prior_deg > 0):
        raise InputError(f"prior_deg must be a positive angle in degrees; got {prior_deg}")
    # at the limit about all three axes at once
    return Prior(attitude, min(math.radians(prior_deg) * _AXES, math.pi))


def _off_focus(factor: float) -> str:
    return "" if factor == 1.0 else f"; the focal length is {factor:.4f} times the camera's"


def _beside_prior(found: Identification) -> Identification:
    reason = f"{found.reason}; found over the whole sky, not within the prior"
    return replace(found, reason=reason)
