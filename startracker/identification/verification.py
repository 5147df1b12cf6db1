"""Kernel that checks an attitude against every observed star: match, refit by `estimation.directions`, weigh."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.field_shape import in_shape
from startracker.catalog.sky_view import SkyView
from startracker.catalog.voxels import stars_in_cone
from startracker.estimation.directions import normal_equations
from startracker.identification.bayes_factor import WEIGHINGS, Matched, log_bayes_factor, log_magnitude_ratios
from startracker.identification.clustering_null import clustering_price
from startracker.identification.search_state import Stars
from startracker.kernels import kernel
from startracker.linalg import solve, turned
from startracker.sorting import sort

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

GATE_SIGMAS = 4.5
FOCAL_SIGMA = 0.01
"""Standard deviation of ln f beforehand, where the focal length is fitted: 2 % is two of these."""
MOST_EXTRA = 10
OVERHEAD = 10_000
"""Operations of a verification besides those that grow with the numbers of stars."""
_NARROWING = 3.0
_NARROWEST = 0.8
_ROUNDS = 5
_RAN_AWAY_RAD = 0.2


@kernel
def guides_in_field(matrix: FloatArray, sky: SkyView, most: int) -> IntArray:
    """Guide stars on the image at an attitude, brightest first, at most `most`."""
    axis = sky.shape.axes[2]
    x = matrix[0, 0] * axis[0] + matrix[1, 0] * axis[1] + matrix[2, 0] * axis[2]
    y = matrix[0, 1] * axis[0] + matrix[1, 1] * axis[1] + matrix[2, 1] * axis[2]
    z = matrix[0, 2] * axis[0] + matrix[1, 2] * axis[1] + matrix[2, 2] * axis[2]
    near = stars_in_cone(x, y, z, sky.shape.widest_cosine, sky.directions, sky.grid)
    out = np.empty(len(near), np.int64)
    count = 0
    for star in near:
        g = sky.directions[star]
        u = matrix[0, 0] * g[0] + matrix[0, 1] * g[1] + matrix[0, 2] * g[2]
        v = matrix[1, 0] * g[0] + matrix[1, 1] * g[1] + matrix[1, 2] * g[2]
        w = matrix[2, 0] * g[0] + matrix[2, 1] * g[1] + matrix[2, 2] * g[2]
        if in_shape(u, v, w, sky.shape):
            out[count] = star
            count += 1
    sort(out[:count])
    return out[: min(count, most)]


@kernel
def match_nearest(
    points: FloatArray, places: FloatArray, gate: FloatArray, index: IntArray, distance: FloatArray, owner: IntArray
) -> int:
    """Nearest place (K, D) of each point (N, D) within its gate (N,), each place used once; how many have one.

    Where two points claim one place the one nearer in units of its gate keeps it. `index` (N,) gets the place or −1,
    `distance` (N,) the distance or inf; `owner` (K,) is scratch.
    """
    owner[: len(places)] = -1
    count = 0
    across = np.empty((2, len(places)))  # column by column, for several places at a time
    for j in range(len(places)):
        across[0, j], across[1, j] = places[j, 0], places[j, 1]
    for i in range(len(points)):
        index[i], distance[i] = -1, np.inf
        best, at = gate[i] ** 2, -1
        x, y = points[i, 0], points[i, 1]
        near = 0
        for j in range(len(places)):
            near += (across[0, j] - x) ** 2 + (across[1, j] - y) ** 2 <= best
        if near == 0:
            continue
        for j in range(len(places)):
            d = places[j, 0] - x
            d2 = d * d
            if d2 > best:
                continue
            d = places[j, 1] - y
            d2 += d * d
            for axis in range(2, points.shape[1]):
                d = places[j, axis] - points[i, axis]
                d2 += d * d
            if d2 <= best:
                best, at = d2, j
        if at < 0:
            continue
        away, rival = math.sqrt(best), owner[at]
        if rival >= 0:
            if distance[rival] / gate[rival] <= away / gate[i]:
                continue
            index[rival], distance[rival] = -1, np.inf
            count -= 1
        owner[at], index[i], distance[i] = i, at, away
        count += 1
    return count


class Verified(NamedTuple):
    """An attitude as all stars see it.

    Parameters
    ----------
    log_b : float
        ln B; −inf: fewer than three stars agree.
    matrix : (3, 3)
        ICRS to camera.
    focal, scale : float
        ln of the focal length's factor, multiple of the stated errors that fits best.
    in_field : int
        Guide stars in the field.
    guide_of : (N,)
        Guide star of each observed star or −1.
    operations : int
        Stars compared with guide stars, and terms of the Bayes factor.
    """

    log_b: float
    matrix: FloatArray
    focal: float
    scale: float
    in_field: int
    guide_of: IntArray
    operations: int


class _Field(NamedTuple):
    """Guide stars of a field: number, direction (K, 3), magnitude, direction in the camera (K, 3)."""

    guide: IntArray
    reference: FloatArray
    v_mag: FloatArray
    predicted: FloatArray


class _Match(NamedTuple):
    """The observed directions (N, 3) at the focal length of the moment, the position in the field of each one's guide
    star or −1, the distance to it, the gate, and the index before; with (K,) scratch."""

    observed: FloatArray
    guide: IntArray
    distance: FloatArray
    gate: FloatArray
    last: IntArray
    owner: IntArray


@kernel
def _same(one: IntArray, other: IntArray) -> bool:
    """Whether two arrays of a length are equal."""
    differ = 0
    for k in range(len(one)):
        differ += one[k] != other[k]
    return differ == 0


@kernel
def _field_at(matrix: FloatArray, sky: SkyView, most: int) -> _Field:
    guide = guides_in_field(matrix, sky, most)
    reference, v_mag = np.empty((len(guide), 3)), np.empty(len(guide))
    for k in range(len(guide)):
        for axis in range(3):
            reference[k, axis] = sky.directions[guide[k], axis]
        v_mag[k] = sky.v_mag[guide[k]]
    return _Field(guide, reference, v_mag, np.empty((len(guide), 3)))


@kernel
def _predict(matrix: FloatArray, field: _Field) -> None:
    for k in range(len(field.guide)):
        x, y, z = field.reference[k, 0], field.reference[k, 1], field.reference[k, 2]
        for axis in range(3):
            field.predicted[k, axis] = matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z


@kernel
def _refocus(stars: Stars, focal: float, observed: FloatArray) -> None:
    for i in range(len(observed)):
        for axis in range(3):
            observed[i, axis] = stars.vectors[i, axis] + focal * stars.slopes[i, axis]


@kernel
def _settle(
    matrix: FloatArray,
    focal: float,
    stars: Stars,
    field: _Field,
    match: _Match,
    step: float,
    widen: float,
    unknowns: int,
) -> tuple[int, FloatArray, float, int]:
    """Match and refit at `step` times the stated errors until the match stands still, its first gate `widen` times as
    wide. Stars that agree (0: the fit ran away), attitude, ln of the focal length's factor, rounds."""
    index, last, observed, sigma, count = match.guide, match.last, match.observed, stars.sigma, 0
    for i in range(len(last)):
        last[i] = -2
    for round_ in range(_ROUNDS):
        _predict(matrix, field)
        for i in range(len(sigma)):
            match.gate[i] = GATE_SIGMAS * step * sigma[i] * (widen if round_ == 0 else 1.0)
        count = match_nearest(observed, field.predicted, match.gate, index, match.distance, match.owner)
        if count < 3 or _same(index, last):
            return count, matrix, focal, round_ + 1
        for i in range(len(last)):
            last[i] = index[i]
        normal, right = normal_equations(observed, stars.slopes, field.predicted, index, sigma, unknowns)
        for i in range(unknowns):
            right[i] /= step * step
            for j in range(unknowns):
                normal[i, j] /= step * step
        if unknowns == 4:
            normal[3, 3] += 1.0 / FOCAL_SIGMA**2
            right[3] -= focal / FOCAL_SIGMA**2
        change = solve(normal, right)
        if not math.isfinite(change[0]) or abs(change[0]) + abs(change[1]) + abs(change[2]) > _RAN_AWAY_RAD:
            return 0, matrix, focal, round_ + 1
        matrix = turned(matrix, change[0], change[1], change[2])
        if unknowns == 4:
            focal += change[3]
            _refocus(stars, focal, observed)
    return count, matrix, focal, _ROUNDS


@kernel
def _weigh(
    matrix: FloatArray, stars: Stars, field: _Field, match: _Match, area: float, unknowns: int
) -> tuple[float, float]:
    """ln B of a match by the last fit's own residuals, and the multiple of the stated errors that explains it best."""
    observed, index, distance = match.observed, match.guide, match.distance
    _predict(matrix, field)
    for i in range(len(index)):
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
    """Match, refit until it stands still, weigh; at `scale` times the stated errors, then at narrower gates.

    Parameters
    ----------
    matrix, focal : (3, 3), float
        ICRS to camera and ln of the focal length's factor, to start from.
    stars : Stars
        Observed; magnitudes NaN where they are not to count.
    sky : SkyView
    scale : float
        Of the first gate, which is 4.5 times this times the stated errors.
    free_focal : bool
        Whether ln f is fitted too, 0 ± `FOCAL_SIGMA` beforehand.
    """
    n, operations, unknowns = len(stars.vectors), OVERHEAD, 4 if free_focal else 3
    field = _field_at(matrix, sky, 2 * n + MOST_EXTRA)
    guides, weighed, guide_of = len(field.guide), np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        weighed[i], guide_of[i] = -2, -1
    best = Verified(-math.inf, matrix, 0.0, scale, guides, guide_of, 0)
    if guides < 3:
        return Verified(best.log_b, matrix, 0.0, scale, guides, guide_of, operations)
    match = _Match(
        np.empty((n, 3)),
        np.empty(n, np.int64),
        np.empty(n),
        np.empty(n),
        np.empty(n, np.int64),
        np.empty(guides, np.int64),
    )
    _refocus(stars, focal, match.observed)
    step, widen = scale, 2.0  # a first match from few stars' attitude may be off by more far away from them
    while True:
        count, matrix, focal, rounds = _settle(matrix, focal, stars, field, match, step, widen, unknowns)
        operations += rounds * n * guides
        if count < 3:
            break
        # a narrower gate that drops none changes nothing
        if free_focal or not _same(match.guide, weighed):
            for i in range(n):
                weighed[i] = match.guide[i]
            value, fitting = _weigh(matrix, stars, field, match, sky.area, unknowns)
            operations += WEIGHINGS * count * guides
            if value > best.log_b:
                for i in range(n):
                    guide_of[i] = field.guide[match.guide[i]] if match.guide[i] >= 0 else -1
                best = Verified(value, matrix, focal, fitting, guides, guide_of, 0)
        if step <= _NARROWEST:
            break
        step, widen = max(step / _NARROWING, _NARROWEST), 1.0
    return Verified(best.log_b, best.matrix, best.focal, best.scale, guides, guide_of, operations)
