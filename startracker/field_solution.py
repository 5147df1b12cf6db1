"""From identified stars to a solution: the fit of the attitude, and the matched stars with their residuals."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.centroid.result import Measured
from startracker.core import FloatArray, IntArray
from startracker.estimation import Estimator
from startracker.estimation.refine import Refined
from startracker.estimation.refine_stars import refine_stars
from startracker.front_end import Clock
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.observed import Identification
from startracker.observer import Observer
from startracker.solution import MatchedStars, Solution, Status
from startracker.unexplained import Fitted


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


def _focal_correction(factor: float) -> str:
    return "" if factor == 1.0 else f"; the focal length is {factor:.4f} times the camera's"
