"""The star tracker: from an image or centroids to an attitude with its covariance, a status and a reason."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from startracker import centroid as centroiding
from startracker import detection as detecting
from startracker import estimation as estimating
from startracker import identification as identifying
from startracker.arguments import real_number
from startracker.catalog import as_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.centroid.result import Measured
from startracker.core import FloatArray, IntArray
from startracker.display import described
from startracker.errors import InputError
from startracker.estimation.field_fit import Estimator, takes_field
from startracker.explain import attitude_steps, catalogue_step, hints, identification_steps, listed_step, search_step
from startracker.field_solution import (
    Field,
    explains_bright_stars,
    flux_of_stars,
    identify_around,
    misfit_px,
    selected,
    solution_of,
    stated_errors,
    strongest,
    trail_fragments_possible,
    unsolved,
)
from startracker.free_search import FreeSearch
from startracker.front_end import Clock, FoundStars, star_hypotheses
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera, as_camera
from startracker.identification.about_knot import about_knot
from startracker.identification.acceptance import accepts, passes_confirmation_threshold
from startracker.identification.observed import Identification, Observed, Prior, as_prior, usable_directions
from startracker.identification.unknown_scale.free_scale import FEWEST_MATCHED
from startracker.inputs import (
    SATURATED_SHARE,
    given_image,
    prior_of,
    saturation_message,
    stated_variance,
    usable_centroids,
)
from startracker.observer import Observer, observer_of
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings
from startracker.settings.checks import BELOW_1, settings_or_default
from startracker.settings.identification import settings_of
from startracker.settings.registry import lookup
from startracker.solution import Solution, Status
from startracker.trace import Step, Steps, Trace
from startracker.unexplained import Fitted, reason_to_refuse


class StarTracker:
    """Star tracker for one camera.

    Parameters
    ----------
    camera : Camera or path
        Calibrated camera, or the name of its file, as for ``boresight solve --camera``.
    catalog : str or StarCatalog
        Name (``hipparcos``, ``bsc5``, ``gaia``) or a user-defined table.
    magnitude_limit : float
        Magnitude limit of the guide stars, V; should be slightly fainter than the camera detects.
    detector, centroider, identifier, estimator : str
        Algorithms by name: the ``METHODS`` of `startracker.detection`, `centroid`, `identification`, `estimation`, or
        those of other packages.
    detection, centroid : settings
        Settings of these stages.
    identification : IdentificationSettings
        Settings common to all identifiers, or the identifier's own class, such as `MatchGroupSettings` for
        ``match_groups``.
    focal_error : float
        Maximum relative error of the camera's focal length. If positive, the focal length and a radial distortion are
        fitted to each frame (six stars are needed); 0: the camera is calibrated.

    Raises
    ------
    InputError
        For an unknown name, settings of another stage or identifier, or a magnitude limit that leaves no stars.
    """

    def __init__(
        self,
        camera: Camera | str | os.PathLike[str],
        catalog: str | StarCatalog = "hipparcos",
        magnitude_limit: float = 6.0,
        detector: str = "components",
        centroider: str = "moment",
        identifier: str = "adaptive",
        estimator: str = "field_fit",
        *,
        detection: DetectionSettings | None = None,
        centroid: CentroidSettings | None = None,
        identification: IdentificationSettings | None = None,
        focal_error: float = 0.0,
    ) -> None:
        self.camera = as_camera("camera", camera)
        self.focal_error = real_number("focal_error", focal_error, least=0.0, most=BELOW_1)
        self.catalog = catalog
        self.methods = detector, centroider, identifier, estimator
        self.detection = settings_or_default("detection", detection, DetectionSettings)
        self.centroid = settings_or_default("centroid", centroid, CentroidSettings)
        self.identification = settings_of(identifier, identification)
        self._detect = lookup("detectors", detecting.METHODS, detector)
        self._measure = lookup("centroiders", centroiding.METHODS, centroider)
        self._identify = lookup("identifiers", identifying.METHODS, identifier)
        self._estimate = lookup("estimators", estimating.METHODS, estimator)
        faintest = real_number("magnitude_limit", magnitude_limit, finite=False)
        self.guide = GuideDatabase.build(as_catalog(catalog), self.camera, faintest, self.identification)

    def __repr__(self) -> str:
        stars = f"{len(self.guide):,} guide stars of {self.guide.catalog.name} to V {self.guide.v_mag[-1]:.1f}"
        return described("StarTracker", repr(self.camera), stars, " → ".join(self.methods))

    @property
    def direction_estimator(self) -> Estimator | None:
        """The estimator, if it computes an attitude from directions; None for the fit of the field."""
        return None if takes_field(self._estimate) else self._estimate

    # ------------------------------------------------------------------ public methods
    def solve(
        self,
        image: Any,
        *,
        prior: Attitude | None = None,
        prior_deg: float | None = None,
        lost_in_space: bool = False,
        observer: Observer | None = None,
        time: Any = None,
        saturation_dn: float | None = None,
        gain_e_per_dn: float | None = None,
    ) -> Solution:
        """Attitude from an image.

        Parameters
        ----------
        image : array_like, shape (H, W), or an object with the attribute `image`
            Any unit (DN); H and W are the camera's. NaN marks bad pixels. Of an object (a frame of the simulator, a
            `LoadedImage`) `observer`, `saturation_dn`, `gain_e_per_dn`, and `prior` with `prior_deg` are used as well,
            if they are not given here. A frame has a prior if its scenario says ``tracker.prior: true``.
        prior : Attitude or scipy Rotation, optional
            ICRS to camera, from other sensors or the last frame. For an astropy SkyCoord, which has no roll, use
            ``Attitude.from_skycoord(coordinate, roll_deg)``.
        prior_deg : float or astropy Quantity, optional
            Maximum error of the prior about each axis, degrees; 1 if it is not stated. Unless the result within
            the prior is beyond doubt, the whole sky is searched as well.
        lost_in_space : bool
            Do not use the prior of the frame.
        observer : Observer, optional
            Epoch, velocity and position, for space motion, aberration and parallax. Without it catalogue positions at
            the catalogue's epoch are used, and aberration (up to 26″) is not corrected: the covariance includes it.
        time : astropy Time or float, optional
            Time of the image (a number is a Julian year, TT), if nothing else is known of the observer. Only space
            motion is then applied.
        saturation_dn, gain_e_per_dn : float, optional
            Of the detector, if known.

        Returns
        -------
        Solution
            An image that cannot be solved does not raise; see the status and the reason.
        """
        clock, given = Clock(), given_image(image, observer, time, saturation_dn, gain_e_per_dn)
        trace: Trace = []
        stages = self._detect, self._measure, self.detection, self.centroid
        hypotheses = star_hypotheses(given, *stages, clock, self.camera, trace)
        found = next(hypotheses)
        if found.status is not None:
            trace.append(partial(hints, found.status, 0, known_camera=True))
            refused = unsolved(self.camera, found.status, found.reason, clock)
            return replace(refused, steps=Steps(*trace), catalog=self.guide.catalog.provenance)
        trace.append(partial(catalogue_step, self.guide.catalog.provenance))
        hint = as_prior(*prior_of(image, prior, prior_deg, lost_in_space))
        solution, found = self._best_hypothesis(chain((found,), hypotheses), hint, given.observer, clock, trace)
        if not solution.solved and found.saturated_share > SATURATED_SHARE:
            reason = f"{saturation_message(found.saturated_share, found.saturation_dn)}; {solution.reason}"
            solution = replace(solution, status=Status.SATURATED, reason=reason)
        seen, saturated = len(found.stars.xy), found.saturated
        trace.append(partial(attitude_steps, solution))
        trace.append(
            partial(hints, solution.status, seen, known_camera=True, saturated=saturated, settings=self.detection)
        )
        return replace(solution, steps=Steps(*trace), catalog=self.guide.catalog.provenance)

    def solve_centroids(
        self,
        xy: ArrayLike,
        flux: ArrayLike | None = None,
        *,
        sigma_px: ArrayLike | None = None,
        prior: Attitude | None = None,
        prior_deg: float = 1.0,
        observer: Observer | None = None,
        time: Any = None,
    ) -> Solution:
        """Attitude from given star positions.

        Parameters
        ----------
        xy : array_like, shape (N, 2)
            Pixels (x, y) = (column, row), the first pixel's centre at (0, 0). NaN, duplicates and points outside the
            image are left out.
        flux : array_like, shape (N,), optional
            Signal in any linear unit. If omitted, the stars are taken as sorted by brightness and magnitudes are not
            used.
        sigma_px : array_like, shape (N,) or a number, optional
            Standard error of each centroid on one axis, pixels. If omitted, all centroids have equal weight and their
            error is estimated from the residuals; the covariance for few stars is then larger accordingly.
        prior, prior_deg, observer, time
            As in `solve`.

        Raises
        ------
        InputError
            If the shapes of the arrays do not match or an error is not positive.
        """
        clock, observer = Clock(), observer_of(observer, time)
        points, signal, rows = usable_centroids(xy, flux, self.camera.width, self.camera.height)
        given = np.size(xy) // 2
        source = self.guide.catalog.provenance
        trace: Trace = [partial(listed_step, given, points, signal), partial(catalogue_step, source)]
        guide, variance = self.guide.apparent_to(observer), stated_variance(sigma_px, given, rows)
        measured = Measured(points, signal, variance)
        solution = self._solve(measured, as_prior(prior, prior_deg), observer, guide, clock, trace)
        reason, left_out = solution.reason, given - len(points)
        if left_out and not solution.solved:
            reason = f"{reason} ({left_out} centroids not finite, outside the image or repeated)"
        trace.append(partial(attitude_steps, solution))
        trace.append(partial(hints, solution.status, len(points), known_camera=True))
        return replace(solution, reason=reason, steps=Steps(*trace), catalog=source)

    # ------------------------------------------------------------------ points or trails
    def _best_hypothesis(
        self,
        hypotheses: Iterable[FoundStars],
        prior: Prior | None,
        observer: Observer | None,
        clock: Clock,
        trace: Trace,
    ) -> tuple[Solution, FoundStars]:
        """Solution, and the stars it was computed from.

        If the more likely hypothesis (points or trails) does not explain the bright stars, the other one is tried as
        well, and the solution with the stronger evidence is returned. Fragments of trails lie close to their stars with
        a common offset: a solution from points is only accepted if they cannot be fragments.
        """
        guide = self.guide.apparent_to(observer)
        tried: list[tuple[FoundStars, Solution]] = []
        for found in hypotheses:
            solution = self._solve(found.stars, prior, observer, guide, clock, trace)
            tried.append((found, solution))
            flux = flux_of_stars(found, solution)
            if solution.solved and explains_bright_stars(solution, flux, guide, found.trailed):
                break
        found, solution = strongest(tried)
        trace.extend(partial(attitude_steps, unused) for _, unused in tried if unused is not solution)
        operations, trailed = sum(one.operations for _, one in tried), any(one.trailed for one, _ in tried)
        if found.trailed:
            return replace(solution, operations=operations), found
        flux = flux_of_stars(found, solution)
        if solution.solved and trail_fragments_possible(solution, flux, guide, trailed):
            trace.append(partial(attitude_steps, solution))
            within = f"residuals of {misfit_px(solution):.1f} px and unmatched bright stars suggest fragments of trails"
            refused = unsolved(self.camera, Status.NO_MATCH, f"{solution.reason}; but {within}", clock, found.stars.xy)
            return replace(refused, operations=operations), found
        reason = solution.reason
        if trailed and not solution.solved and accepts(solution.log_false_alarm, self.identification):
            reason = f"{reason}; they may be fragments of trails"
        return replace(solution, reason=reason, operations=operations), found

    # ------------------------------------------------------------------ the stages after the centroids
    def _solve(
        self,
        stars: Measured,
        prior: Prior | None,
        observer: Observer | None,
        guide: GuideDatabase,
        clock: Clock,
        trace: Trace,
    ) -> Solution:
        """Solution of centroids; what was tried is appended to the trace."""
        free_fit: Solution | None = None
        if self.focal_error > 0.0 and len(stars.xy) >= FEWEST_MATCHED:
            free_fit = self._free_fit(stars, guide, observer, clock, trace)
            if passes_confirmation_threshold(free_fit, self.identification):
                return replace(free_fit, times_ms=clock.times_ms())
        observed, usable, directions = self._observed(stars, self.camera)
        if len(usable) > len(observed.vectors):
            text = f"the {len(observed.vectors)} brightest of {len(usable)} centroids are used (max_centroids)"
            trace.append(Step("identification", text))
        found, contradicted = identify_around(self._identify, observed, guide, self.identification, prior)
        clock.lap("identification")
        faintest = float(guide.v_mag[-1])  # brightest first
        trace.append(partial(identification_steps, found.steps, found.reason, len(guide.v_mag), faintest, self.camera))
        if free_fit is not None:
            found = replace(found, operations=found.operations + free_fit.operations)
            if free_fit.solved and not (
                found.status is Status.SOLVED and found.log_false_alarm < free_fit.log_false_alarm
            ):
                return replace(free_fit, times_ms=clock.times_ms(), operations=found.operations)
        if found.status is not Status.SOLVED:
            return unsolved(
                self.camera, found.status, found.reason, clock, stars.xy, found.log_false_alarm, found.operations
            )
        field = Field(stars, usable, directions, guide, observer)
        try:
            solution = self._checked(found, observed, field, prior, clock, trace)
        except InputError as error:  # the estimator does not support this field, as plate constants a mirrored one
            reason = f"{found.reason}; but the estimator failed: {error}"
            return unsolved(self.camera, Status.NO_MATCH, reason, clock, stars.xy)
        return replace(solution, prior_contradicted=True) if contradicted else solution

    def _checked(
        self,
        found: Identification,
        observed: Observed,
        field: Field,
        prior: Prior | None,
        clock: Clock,
        trace: Trace,
    ) -> Solution:
        """Solution of an identification. If there is a `reason_to_refuse` it, its position in the sky may still be
        right: then the attitude about its stars that is accepted, or none."""
        solution, fit = solution_of(found, field, self.camera, self._estimate, clock)
        refusal = self._refusal(solution, fit, field)
        if not refusal:
            return solution
        again = about_knot(found, observed, field.guide, self.identification)
        trace.append(partial(attitude_steps, solution))
        trace.extend(Step("identification", text) for text in (f"but {refusal}", *again.steps))
        if again.status is Status.SOLVED:
            other, fit = solution_of(again, field, self.camera, self._estimate, clock)
            if not self._refusal(other, fit, field):
                outside = prior is not None and not prior.allows(fit.matrix)
                return replace(other, prior_contradicted=outside)
        reason, chance = f"{solution.reason}; but {refusal}", solution.log_false_alarm
        return unsolved(self.camera, Status.NO_MATCH, reason, clock, field.stars.xy, chance, again.operations)

    def _refusal(self, solution: Solution, fit: Fitted, field: Field) -> str:
        """Why a solution is refused (`reason_to_refuse`); empty if it is not."""
        stars, guide = field.stars, field.guide

        def identify(rows: IntArray) -> IntArray:
            return self._alone(selected(stars, rows), guide, fit.camera)

        bodies = solution.bodies.centroid
        return reason_to_refuse(stars.xy, stated_errors(stars), fit, guide, bodies, identify, stars.light)

    def _alone(self, stars: Measured, guide: GuideDatabase, camera: Camera) -> IntArray:
        """Guide stars with which some centroids are identified by themselves, seen by a camera."""
        return self._identify(self._observed(stars, camera)[0], guide, self.identification, None).pairs[:, 1]

    def _free_fit(
        self, stars: Measured, guide: GuideDatabase, observer: Observer | None, clock: Clock, trace: Trace
    ) -> Solution:
        """Solution with fitted focal length, within its error."""

        def identify(rows: IntArray, camera: Camera) -> IntArray:
            return guide.catalog.id[self._alone(selected(stars, rows), guide, camera)]

        stated, settings = stars.variance_px2, self.identification
        search = FreeSearch.about(self.camera, stars.xy, stars.flux, stated, self.catalog, settings, observer)
        search.estimator, search.light, search.identify = self.direction_estimator, stars.light, identify
        search.faintest_v = float(guide.v_mag[-1])
        found, band = search.run_about(self.focal_error)
        clock.lap("free_scale")
        trace.append(search_step(search.trials, (band,), (self.camera.parity,)))
        trace.append(Step("identification", found.reason))
        return found

    def _observed(self, stars: Measured, camera: Camera) -> tuple[Observed, IntArray, FloatArray]:
        """Directions for the identification, the centroids that have one, and those of all centroids."""
        stated = stated_errors(stars)
        most = self.identification.max_centroids
        directions, usable, vectors, sigma = usable_directions(stars.xy, stated, camera.pixel_rad, camera.image_map)
        signal = None if stars.flux is None else stars.flux[usable[:most]]
        return Observed(vectors[:most], signal, sigma[:most]), usable, directions
