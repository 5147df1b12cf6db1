"""Kernel that verifies an attitude against every observed star: match, refit, and compute its Bayes factor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.catalog.sky_view import SkyView, in_shape, stars_in_cone
from startracker.core import FloatArray, IntArray
from startracker.estimation.association import nearest_unique
from startracker.estimation.directions import normal_equations
from startracker.geometry.linalg import rotate_back, rotated, solve, transform
from startracker.identification.bayes_factor import WEIGHINGS, Matched, log_bayes_factor, log_magnitude_ratios
from startracker.identification.clustering_null import clustering_price
from startracker.identification.search_state import Stars
from startracker.sorting import sort

GATE_SIGMAS = 4.5
FOCAL_SIGMA = 0.01
"""A priori standard deviation of ln f if the focal length is fitted: 2 % is twice this."""
MOST_EXTRA = 10
OVERHEAD = 10_000
"""Operations of a verification in addition to those that grow with the numbers of stars."""
FEWEST_FOR_FOCAL = 5
"""Least number of matched stars for fitting the focal length: with it, three or four stars of a field fit wrong guide
stars too easily."""
_NARROWING = 3.0
_NARROWEST = 0.8
_ROUNDS = 5
_DIVERGED_RAD = 0.2


@kernel_part
def rotation_cosine(one: FloatArray, other: FloatArray) -> float:
    """Cosine of the angle of the rotation between two attitudes (3, 3)."""
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += one[i, j] * other[i, j]
    return 0.5 * (trace - 1.0)


@kernel
def is_known(matrix: FloatArray, known: FloatArray, least_cosine: float) -> bool:
    """Whether an attitude is within a rotation of cosine `least_cosine` of one that is known (K, 3, 3)."""
    closest = -1.0
    for m in range(len(known)):
        closest = max(closest, rotation_cosine(matrix, known[m]))
    return closest > least_cosine


class Verified(NamedTuple):
    """Result of verifying an attitude against all stars.

    Parameters
    ----------
    log_b : float
        ln B; −inf if too few stars agree.
    matrix : (3, 3)
        ICRS to camera.
    focal, scale : float
        ln of the focal-length factor, and the multiple of the stated errors that fits best.
    in_field : int
        Number of guide stars in the field.
    pairs : (M, 2)
        Observed stars with a guide star, and its index.
    operations : int
        Number of comparisons of stars with guide stars, plus number of terms of the Bayes factor.
    """

    log_b: float
    matrix: FloatArray
    focal: float
    scale: float
    in_field: int
    pairs: IntArray
    operations: int


class _Field(NamedTuple):
    """Guide stars of a field, brightest first: index, direction (K, 3), magnitude, direction in the camera (K, 3)."""

    guide: IntArray
    reference: FloatArray
    v_mag: FloatArray
    predicted: FloatArray


class _Fit(NamedTuple):
    """Result of matching and refitting.

    Attitude and ln of the focal-length factor, the observed directions (N, 3) with it, the index in the field of each
    one's guide star or −1, the number that have one (0 if the fit diverged), and the number of rounds.
    """

    matrix: FloatArray
    focal: float
    observed: FloatArray
    guide: IntArray
    matched: int
    rounds: int


@kernel_part
def _same(one: IntArray, other: IntArray) -> bool:
    """Whether two arrays are equal."""
    differ = abs(len(one) - len(other))
    for k in range(min(len(one), len(other))):
        differ += one[k] != other[k]
    return differ == 0


@kernel
def _field_at(matrix: FloatArray, sky: SkyView, most: int) -> _Field:
    """Guide stars on the image at an attitude, the brightest `most` of them."""
    x, y, z = rotate_back(matrix, sky.shape.axes[2])
    near = stars_in_cone(x, y, z, sky.shape.widest_cosine, sky.directions, sky.grid)
    count = 0
    for star in near:
        g = sky.directions[star]
        u = matrix[0, 0] * g[0] + matrix[0, 1] * g[1] + matrix[0, 2] * g[2]
        v = matrix[1, 0] * g[0] + matrix[1, 1] * g[1] + matrix[1, 2] * g[2]
        w = matrix[2, 0] * g[0] + matrix[2, 1] * g[1] + matrix[2, 2] * g[2]
        if in_shape(u, v, w, sky.shape):
            near[count] = star
            count += 1
    # Guide stars are numbered by brightness, so that sorting the indices puts the brightest first.
    sort(near[:count])
    count = min(count, most)
    reference, v_mag = np.empty((count, 3)), np.empty(count)
    for k in range(count):
        for axis in range(3):
            reference[k, axis] = sky.directions[near[k], axis]
        v_mag[k] = sky.v_mag[near[k]]
    return _Field(near[:count], reference, v_mag, np.empty((count, 3)))


@kernel_part
def _focused(stars: Stars, focal: float) -> FloatArray:
    """Observed directions (N, 3) for a corrected focal length."""
    observed = np.empty_like(stars.vectors)
    for i in range(len(observed)):
        for axis in range(3):
            observed[i, axis] = stars.vectors[i, axis] + focal * stars.slopes[i, axis]
    return observed


@kernel
def _settle(
    matrix: FloatArray, focal: float, stars: Stars, field: _Field, step: float, widen: float, unknowns: int
) -> _Fit:
    """Match and refit at `step` times the stated errors until the match no longer changes.

    The gate of the first round is `widen` times as wide.
    """
    sigma, observed, count = stars.sigma, _focused(stars, focal), 0
    gate, index = np.empty(len(sigma)), np.empty(0, np.int64)
    for round_ in range(_ROUNDS):
        transform(matrix, field.reference, field.predicted)
        for i in range(len(sigma)):
            gate[i] = GATE_SIGMAS * step * sigma[i] * (widen if round_ == 0 else 1.0)
        last = index
        index, _ = nearest_unique(observed, field.predicted, gate)
        count = 0
        for i in range(len(index)):
            count += index[i] >= 0
        if count < 3 or _same(index, last):
            return _Fit(matrix, focal, observed, index, count, round_ + 1)
        normal, right = normal_equations(observed, stars.slopes, field.predicted, index, sigma, unknowns)
        for i in range(unknowns):
            right[i] /= step * step
            for j in range(unknowns):
                normal[i, j] /= step * step
        if unknowns == 4:
            normal[3, 3] += 1.0 / FOCAL_SIGMA**2
            right[3] -= focal / FOCAL_SIGMA**2
        change = solve(normal, right)
        if not math.isfinite(change[0]) or abs(change[0]) + abs(change[1]) + abs(change[2]) > _DIVERGED_RAD:
            return _Fit(matrix, focal, observed, index, 0, round_ + 1)
        matrix = rotated(matrix, change[0], change[1], change[2])
        if unknowns == 4:
            focal += change[3]
            observed = _focused(stars, focal)
    return _Fit(matrix, focal, observed, index, count, _ROUNDS)


@kernel
def _weigh(fit: _Fit, stars: Stars, field: _Field, area: float, unknowns: int) -> tuple[float, float]:
    """ln B of a match from the residuals of the last fit, and the multiple of the stated errors that fits best."""
    observed, index, distance = fit.observed, fit.guide, np.empty(len(fit.guide))
    transform(fit.matrix, field.reference, field.predicted)
    for i in range(len(index)):
        distance[i] = np.inf
        if index[i] >= 0:
            square = 0.0
            for axis in range(3):
                square += (observed[i, axis] - field.predicted[index[i], axis]) ** 2
            distance[i] = math.sqrt(square)
    information, _ = normal_equations(observed, stars.slopes, field.predicted, index, stars.sigma, unknowns)
    ratios = log_magnitude_ratios(stars.magnitude, index, field.v_mag)
    matched = Matched(distance, index, stars.sigma, ratios)
    value, fitting = log_bayes_factor(matched, information, len(field.guide), area, FOCAL_SIGMA, stars.counts)
    return value - clustering_price(stars.excess, index), fitting


@kernel
def verify_attitude(
    matrix: FloatArray, focal: float, stars: Stars, sky: SkyView, scale: float, free_focal: bool
) -> Verified:
    """Match and refit until the match no longer changes, and compute ln B; first with a wide gate, then with narrower
    ones.

    Parameters
    ----------
    matrix, focal : (3, 3), float
        Initial attitude, ICRS to camera, and ln of the focal-length factor.
    stars : Stars
        Observed stars; their magnitudes are NaN if they are not to be used.
    sky : SkyView
    scale : float
        The first gate is 4.5 × `scale` × the stated errors.
    free_focal : bool
        Whether to fit ln f too, with a prior of 0 ± `FOCAL_SIGMA`; only if at least `FEWEST_FOR_FOCAL` stars match.
    """
    n, operations, unknowns = len(stars.vectors), OVERHEAD, 4 if free_focal else 3
    fewest = FEWEST_FOR_FOCAL if free_focal else 3
    field = _field_at(matrix, sky, 2 * n + MOST_EXTRA)
    guides, weighed, pairs, count = len(field.guide), np.empty(0, np.int64), np.empty((n, 2), np.int64), 0
    best, log_b, fitting = matrix, -math.inf, scale
    best_focal = 0.0
    # Attitudes from a few stars may have larger errors far away from these, hence the wider first gate.
    step, widen = scale, 2.0
    while guides >= 3:
        fit = _settle(matrix, focal, stars, field, step, widen, unknowns)
        matrix, focal = fit.matrix, fit.focal
        operations += fit.rounds * n * guides
        if fit.matched < fewest:
            break
        # If a narrower gate removes no star, ln B does not change either.
        if free_focal or not _same(fit.guide, weighed):
            weighed = fit.guide
            value, multiple = _weigh(fit, stars, field, sky.area, unknowns)
            operations += WEIGHINGS * fit.matched * guides
            if value > log_b:
                count = 0
                for i in range(n):
                    if fit.guide[i] >= 0:
                        pairs[count, 0], pairs[count, 1] = i, field.guide[fit.guide[i]]
                        count += 1
                best, best_focal, log_b, fitting = matrix, focal, value, multiple
        if step <= _NARROWEST:
            break
        step, widen = max(step / _NARROWING, _NARROWEST), 1.0
    return Verified(log_b, best, best_focal, fitting, guides, pairs[:count], operations)
