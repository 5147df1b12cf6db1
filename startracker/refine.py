"""From identified stars to the attitude: match all stars of the field, drop what does not fit, weigh the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.camera import Camera
from startracker.catalog.guide import GuideDatabase
from startracker.estimation import Estimator
from startracker.estimation.wahba import fit_rotation
from startracker.identification.hypothesis import nearest_unique
from startracker.identification.verification import fit_step, focal_slopes, turned

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

REJECT_SIGMAS = 3.7
"""A residual's length beyond this many of its standard errors an axis has probability 1e-3 (Rayleigh)."""
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
_UNKNOWN_FLOOR_PX = 0.003
_FEWEST_TO_REJECT = 4
_MISFIT_SIGMAS = 4.0
_MANY, _LEAST_SCALE = 10, 0.4


@dataclass(frozen=True, eq=False)
class Refined:
    """Attitude of one field.

    Parameters
    ----------
    matrix : (3, 3)
        ICRS to camera.
    covariance : (3, 3)
        Of the rotation-vector error in camera axes, rad², scaled with the residuals.
    pairs : int (M, 2)
        Centroid and guide index of the stars used.
    residual_px : (M, 2)
        Measured minus predicted.
    camera : Camera
        The one given, or with the focal length fitted.
    """

    matrix: FloatArray
    covariance: FloatArray
    pairs: IntArray
    residual_px: FloatArray
    camera: Camera


def refine(
    pairs: IntArray,
    xy: FloatArray,
    variance_px2: FloatArray | None,
    camera: Camera,
    guide: GuideDatabase,
    estimator: Estimator,
    free_focal: bool = False,
) -> Refined:
    """Attitude from all centroids that agree with guide stars of the field.

    Starts from the identified pairs; then, until nothing changes: attitude, prediction of every guide star on the
    image, nearest centroids, rejection of residuals beyond 3.7 robust standard errors (blends, false matches). The
    robust scale is the median of the normalised residuals, not below one where the errors are known and stars are few.

    Parameters
    ----------
    pairs : (M, 2)
        Identified (centroid, guide star).
    xy : (N, 2)
        Centroids, pixels.
    variance_px2 : (N,), optional
        Variance of each centroid on one axis; None: unknown, equal, and told by the residuals.
    camera, guide, estimator
        The camera, the guide stars as the observer sees them, and a method of `startracker.estimation`.
    free_focal : bool
        Whether the focal length is fitted along (both axes by one factor); the covariance has its part then.

    Notes
    -----
    The covariance is the estimator's, times χ²/ν, ν = 2M − 3, or − 4; where the errors are known only when that is more
    than chance makes it, 4 √(2/ν) above one.
    """
    known = variance_px2 is not None
    floor = guide.catalog.position_sigma_rad / camera.pixel_rad
    sigma = np.ones(len(xy)) if variance_px2 is None else np.sqrt(variance_px2 + floor**2)
    used, same = pairs, False
    directions = camera.unproject(xy)
    for _ in range(12):
        stars, reference = used[:, 0], guide.directions[used[:, 1]]
        vectors = camera.unproject(xy[stars]) if free_focal else directions[stars]
        matrix = fit_rotation(vectors, reference, 1.0 / sigma[stars] ** 2)
        if free_focal:
            camera, matrix = _refocused(camera, matrix, xy[stars], reference, sigma[stars])
        predicted = camera.project(reference @ matrix.T)
        scale = _robust_scale(xy[stars] - predicted, sigma[stars], known)
        if same:
            break
        index, _, places = guide.in_field(matrix, 3.0, camera)
        near, _ = nearest_unique(xy, places, REJECT_SIGMAS * scale * sigma)
        seen = np.flatnonzero(near >= 0)
        fitting = np.stack([seen, index[near[seen]]], axis=1)
        if len(fitting) < min(len(pairs), _FEWEST_TO_REJECT):  # too few to tell who is wrong: keep what was identified
            break
        same = np.array_equal(fitting, used)
        used = fitting
    stars, reference = used[:, 0], guide.directions[used[:, 1]]
    vectors = camera.unproject(xy[stars])
    estimate = estimator(vectors, reference, sigma[stars] * camera.pixel_rad)
    matrix, covariance = estimate.matrix, estimate.covariance
    if free_focal:
        normal, _ = _normal(camera, matrix, vectors, reference, sigma[stars])
        covariance = np.asarray(np.linalg.inv(normal)[:3, :3], dtype=np.float64)
    residual = xy[stars] - camera.project(reference @ matrix.T)
    freedom = max(2 * len(stars) - (4 if free_focal else 3), 1)
    chi2 = float(np.sum(residual**2 / sigma[stars, None] ** 2))
    factor = max(chi2 / freedom, _UNKNOWN_FLOOR_PX**2)
    if known and factor < 1.0 + _MISFIT_SIGMAS * math.sqrt(2.0 / freedom):
        factor = 1.0
    return Refined(matrix, covariance * factor, used, residual, camera)


def _refocused(
    camera: Camera, matrix: FloatArray, xy: FloatArray, reference: FloatArray, sigma: FloatArray
) -> tuple[Camera, FloatArray]:
    """Camera and attitude with the focal length that fits best: two steps of Gauss–Newton suffice within 3 %."""
    for _ in range(2):
        normal, right = _normal(camera, matrix, camera.unproject(xy), reference, sigma)
        change = np.linalg.solve(normal, right)
        matrix = turned(matrix, *change[:3])
        factor = math.exp(change[3])
        camera = replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
    return camera, matrix


def _normal(
    camera: Camera, matrix: FloatArray, vectors: FloatArray, reference: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of rotation vector and ln of the focal length."""
    every = np.arange(len(vectors))
    slopes, predicted = focal_slopes(vectors), reference @ matrix.T
    normal, right = fit_step(vectors, slopes, predicted, every, sigma * camera.pixel_rad, 4)
    return normal, right


@njit(cache=True, error_model="numpy")
def _robust_scale(residual: FloatArray, sigma: FloatArray, known: bool) -> float:
    """Standard error in units of the stated one: median of the residuals' lengths, corrected for the three fitted."""
    length = np.hypot(residual[:, 0], residual[:, 1]) / sigma
    freedom = max(1.0 - 3.0 / (2.0 * len(length)), 0.2)
    scale = np.median(length) / _RAYLEIGH_MEDIAN / math.sqrt(freedom)
    if not known:
        return max(scale, _UNKNOWN_FLOOR_PX)
    # where many stars agree better than they claim to, as without noise, a blend among them shows
    return max(scale, _LEAST_SCALE if len(length) >= _MANY else 1.0)
