"""From the centroids of a field to a solution: identification around a prior, the fit of the attitude to the stars, and
whether the solution explains the bright stars."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from startracker.catalog.bodies import NO_BODIES, SeenBodies, seen_bodies
from startracker.catalog.guide import GuideDatabase
from startracker.centroid.result import Measured
from startracker.core import FloatArray, IntArray
from startracker.estimation import Estimator
from startracker.estimation.refine import Refined, refine
from startracker.front_end import Clock, FoundStars
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.acceptance import WITHIN_PRIOR_BEYOND, passes_confirmation_threshold
from startracker.identification.observed import Identification, Observed, Prior
from startracker.observer import Observer
from startracker.settings import IdentificationSettings
from startracker.solution import MatchedStars, Solution, Status
from startracker.unexplained import Fitted

Identifier = Callable[[Observed, GuideDatabase, IdentificationSettings, Prior | None], Identification]

_DOUBTFUL = (Status.SOLVED, Status.NO_MATCH, Status.AMBIGUOUS, Status.SEARCH_LIMIT)
"""Results after which the sky outside the prior is searched too, unless they are beyond doubt."""
STATED_PX = 0.15
"""Error, px, assumed for centroids without stated errors; identification tries up to ten times as much."""
IMAGE_FLOOR_PX = 0.1
"""Error, px, added to the centroid errors for identification only, for errors of the camera model and blends."""
MISFIT_PX = 3.0
"""Maximum rms residual of star centroids."""
_BRIGHTEST, _LEAST_SEEN, _BORDER_PX = 8, 0.6, 12.0
"""Number of brightest guide stars of a field, their minimum distance from the border, and the minimum fraction of them
that must be matched: seven or eight of eight in untrailed frames, three in fields found from fragments of trails."""
_LEAST_MATCHED = 0.4
"""Minimum fraction of matched spots among those brighter than the median matched star; fainter spots may be stars that
are not guide stars."""


def identify_around(
    identify: Identifier,
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings,
    prior: Prior | None,
) -> tuple[Identification, bool]:
    """Identification with the stronger evidence, and whether it contradicts the prior."""
    found = identify(observed, guide, settings, prior)
    if (
        prior is None
        or found.status not in _DOUBTFUL
        or passes_confirmation_threshold(found, settings, WITHIN_PRIOR_BEYOND)
    ):
        return found, False
    elsewhere = identify(observed, guide, settings, None)
    operations = found.operations + elsewhere.operations
    better = found.status is not Status.SOLVED or elsewhere.log_false_alarm < found.log_false_alarm
    if elsewhere.status is Status.SOLVED and better:
        # If a pair is common to both results the attitude is the same, and the prior is not contradicted.
        matched = set(map(tuple, elsewhere.pairs.tolist()))
        same = found.status is Status.SOLVED and not matched.isdisjoint(map(tuple, found.pairs.tolist()))
        found = elsewhere if same else _beside_prior(elsewhere)
        return replace(found, operations=operations), not same
    return replace(found, operations=operations), False


def _beside_prior(found: Identification) -> Identification:
    reason = f"{found.reason}; found in the search of the whole sky, outside the prior"
    return replace(found, reason=reason)


class Field(NamedTuple):
    """Centroids of one frame, and the sky as its observer sees it.

    Parameters
    ----------
    stars : Measured
        Centroids, brightest first.
    usable : (U,)
        Rows of the centroids that the identification uses.
    directions : (N, 3)
        Of all centroids in the camera frame, for the given focal length.
    guide : GuideDatabase
        In apparent directions.
    observer : Observer, optional
        Epoch, position and velocity, if known.
    """

    stars: Measured
    usable: IntArray
    directions: FloatArray
    guide: GuideDatabase
    observer: Observer | None


def stated_errors(stars: Measured) -> FloatArray:
    """Standard errors (N,) of the centroids on one axis, px, that are assumed for their identification."""
    if stars.variance_px2 is None:
        return np.full(len(stars.xy), STATED_PX)
    return np.sqrt(stars.variance_px2 + IMAGE_FLOOR_PX**2)


def refine_stars(
    pairs: IntArray,
    stars: Measured,
    camera: Camera,
    guide: GuideDatabase,
    estimator: Estimator,
    directions: FloatArray | None,
    observer: Observer | None,
) -> tuple[Refined, SeenBodies]:
    """Attitude of a field, and the bodies of the solar system among its centroids.

    If a star was identified with the centroid of a body, the attitude is fitted again without this centroid.

    Parameters
    ----------
    pairs, stars, camera, guide, estimator, observer
        As in `startracker.estimation.refine.refine`.
    directions : (N, 3), optional
        Directions of the centroids in the camera frame; None: the focal length is fitted.
    """
    free = directions is None
    refined = refine(pairs, stars, camera, guide, estimator, free, directions, observer)
    matched = refined.pairs[:, 0], refined.residual_px
    bodies = seen_bodies(stars.xy, refined.camera, refined.matrix, observer, matched)
    if not len(bodies.centroid) or not np.isin(bodies.centroid, refined.pairs[:, 0]).any():
        return refined, bodies
    rows = np.setdiff1d(np.arange(len(stars.xy)), bodies.centroid)
    left = pairs[~np.isin(pairs[:, 0], bodies.centroid)]
    left = np.stack([np.searchsorted(rows, left[:, 0]), left[:, 1]], axis=1)
    if len(left) < 2:  # no attitude without it
        return refined, NO_BODIES
    kept = None if directions is None else directions[rows]
    again = refine(left, selected(stars, rows), camera, guide, estimator, free, kept, observer)
    return replace(again, pairs=np.stack([rows[again.pairs[:, 0]], again.pairs[:, 1]], axis=1)), bodies


def selected(stars: Measured, rows: IntArray) -> Measured:
    """Some rows of the centroids."""
    flux, variance, covariance = (
        None if column is None else column[rows] for column in (stars.flux, stars.variance_px2, stars.covariance_px2)
    )
    return Measured(stars.xy[rows], flux, variance, covariance, stars.common_px2, stars.misfit, stars.light)


def solution_of(
    found: Identification, field: Field, camera: Camera, estimator: Estimator, clock: Clock
) -> tuple[Solution, Fitted]:
    """Solution of identified stars, and its fit.

    Parameters
    ----------
    found : Identification
        Solved; its observed stars are rows of `Field.usable`.
    field, camera
        The frame, and its camera; the focal length is fitted if it was for the identification.
    estimator : callable
        One of `startracker.estimation.METHODS`.
    clock : Clock
        Notes the time of the fit.

    Raises
    ------
    InputError
        If the estimator does not support this field.
    """
    pairs, free, known = found.pairs, found.focal != 1.0, camera
    if len(field.usable) < len(field.stars.xy):
        pairs = np.stack([field.usable[pairs[:, 0]], pairs[:, 1]], axis=1)
    if free:
        known = replace(camera, fx=camera.fx * found.focal, fy=camera.fy * found.focal)
    directions = None if free else field.directions
    refined, bodies = refine_stars(pairs, field.stars, known, field.guide, estimator, directions, field.observer)
    solution = replace(_solved(found, refined, field, camera, clock), bodies=bodies)
    used = refined.used
    return solution, Fitted(refined.pairs[used], refined.residual_px[used], refined.matrix, refined.camera)


def _solved(found: Identification, refined: Refined, field: Field, camera: Camera, clock: Clock) -> Solution:
    measured, guide = field.stars, field.guide
    used, chosen = refined.pairs[:, 0], refined.pairs[:, 1]
    sigma_px = None
    if measured.variance_px2 is not None:
        floor_px = guide.catalog.position_sigma_rad / camera.pixel_rad
        sigma_px = np.sqrt(measured.variance_px2[used] + floor_px**2)
    stars = MatchedStars.of(
        guide,
        chosen,
        measured.xy[used],
        refined.residual_px,
        flux=None if measured.flux is None else measured.flux[used],
        used=refined.used,
        sigma_px=sigma_px,
    )
    clock.lap("attitude")
    return Solution(
        status=Status.SOLVED,
        reason=found.reason + _focal_correction(refined.camera.fx / camera.fx),
        attitude=Attitude.from_matrix(refined.matrix),
        covariance=refined.covariance,
        stars=stars,
        centroids=measured.xy,
        fov_deg=refined.camera.fov_deg,
        parity=camera.parity,
        times_ms=clock.times_ms(),
        camera=refined.camera,
        log_false_alarm=found.log_false_alarm,
        operations=found.operations,
        observer=field.observer,
    )


def unsolved(
    camera: Camera,
    status: Status,
    reason: str,
    clock: Clock,
    xy: FloatArray | None = None,
    log_false_alarm: float = 0.0,
    operations: int = 0,
) -> Solution:
    """Solution without an attitude, of these centroids."""
    return Solution(
        status,
        reason,
        centroids=np.empty((0, 2)) if xy is None else xy,
        fov_deg=camera.fov_deg,
        parity=camera.parity,
        times_ms=clock.times_ms(),
        camera=camera,
        log_false_alarm=log_false_alarm,
        operations=operations,
    )


def _focal_correction(factor: float) -> str:
    return "" if factor == 1.0 else f"; the focal length is {factor:.4f} times the camera's"


def explains_bright_stars(solution: Solution, flux: FloatArray, guide: GuideDatabase, trailed: bool = False) -> bool:
    """Whether the residuals are as small as for stars, and many of the bright spots and most of the brightest guide
    stars of the field are matched.

    For trails only the second condition is tested: the ends of long trails are uncertain, and others are cut by the
    border.
    """
    assert solution.attitude is not None
    stars = solution.stars
    if not _many_bright(flux, stars.flux):
        return False
    if trailed:
        return True
    if misfit_px(solution) > MISFIT_PX:
        return False
    index, _, _ = guide.in_field(solution.attitude.as_matrix(), -_BORDER_PX, solution.camera)
    brightest = set(guide.catalog.id[index[:_BRIGHTEST]].tolist())
    return len(brightest.intersection(stars.catalog_id.tolist())) >= _LEAST_SEEN * len(brightest)


def trail_fragments_possible(solution: Solution, flux: FloatArray, guide: GuideDatabase, streaked: bool) -> bool:
    """Whether the matched points may be fragments of trails with a common offset.

    They may if their residuals are too large for stars, or if the frame has streaks with a common motion
    (`streaked`) that do not match stars of the field, and most bright points are not matched. If most bright points of
    a frame are matched, they are stars.
    """
    if misfit_px(solution) > MISFIT_PX:
        return True
    return streaked and not _many_bright(flux, solution.stars.flux) and not explains_bright_stars(solution, flux, guide)


def strongest(tried: Sequence[tuple[FoundStars, Solution]]) -> tuple[FoundStars, Solution]:
    """The solution with the strongest evidence of several hypotheses for a frame, solved ones first; the last one if
    there is no evidence."""
    return min(reversed(tried), key=lambda one: (not one[1].solved, one[1].log_false_alarm))


def misfit_px(solution: Solution) -> float:
    """Rms distance of the fitted stars from their predicted positions."""
    residual = solution.stars.fitted.residual_px
    return math.sqrt(float(residual.ravel() @ residual.ravel()) / len(residual))


def _many_bright(spots: FloatArray, stars: FloatArray) -> bool:
    """Whether enough of the spots brighter than the median star are matched stars."""
    half = len(stars) // 2
    as_bright = np.count_nonzero(spots >= np.sort(stars)[half])
    return len(stars) - half >= _LEAST_MATCHED * float(as_bright)


def flux_of_stars(found: FoundStars, solution: Solution) -> FloatArray:
    """Signal of the centroids that are not bodies of the solar system."""
    assert found.stars.flux is not None
    return solution.without_bodies(found.stars.flux)
