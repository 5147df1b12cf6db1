"""From identified stars to the attitude: match all stars of the field, drop what does not fit, weigh the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.camera import Camera
from startracker.catalog.guide import GuideDatabase
from startracker.estimation import Estimator
from startracker.identification.hypothesis import fit_rotation, nearest_unique

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

REJECT_SIGMAS = 3.7
"""A residual's length beyond this many of its standard errors an axis has probability 1e-3 (Rayleigh)."""
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
_UNKNOWN_FLOOR_PX = 0.003
_FEWEST_TO_REJECT = 4
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
    """

    matrix: FloatArray
    covariance: FloatArray
    pairs: IntArray
    residual_px: FloatArray


def refine(
    pairs: IntArray,
    xy: FloatArray,
    variance_px2: FloatArray | None,
    camera: Camera,
    guide: GuideDatabase,
    estimator: Estimator,
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

    Notes
    -----
    The covariance is the estimator's, times χ²/ν (at least one where the errors are known), ν = 2M − 3.
    """
    known = variance_px2 is not None
    floor = guide.catalog.position_sigma_rad / camera.pixel_rad
    sigma = np.ones(len(xy)) if variance_px2 is None else np.sqrt(variance_px2 + floor**2)
    vectors = camera.unproject(xy)
    matrix = fit_rotation(vectors[pairs[:, 0]], guide.directions[pairs[:, 1]], 1.0 / sigma[pairs[:, 0]] ** 2)
    predicted = camera.project(guide.directions[pairs[:, 1]] @ matrix.T)
    scale = _robust_scale(xy[pairs[:, 0]] - predicted, sigma[pairs[:, 0]], known)
    used = pairs
    for _ in range(12):
        index, _, places = guide.in_field(matrix, margin_px=3.0)
        gate = REJECT_SIGMAS * scale * sigma
        near, _ = nearest_unique(xy, places, gate)
        seen = np.flatnonzero(near >= 0)
        fitting = np.stack([seen, index[near[seen]]], axis=1)
        if len(fitting) < min(len(pairs), _FEWEST_TO_REJECT):  # too few to tell who is wrong: keep what was identified
            break
        same = np.array_equal(fitting, used)
        used = fitting
        matrix = fit_rotation(vectors[used[:, 0]], guide.directions[used[:, 1]], 1.0 / sigma[used[:, 0]] ** 2)
        predicted = camera.project(guide.directions[used[:, 1]] @ matrix.T)
        scale = _robust_scale(xy[used[:, 0]] - predicted, sigma[used[:, 0]], known)
        if same:
            break
    stars, reference = used[:, 0], guide.directions[used[:, 1]]
    estimate = estimator(vectors[stars], reference, sigma[stars] * camera.pixel_rad)
    residual = xy[stars] - camera.project(reference @ estimate.matrix.T)
    freedom = max(2 * len(stars) - 3, 1)
    chi2 = float(np.sum(residual**2 / sigma[stars, None] ** 2))
    factor = max(chi2 / freedom, 1.0 if known else _UNKNOWN_FLOOR_PX**2)
    return Refined(np.asarray(estimate.matrix), np.asarray(estimate.covariance) * factor, used, residual)


def _robust_scale(residual: FloatArray, sigma: FloatArray, known: bool) -> float:
    """Standard error in units of the stated one: median of the residuals' lengths, corrected for the three fitted."""
    length = np.hypot(residual[:, 0], residual[:, 1]) / sigma
    freedom = max(1.0 - 3.0 / (2.0 * len(length)), 0.2)
    scale = float(np.median(length)) / _RAYLEIGH_MEDIAN / math.sqrt(freedom)
    if not known:
        return max(scale, _UNKNOWN_FLOOR_PX)
    # where many stars agree better than they claim to, as without noise, a blend among them shows
    return max(scale, _LEAST_SCALE if len(length) >= _MANY else 1.0)
