"""Predicted pixels of guide stars, and their association with centroids: gates, matches, duplicates."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.catalog.sky_view import VoxelGrid, stars_on_image
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.estimation.pose import UNKNOWN_FLOOR_PX
from startracker.geometry.image_map import CX, CY, HEIGHT, ImageMap, pixel_slopes, to_pixels
from startracker.geometry.linalg import cross, transform
from startracker.observer import ABERRATION_SCALE_SIGMA
from startracker.sorting import median

RATE_SIGMA_RAD_S = math.radians(2.0)
"""Assumed standard deviation of an unknown body rate about each axis."""
EPOCH_SIGMA_YR = 30.0
"""Assumed interval between the catalogue's epoch and a frame of unknown time, years."""


class Displaced(NamedTuple):
    """Displacements of the stars that are always fitted.

    Parameters
    ----------
    rolls : bool
        By the body rate, between the exposures of the rows of a rolling shutter.
    moves : bool
        By the stars' space motion since the catalogue's epoch, if the time is unknown.
    scales : bool
        By aberration, which changes the scale of the field, if the velocity is unknown.
    """

    rolls: bool
    moves: bool
    scales: bool


def _extra_sigma(displaced: Displaced) -> FloatArray:
    sigma = [RATE_SIGMA_RAD_S] * 3 if displaced.rolls else []
    sigma += [EPOCH_SIGMA_YR] if displaced.moves else []
    sigma += [ABERRATION_SCALE_SIGMA] if displaced.scales else []
    return np.array(sigma)


EXTRA_SIGMA = {
    displaced: _extra_sigma(displaced)
    for displaced in itertools.starmap(Displaced, itertools.product((False, True), repeat=3))
}
"""Prior standard deviations (E,) of the amplitudes of `predicted_pixels`, by the displacements that are fitted."""


@kernel
def predicted_pixels(
    guides: IntArray,
    matrix: FloatArray,
    directions: FloatArray,
    motion: FloatArray,
    image: ImageMap,
    row_time_s: float,
    displaced: Displaced,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pixels of guide stars at an attitude (3, 3), their derivatives, and displacements that are always fitted.

    Returns the pixels (M, 2); the same relative to the principal point (M, 2); their derivatives (M, 2, 3)
    (`pixel_slopes`); and the displacements (M, 2, E): by the rotation about each axis between the rows' exposures, s;
    by the space motion (3, G), per year; and by a change of scale.
    """
    vectors = np.empty((len(guides), 3))
    for n in range(len(guides)):
        guide = guides[n]
        x, y, z = directions[guide, 0], directions[guide, 1], directions[guide, 2]
        for k in range(3):
            vectors[n, k] = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z
    pixels, slopes = to_pixels(vectors, image), pixel_slopes(vectors, image)
    rows, moves, middle = 3 * displaced.rolls, displaced.moves, (image[HEIGHT] - 1.0) / 2.0
    extra, offset = np.zeros((len(guides), 2, rows + moves + displaced.scales)), np.empty_like(pixels)
    for n in range(len(guides)):
        offset[n, 0], offset[n, 1] = pixels[n, 0] - image[CX], pixels[n, 1] - image[CY]
        guide, row_s = guides[n], (pixels[n, 1] - middle) * row_time_s
        # A space motion across v is a rotation by θ = motion × v of the camera, because −θ × v = motion.
        x, y, z = cross(motion[:, guide], directions[guide])
        for k in range(3):
            turn = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z
            for axis in range(2):
                if rows > 0:
                    extra[n, axis, k] = slopes[n, axis, k] * row_s
                if moves:
                    extra[n, axis, rows] += slopes[n, axis, k] * turn
        for axis in range(2 if displaced.scales else 0):
            extra[n, axis, rows + moves] = offset[n, axis]
    return pixels, offset, slopes, extra


REJECT_SIGMAS = 3.7
"""Length of a residual, in standard errors on one axis, that is exceeded with probability 1e-3 (Rayleigh)."""
MARGIN_PX = 3.0
"""Distance outside the image, px, up to which a guide star may have a centroid on it."""
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
_MANY, _LEAST_SCALE = 10, 0.4


@kernel
def nearest_unique(points: FloatArray, candidates: FloatArray, gate: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nearest candidate (K, D) of each point (N, D) within its gate (N,); each candidate is assigned once.

    If two points claim one candidate, it is assigned to the nearer one in units of the gates.

    Returns
    -------
    index, distance : (N,)
        −1 and inf for points without a candidate.
    """
    index, distance = np.empty(len(points), np.int64), np.empty(len(points))
    owner, across = np.empty(len(candidates), np.int64), np.empty((2, len(candidates)))
    for j in range(len(candidates)):  # coordinate by coordinate, for several candidates at a time
        owner[j], across[0, j], across[1, j] = -1, candidates[j, 0], candidates[j, 1]
    for i in range(len(points)):
        index[i], distance[i] = -1, np.inf
        best, at = gate[i] ** 2, -1
        x, y = points[i, 0], points[i, 1]
        # A first pass without branches, which is vectorised, shows for most points that no candidate is near.
        near = 0
        for j in range(len(candidates)):
            near += (across[0, j] - x) ** 2 + (across[1, j] - y) ** 2 <= best
        if near == 0:
            continue
        for j in range(len(candidates)):
            d2 = (across[0, j] - x) ** 2
            if d2 > best:
                continue
            d2 += (across[1, j] - y) ** 2
            for axis in range(2, points.shape[1]):
                d2 += (candidates[j, axis] - points[i, axis]) ** 2
            if d2 <= best:
                best, at = d2, j
        if at < 0:
            continue
        away, rival = math.sqrt(best), owner[at]
        if rival >= 0:
            if distance[rival] / gate[rival] <= away / gate[i]:
                continue
            index[rival], distance[rival] = -1, np.inf
        owner[at], index[i], distance[i] = i, at, away
    return index, distance


class Field(NamedTuple):
    """The guide stars and the camera that sees them."""

    sky: FloatArray
    """Apparent directions (G, 3)."""
    grid: VoxelGrid
    cosine: float
    """Cosine of the angle from the boresight to the corner of the image."""
    image: ImageMap


@kernel
def matched_again(
    used: IntArray,
    matrix: FloatArray,
    reference: FloatArray,
    xy: FloatArray,
    sigma: FloatArray,
    known: bool,
    field: Field,
) -> tuple[IntArray, bool]:
    """Pairs (M, 2) of centroids and the nearest guide stars at an attitude, and whether these are the pairs in use."""
    vectors = np.empty_like(reference)
    transform(matrix, reference, vectors)
    scale = _robust_scale(used, xy, to_pixels(vectors, field.image), sigma, known)
    index, _, positions = stars_on_image(matrix, field.cosine, MARGIN_PX, field.sky, field.grid, field.image)
    gate = np.empty(len(xy))
    for star in range(len(xy)):
        gate[star] = REJECT_SIGMAS * scale * sigma[star]
    near, _ = nearest_unique(xy, positions, gate)
    pairs, count, same = np.empty((len(near), 2), np.int64), 0, True
    for star in range(len(near)):
        if near[star] >= 0:
            guide = index[near[star]]
            pairs[count, 0], pairs[count, 1] = star, guide
            same = same and count < len(used) and used[count, 0] == star and used[count, 1] == guide
            count += 1
    return pairs[:count], same and count == len(used)


@kernel_part
def _robust_scale(used: IntArray, xy: FloatArray, predicted: FloatArray, sigma: FloatArray, known: bool) -> float:
    """Standard error in units of the stated one: median length of the residuals, corrected for the three fitted
    parameters."""
    length = np.empty(len(used))
    for k in range(len(used)):
        star = used[k, 0]
        length[k] = math.hypot(xy[star, 0] - predicted[k, 0], xy[star, 1] - predicted[k, 1]) / sigma[star]
    freedom = max(1.0 - 3.0 / (2.0 * len(length)), 0.2)
    scale: float = median(length) / _RAYLEIGH_MEDIAN / math.sqrt(freedom)
    if not known:
        return max(scale, UNKNOWN_FLOOR_PX)
    # If many stars agree better than stated, as in images without noise, a blend among them is recognised.
    return max(scale, _LEAST_SCALE if len(length) >= _MANY else 1.0)


@kernel
def paired(
    xy: FloatArray,
    stated: FloatArray,
    index: IntArray,
    positions: FloatArray,
    factor: float,
    systematic_px2: float,
    near_px: float,
) -> tuple[IntArray, BoolArray, FloatArray]:
    """Pairs (K, 2) of centroids (N, 2) and guide stars, which of them fit, and the centroids with duplicates merged.

    The guide stars have indices `index` (G,) and positions (G, 2). A centroid fits if it is within 3.7 standard errors,
    which for a trailed star are far larger along the trail than across; the others are paired with the remaining guide
    stars within `near_px`. If several centroids fit one star, their mean is used: the one nearest to the expected
    position would confirm any expectation.
    """
    gate = np.empty(len(xy))
    # Larger eigenvalue of the covariance: a circular gate first, and then the ellipse itself.
    for n in range(len(xy)):
        a, b, c = stated[n, 0, 0], stated[n, 0, 1], stated[n, 1, 1]
        widest = 0.5 * (a + c) + math.sqrt(0.25 * (a - c) ** 2 + b * b)
        gate[n] = REJECT_SIGMAS * math.sqrt(factor * widest + systematic_px2)
    near, _ = nearest_unique(xy, positions, gate)
    for n in range(len(xy)):
        if near[n] >= 0 and not _is_within(xy[n], positions[near[n]], stated[n], factor, systematic_px2):
            near[n] = -1
    owner, merged, several = np.empty(len(positions), np.int64), np.empty_like(xy), np.empty(len(xy))
    for k in range(len(positions)):
        owner[k] = -1
    for n in range(len(xy)):
        merged[n, 0], merged[n, 1], several[n] = xy[n, 0], xy[n, 1], 1.0
        if near[n] >= 0:
            owner[near[n]] = n
    left = np.empty_like(positions)  # NaN is not within any gate
    for k in range(len(positions)):
        left[k, 0], left[k, 1] = positions[k, 0] if owner[k] < 0 else math.nan, positions[k, 1]
    for n in range(len(xy)):
        best, at = gate[n], -1
        for k in range(len(positions) if near[n] < 0 else 0):
            away = math.hypot(xy[n, 0] - positions[k, 0], xy[n, 1] - positions[k, 1])
            if away > best or owner[k] < 0:
                continue
            if _is_within(xy[n], positions[k], stated[n], factor, systematic_px2):
                best, at = away, owner[k]
        if at >= 0:
            several[at] += 1.0
            for axis in range(2):
                merged[at, axis] += (xy[n, axis] - merged[at, axis]) / several[at]
        gate[n] = near_px if near[n] < 0 else math.nan
    late, _ = nearest_unique(xy, left, gate)
    pairs, fits, count = np.empty((len(xy), 2), np.int64), np.empty(len(xy), np.bool_), 0
    for n in range(len(xy)):
        star = near[n] if near[n] >= 0 else late[n]
        if star >= 0:
            pairs[count, 0], pairs[count, 1], fits[count] = n, index[star], near[n] >= 0
            count += 1
    return pairs[:count], fits[:count], merged


@kernel_part
def _is_within(xy: FloatArray, position: FloatArray, stated: FloatArray, factor: float, systematic_px2: float) -> bool:
    """Whether a centroid (2,) is within 3.7 standard errors of a position (2,), according to its covariance (2, 2)."""
    a, c, b = factor * stated[0, 0] + systematic_px2, factor * stated[1, 1] + systematic_px2, factor * stated[0, 1]
    x, y = xy[0] - position[0], xy[1] - position[1]
    return bool(c * x * x - 2.0 * b * x * y + a * y * y <= REJECT_SIGMAS**2 * (a * c - b * b))


def merge_pairs(used: IntArray, named: IntArray) -> tuple[IntArray, BoolArray]:
    """Pairs that are used, together with those named pairs that share no star with them, sorted by centroid; and a mask
    of the used ones."""
    other = ~(np.isin(named[:, 0], used[:, 0]) | np.isin(named[:, 1], used[:, 1]))
    pairs = np.concatenate([used, named[other]])
    order = np.argsort(pairs[:, 0], kind="stable")
    return pairs[order], order < len(used)
