"""Which centroid is which guide star, at an attitude that is known: gates, names, duplicates."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.voxels import VoxelGrid, stars_on_image
from startracker.estimation.pose import UNKNOWN_FLOOR_PX
from startracker.identification.hypothesis import nearest_unique
from startracker.image_map import ImageMap, to_pixels
from startracker.kernels import kernel

__all__ = ["MARGIN_PX", "REJECT_SIGMAS", "joined", "matched_again", "named"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

REJECT_SIGMAS = 3.7
"""A residual's length beyond this many of its standard errors an axis has probability 1e-3 (Rayleigh)."""
MARGIN_PX = 3.0
"""Guide stars so far outside the image may have a centroid on it."""
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
_MANY, _LEAST_SCALE = 10, 0.4


@kernel
def _predicted(matrix: FloatArray, reference: FloatArray, image: ImageMap) -> FloatArray:
    """Pixels (M, 2) of guide stars (M, 3) at an attitude (3, 3)."""
    vectors = np.empty_like(reference)
    for k in range(len(reference)):
        x, y, z = reference[k]
        for axis in range(3):
            vectors[k, axis] = matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z
    pixels: FloatArray = to_pixels(vectors, image)
    return pixels


@kernel
def matched_again(
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
    index, _, places = stars_on_image(matrix, cosine, MARGIN_PX, sky, grid, image)
    near, _ = nearest_unique(xy, places, REJECT_SIGMAS * scale * sigma)
    seen = np.flatnonzero(near >= 0)
    pairs = np.empty((len(seen), 2), np.int64)
    same = len(seen) == len(used)
    for k in range(len(seen)):
        pairs[k, 0], pairs[k, 1] = seen[k], index[near[seen[k]]]
        same = same and pairs[k, 0] == used[k, 0] and pairs[k, 1] == used[k, 1]
    return pairs, same


@kernel
def _robust_scale(used: IntArray, xy: FloatArray, predicted: FloatArray, sigma: FloatArray, known: bool) -> float:
    """Standard error in units of the stated one: median of the residuals' lengths, corrected for the three fitted."""
    length = np.empty(len(used))
    for k in range(len(used)):
        star = used[k, 0]
        length[k] = math.hypot(xy[star, 0] - predicted[k, 0], xy[star, 1] - predicted[k, 1]) / sigma[star]
    freedom = max(1.0 - 3.0 / (2.0 * len(length)), 0.2)
    scale = np.median(length) / _RAYLEIGH_MEDIAN / math.sqrt(freedom)
    if not known:
        return max(scale, UNKNOWN_FLOOR_PX)
    # where many stars agree better than they claim to, as without noise, a blend among them shows
    return max(scale, _LEAST_SCALE if len(length) >= _MANY else 1.0)


@kernel
def named(
    xy: FloatArray,
    stated: FloatArray,
    index: IntArray,
    places: FloatArray,
    factor: float,
    systematic_px2: float,
    near_px: float,
) -> tuple[IntArray, BoolArray, FloatArray]:
    """Pairs (K, 2) of centroids (N, 2) and guide stars (G,) at their positions (G, 2), which fit, and the centroids
    (N, 2) with duplicates merged.

    A centroid that fits is within 3.7 standard errors; the others go to what guide stars are left within `near_px`.
    Where several fit one star, that star stands at their mean: the nearest to where it is expected would confirm any
    expectation.
    """
    gate = np.empty(len(xy))
    for n in range(len(xy)):
        a, b, c = stated[n, 0, 0], stated[n, 0, 1], stated[n, 1, 1]
        widest = 0.5 * (a + c) + math.sqrt(0.25 * (a - c) ** 2 + b * b)
        gate[n] = REJECT_SIGMAS * math.sqrt(factor * widest + systematic_px2)
    near, _ = nearest_unique(xy, places, gate)
    taken, owner = np.zeros(len(places), np.bool_), np.full(len(places), -1)
    for n in range(len(xy)):
        if near[n] >= 0:
            taken[near[n]], owner[near[n]] = True, n
    merged, several = xy.copy(), np.ones(len(xy))
    for n in range(len(xy)):
        best, at = gate[n], -1
        for k in range(len(places) if near[n] < 0 else 0):
            away = math.hypot(xy[n, 0] - places[k, 0], xy[n, 1] - places[k, 1])
            if away <= best and taken[k]:
                best, at = away, owner[k]
        if at >= 0:
            several[at] += 1.0
            merged[at] += (xy[n] - merged[at]) / several[at]
    rest, free = np.flatnonzero(near < 0), np.flatnonzero(~taken)
    other, _ = nearest_unique(xy[rest], places[free], np.full(len(rest), near_px))
    pairs, fits, count = np.empty((len(xy), 2), np.int64), np.zeros(len(xy), np.bool_), 0
    late = np.full(len(xy), -1)
    for k in range(len(rest)):
        if other[k] >= 0:
            late[rest[k]] = free[other[k]]
    for n in range(len(xy)):
        place = near[n] if near[n] >= 0 else late[n]
        if place >= 0:
            pairs[count, 0], pairs[count, 1], fits[count] = n, index[place], near[n] >= 0
            count += 1
    return pairs[:count], fits[:count], merged


def joined(used: IntArray, named: IntArray) -> tuple[IntArray, BoolArray]:
    """Pairs that are used and those named that share no star with them, by centroid; and which are used."""
    other = ~(np.isin(named[:, 0], used[:, 0]) | np.isin(named[:, 1], used[:, 1]))
    pairs = np.concatenate([used, named[other]])
    order = np.argsort(pairs[:, 0], kind="stable")
    return pairs[order], order < len(used)
