"""From identified stars to the attitude: match all stars of the field, drop what does not fit, weigh the rest."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.camera import Camera
from startracker.catalog.guide import GuideDatabase, field_cosine
from startracker.catalog.voxels import VoxelGrid, stars_on_image
from startracker.estimation import Estimator
from startracker.estimation.wahba import fit_rotation
from startracker.identification.hypothesis import nearest_unique
from startracker.identification.verification import fit_step, focal_slopes, turned
from startracker.image_map import ImageMap, to_pixels

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

REJECT_SIGMAS = 3.7
"""A residual's length beyond this many of its standard errors an axis has probability 1e-3 (Rayleigh)."""
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
_UNKNOWN_FLOOR_PX = 0.003
_FEWEST_TO_REJECT = 4
_MISFIT_SIGMAS = 4.0
_MANY, _LEAST_SCALE = 10, 0.4
_MARGIN_PX = 3.0


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
    directions: FloatArray | None = None,
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
    directions : (N, 3), optional
        Of the centroids through the camera, where they are known.

    Notes
    -----
    The covariance is the estimator's, times χ²/ν, ν = 2M − 3, or − 4; where the errors are known only when that is more
    than chance makes it, 4 √(2/ν) above one.
    """
    known = variance_px2 is not None
    floor = guide.catalog.position_sigma_rad / camera.pixel_rad
    sigma = np.ones(len(xy)) if variance_px2 is None else np.sqrt(variance_px2 + floor**2)
    used, same = np.ascontiguousarray(pairs, dtype=np.int64), False
    sky, grid = guide.directions, guide.grid
    directions = camera.unproject(xy) if directions is None else directions
    for _ in range(12):
        matrix, reference = _first_fit(used, directions, sky, sigma)
        if free_focal:
            stars = used[:, 0]
            camera, matrix = _refocused(camera, matrix, xy[stars], reference, sigma[stars])
            directions = camera.unproject(xy)
        if same:
            break
        cosine = field_cosine(camera, _MARGIN_PX)
        fitting, same = _matched_again(used, matrix, reference, xy, sigma, known, sky, grid, cosine, camera.image_map)
        if len(fitting) < min(len(pairs), _FEWEST_TO_REJECT):  # too few to tell who is wrong: keep what was identified
            break
        used = fitting
        if same and not free_focal:  # nor would the next fit be another
            break
    vectors, reference, sigma = _chosen(used, directions, sky, sigma)
    estimate = estimator(vectors, reference, sigma * camera.pixel_rad)
    matrix, covariance = estimate.matrix, estimate.covariance
    if free_focal:
        normal, _ = _normal(camera, matrix, vectors, reference, sigma)
        covariance = np.asarray(np.linalg.inv(normal)[:3, :3], dtype=np.float64)
    residual, chi2 = _residuals(used, matrix, reference, xy, sigma, camera.image_map)
    freedom = max(2 * len(used) - (4 if free_focal else 3), 1)
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
def _first_fit(
    used: IntArray, directions: FloatArray, guides: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Attitude (3, 3) of pairs (M, 2) of centroids and guide stars, and the directions (M, 3) of these."""
    seen, reference, weight = np.empty((len(used), 3)), np.empty((len(used), 3)), np.empty(len(used))
    for k in range(len(used)):
        seen[k], reference[k] = directions[used[k, 0]], guides[used[k, 1]]
        weight[k] = 1.0 / sigma[used[k, 0]] ** 2
    return fit_rotation(seen, reference, weight), reference


@njit(cache=True, error_model="numpy")
def _predicted(matrix: FloatArray, reference: FloatArray, image: ImageMap) -> FloatArray:
    """Pixels (M, 2) of guide stars (M, 3) at an attitude (3, 3)."""
    vectors = np.empty_like(reference)
    for k in range(len(reference)):
        x, y, z = reference[k]
        for axis in range(3):
            vectors[k, axis] = matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z
    pixels: FloatArray = to_pixels(vectors, image)
    return pixels


@njit(cache=True, error_model="numpy")
def _matched_again(
    used: IntArray,
    matrix: FloatArray,
    reference: FloatArray,
    xy: FloatArray,
    sigma: FloatArray,
    known: bool,
    sky: FloatArray,
    grid: VoxelGrid,
    cosine: float,
    image: ImageMap,
) -> tuple[IntArray, bool]:
    """Pairs (M, 2) of centroids and the nearest guide stars at an attitude, and whether they are those in use."""
    scale = _robust_scale(used, xy, _predicted(matrix, reference, image), sigma, known)
    index, _, places = stars_on_image(matrix, cosine, _MARGIN_PX, sky, grid, image)
    near, _ = nearest_unique(xy, places, REJECT_SIGMAS * scale * sigma)
    seen = np.flatnonzero(near >= 0)
    pairs = np.empty((len(seen), 2), np.int64)
    same = len(seen) == len(used)
    for k in range(len(seen)):
        pairs[k, 0], pairs[k, 1] = seen[k], index[near[seen[k]]]
        same = same and pairs[k, 0] == used[k, 0] and pairs[k, 1] == used[k, 1]
    return pairs, same


@njit(cache=True, error_model="numpy")
def _chosen(
    used: IntArray, directions: FloatArray, sky: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions (M, 3), guide stars (M, 3) and standard errors (M,) of pairs."""
    return directions[used[:, 0]], sky[used[:, 1]], sigma[used[:, 0]]


@njit(cache=True, error_model="numpy")
def _residuals(
    used: IntArray, matrix: FloatArray, reference: FloatArray, xy: FloatArray, sigma: FloatArray, image: ImageMap
) -> tuple[FloatArray, float]:
    """Measured minus predicted (M, 2) of pairs, and χ²."""
    residual, chi2 = _predicted(matrix, reference, image), 0.0
    for k in range(len(used)):
        for axis in range(2):
            residual[k, axis] = xy[used[k, 0], axis] - residual[k, axis]
            chi2 += (residual[k, axis] / sigma[k]) ** 2
    return residual, chi2


@njit(cache=True, error_model="numpy")
def _robust_scale(used: IntArray, xy: FloatArray, predicted: FloatArray, sigma: FloatArray, known: bool) -> float:
    """Standard error in units of the stated one: median of the residuals' lengths, corrected for the three fitted."""
    length = np.empty(len(used))
    for k in range(len(used)):
        star = used[k, 0]
        length[k] = math.hypot(xy[star, 0] - predicted[k, 0], xy[star, 1] - predicted[k, 1]) / sigma[star]
    freedom = max(1.0 - 3.0 / (2.0 * len(length)), 0.2)
    scale = np.median(length) / _RAYLEIGH_MEDIAN / math.sqrt(freedom)
    if not known:
        return max(scale, _UNKNOWN_FLOOR_PX)
    # where many stars agree better than they claim to, as without noise, a blend among them shows
    return max(scale, _LEAST_SCALE if len(length) >= _MANY else 1.0)
