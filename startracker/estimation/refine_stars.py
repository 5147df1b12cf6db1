"""Attitude of a field from its stars only: planets, Moon and Sun are recognised by their ephemeris and excluded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from startracker.catalog.bodies import NO_BODIES, SeenBodies, seen_bodies
from startracker.catalog.guide import GuideDatabase
from startracker.centroid.result import Measured
from startracker.core import FloatArray, IntArray
from startracker.estimation import Estimator
from startracker.estimation.refine import Refined, refine
from startracker.geometry.camera import Camera
from startracker.observer import Observer

STATED_PX = 0.15
"""Error, px, assumed for centroids without stated errors; identification tries up to ten times as much."""
IMAGE_FLOOR_PX = 0.1
"""Error, px, added to the centroid errors for identification only, for errors of the camera model and blends."""


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
