"""An attitude checked against every observed star and every guide star of the field, in integers.

Match, refit, weigh, as `startracker.identification.verification` does in floating point. Observed stars and predictions
are compared in one plane: the tangent plane at the boresight in units of 2⁻¹² pixel, whose y is scaled by the ratio of
the two focal lengths. The attitude is refitted as a rigid motion of that plane (shift and rotation by least squares,
the focal length as stated), which repeated converges to the sphere's.

The weight is log₂ of the Bayes factor of `startracker.identification.bayes_factor`, with 12 bits of fraction; every
table entry and every logarithm is rounded so that the factor comes out smaller than it is. The null hypothesis differs:
each point lies with the density that the points around it show, at least that of the image. For the k-th nearest of n
points at the distance d that is k/((n − 1) π d²), and the largest of k = 1 … n − 1 counts, so that a clump of points
explains itself. Matches must span the field besides (`Tables.spread`).

The C export (`c/verification.c`) does the same operations in the same order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from startracker.fixed_point.formats import Integers
from startracker.fixed_point.square_root import root

__all__ = [
    "FEW_FIT",
    "FIT",
    "LOG_BITS",
    "MOST_EXTRA",
    "NOT_SPREAD",
    "PLANE_BITS",
    "Tables",
    "local_areas",
    "plane",
    "verify",
]

PLANE_BITS = 12
"""Of fraction in pixels of the plane."""
LOG_BITS = 12
"""Of fraction in logarithms to base 2."""
FEW_FIT, NOT_SPREAD, FIT = 0, 1, 2
"""What `verify` says: fewer than three stars agree; they clump or lie in a line; their evidence counts."""
MOST_EXTRA = 10
"""Guide stars of a field that are looked at, the brightest: twice the points and these."""
_ONE = 1 << 30
_ROUNDS = 8
_SETTLED = 8  # units of the plane: 0.002 pixel
_SETTLED_ANGLE = 1 << 12  # of 2.30: 0.8″
_LARGEST_ANGLE = 1 << 27  # of 2.30: 7°
_LOG_UP = 24  # what `_log2` may be too small by: 4096 log₂(1 + 1/256), rounded up
_NEVER = -(1 << 28)
_SUM_STEP = 8  # of logarithms' differences to places of the table of sums


class Tables(NamedTuple):
    """Guide stars and constants of one camera, made by `startracker.identification.integer_acceptance`.

    Parameters
    ----------
    guide : (G, 3)
        Directions of 2.30, brightest first.
    focal, ratio : int
        Focal length across, 2⁻¹² pixels; that across over that down, of 12.20.
    half : (2,)
        Half the image in the plane.
    gates : (R,)
        Squares of the radii within which a point is a guide star, one after the other.
    same, same_roll : int
        Largest differences of the elements of two matrices of 2.30 that are one attitude: of the boresight, of the axis
        to the right. Either moves the image by the widest gate at most.
    spread : int
        Least determinant of the second moments of the matched points over the square of their number, of whole
        pixels; a share of that of an evenly filled image.
    log_area : int
        log₂ of the image's area in units of the plane, downwards.
    log_pi : int
        log₂ π, downwards.
    log_cell : (S,)
        log₂ 2πσ² of each width σ averaged over, in units of the plane, upwards.
    quadratic, farthest : (S,)
        log₂ e / 2σ² × 2³² a unit of squared distance, upwards; squared distance beyond which nothing matches.
    log_volume : (S,)
        log₂ of the prior of the width and of the volume of attitudes of one match of one pixel's lever, downwards.
    log_table, sum_table : (256,), (T,)
        log₂(1 + k/256), and log₂(1 + 2⁻ˣ) of x = (k + 1)/16: both downwards.
    distracting : (N + 1,)
        log₂ of the weight of k stars that are no guide stars.
    seeing : (N + 1, D + 1)
        log₂ of the weight of M guide stars that are seen and k that are not.
    total : (N + 1, D + 1)
        log₂ of what all numbers of stars weigh together, for n observed and up to D guide stars, upwards.
    threshold : int
        log₂ of the least factor that is accepted, upwards.
    """

    guide: Integers
    focal: int
    ratio: int
    half: Integers
    gates: Integers
    same: int
    same_roll: int
    spread: int
    log_area: int
    log_pi: int
    log_cell: Integers
    quadratic: Integers
    farthest: Integers
    log_volume: Integers
    log_table: Integers
    sum_table: Integers
    distracting: Integers
    seeing: Integers
    total: Integers
    threshold: int


def plane(xy: Integers, tables: Tables) -> Integers:
    """Centroids (N, 2) of 10.22, y up, in the plane, y down."""
    shift = 22 - PLANE_BITS
    return np.stack([xy[:, 0] >> shift, -((xy[:, 1] * tables.ratio) >> (shift + 20))], axis=1)


@njit(cache=True, error_model="numpy")
def _log2(n: int, table: Integers) -> int:
    """log₂ of n ≥ 1, downwards."""
    bits, m = 0, n
    while m > 1:
        m >>= 1
        bits += 1
    top = (n >> (bits - 8)) if bits >= 8 else (n << (8 - bits))
    value: int = (bits << LOG_BITS) + table[top - 256]
    return value


@njit(cache=True, error_model="numpy")
def _log_sum(a: int, b: int, table: Integers) -> int:
    """log₂(2ᵃ + 2ᵇ), downwards."""
    high, low = max(a, b), min(a, b)
    k = (high - low) >> _SUM_STEP
    return high + table[k] if k < len(table) else high


@njit(cache=True, error_model="numpy")
def _quotient(n: int, d: int) -> int:
    """Quotient by d > 0, truncated towards zero as in C."""
    return n // d if n >= 0 else -(-n // d)


@njit(cache=True, error_model="numpy")
def local_areas(points: Integers, tables: Tables) -> Integers:
    """log₂ of the area (N,) that one point has to itself where each lies, that of the image at most, downwards."""
    n = len(points)
    out = np.empty(n, np.int64)
    square = np.empty(n, np.int64)
    for i in range(n):
        count = 0
        for j in range(n):
            if j == i:
                continue
            dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            value, at = dx * dx + dy * dy, count
            while at > 0 and square[at - 1] > value:
                square[at] = square[at - 1]
                at -= 1
            square[at] = value
            count += 1
        out[i] = tables.log_area
        for k in range(count):
            area = square[k] * count // (k + 1)
            log_area = _log2(area, tables.log_table) + tables.log_pi if area > 0 else _NEVER
            out[i] = min(out[i], log_area)
    return out


@njit(cache=True, error_model="numpy")
def _dot(a: Integers, b: Integers) -> int:
    product: int = (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) >> 30
    return product


@njit(cache=True, error_model="numpy")
def _normalize(v: Integers) -> bool:
    """A vector of components below 2³³ made one unit long, of 2.30; False for one of no length to speak of."""
    largest = max(abs(v[0]), abs(v[1]), abs(v[2]))
    if largest < 1 << 20:
        return False
    while largest >= _ONE:
        v[0], v[1], v[2] = v[0] >> 1, v[1] >> 1, v[2] >> 1
        largest >>= 1
    length = root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for k in range(3):
        v[k] = _quotient(v[k] * _ONE, length)
    return True


@njit(cache=True, error_model="numpy")
def _turn(matrix: Integers, x: int, y: int, z: int) -> bool:
    """Rotate an attitude in place by the small angles (x, y, z) of 2.30 about the camera's axes."""
    first = np.empty(3, np.int64)
    third = np.empty(3, np.int64)
    for k in range(3):
        first[k] = matrix[0, k] + ((y * matrix[2, k] - z * matrix[1, k]) >> 30)
        third[k] = matrix[2, k] + ((x * matrix[1, k] - y * matrix[0, k]) >> 30)
    if not _normalize(third):
        return False
    along = _dot(first, third)
    for k in range(3):
        first[k] -= (along * third[k]) >> 30
    if not _normalize(first):
        return False
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        matrix[0, k] = first[k]
        matrix[1, k] = (third[a] * first[b] - third[b] * first[a]) >> 30
        matrix[2, k] = third[k]
    return True


@njit(cache=True, error_model="numpy")
def _predict(matrix: Integers, guide: Integers, focal: int, out: Integers) -> bool:
    """Position (2,) of a guide star in the plane; False for one 45° or more off the axis on either side."""
    u, v, w = _dot(matrix[0], guide), _dot(matrix[1], guide), _dot(matrix[2], guide)
    if w <= 0 or abs(u) > w or abs(v) > w:
        return False
    out[0], out[1] = _quotient(u * focal, w), _quotient(v * focal, w)
    return True


@njit(cache=True, error_model="numpy")
def _field(matrix: Integers, tables: Tables, most: int, out: Integers) -> int:
    """Guide stars on the image, brightest first, `most` of them at most; how many."""
    at = np.empty(2, np.int64)
    count = 0
    for g in range(len(tables.guide)):
        if count == most:
            break
        ahead = _predict(matrix, tables.guide[g], tables.focal, at)
        if ahead and abs(at[0]) <= tables.half[0] and abs(at[1]) <= tables.half[1]:
            out[count] = g
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _match(points: Integers, places: Integers, gate: int, index: Integers, square: Integers, owner: Integers) -> int:
    """Nearest position (K, 2) of each point (N, 2) within the gate, each used once by the nearer; how many have one."""
    count = 0
    owner[: len(places)] = -1
    for i in range(len(points)):
        best, at = gate + 1, -1
        for k in range(len(places)):
            dx, dy = places[k, 0] - points[i, 0], places[k, 1] - points[i, 1]
            distance = dx * dx + dy * dy
            if distance < best:
                best, at = distance, k
        index[i] = -1
        if at < 0:
            continue
        rival = owner[at]
        if rival >= 0:
            if square[rival] <= best:
                continue
            index[rival] = -1
            count -= 1
        owner[at], index[i], square[i] = i, at, best
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def _refit(matrix: Integers, points: Integers, places: Integers, index: Integers, count: int, focal: int) -> int:
    """One step of the fit, in place: 0: no step, 1: not settled yet, 2: settled."""
    px = py = ex = ey = 0
    for i in range(len(points)):
        if index[i] >= 0:
            px += places[index[i], 0]
            py += places[index[i], 1]
            ex += points[i, 0] - places[index[i], 0]
            ey += points[i, 1] - places[index[i], 1]
    px, py = _quotient(px, count), _quotient(py, count)
    ex, ey = _quotient(ex, count), _quotient(ey, count)
    turning = lever = 0
    for i in range(len(points)):
        if index[i] >= 0:
            x, y = places[index[i], 0] - px, places[index[i], 1] - py
            turning += x * (points[i, 1] - places[index[i], 1]) - y * (points[i, 0] - places[index[i], 0])
            lever += x * x + y * y
    lever >>= 16
    if lever == 0:
        return 0
    angle = _quotient(turning * 16384, lever)
    # about the boresight, and how far that moves
    shift_x = ex + ((angle * py) >> 30)
    shift_y = ey - ((angle * px) >> 30)
    x, y = _quotient(-shift_y * _ONE, focal), _quotient(shift_x * _ONE, focal)
    if max(abs(angle), abs(x), abs(y)) > _LARGEST_ANGLE or not _turn(matrix, x, y, angle):
        return 0
    return 2 if max(abs(shift_x), abs(shift_y)) <= _SETTLED and abs(angle) <= _SETTLED_ANGLE else 1


@njit(cache=True, error_model="numpy")
def _spans(points: Integers, index: Integers, count: int, tables: Tables) -> tuple[bool, int]:
    """Whether matched points span the field, and the sum of their squared distances from their mean."""
    mx = my = 0
    for i in range(len(points)):
        if index[i] >= 0:
            mx += points[i, 0]
            my += points[i, 1]
    mx, my = _quotient(mx, count), _quotient(my, count)
    xx = xy = yy = lever = 0
    for i in range(len(points)):
        if index[i] >= 0:
            x, y = points[i, 0] - mx, points[i, 1] - my
            lever += x * x + y * y
            x, y = x >> PLANE_BITS, y >> PLANE_BITS
            xx += x * x
            xy += x * y
            yy += y * y
    return xx * yy - xy * xy >= tables.spread * count * count, lever


@njit(cache=True, error_model="numpy")
def _weigh(square: Integers, index: Integers, area: Integers, count: int, in_field: int, lever: int, t: Tables) -> int:
    """log₂ of the Bayes factor of the matches at hand, downwards."""
    n = len(index)
    gain = np.empty(count, np.int64)
    rank = np.empty(count, np.int64)
    lowered = _log2(count, t.log_table) + _LOG_UP + ((_log2(max(lever, 1), t.log_table) + _LOG_UP + 1) >> 1)
    everything = _NEVER
    for s in range(len(t.log_cell)):
        found = 0
        for i in range(n):
            if index[i] < 0 or square[i] > t.farthest[s]:
                continue
            value = area[i] - t.log_cell[s] - ((square[i] * t.quadratic[s]) >> 32) - 1
            at = found
            while at > 0 and gain[at - 1] < value:
                gain[at], rank[at] = gain[at - 1], rank[at - 1]
                at -= 1
            gain[at], rank[at] = value, index[i]
            found += 1
        of_width = _NEVER
        for depth in range(1, in_field + 1):
            value = t.distracting[n] + t.seeing[0, depth]
            total = m = 0
            for k in range(found):
                if rank[k] < depth:
                    m += 1
                    total += gain[k]
                    value = max(value, total + t.distracting[n - m] + t.seeing[m, depth - m])
            of_width = _log_sum(of_width, value, t.sum_table)
        everything = _log_sum(everything, of_width + t.log_volume[s], t.sum_table)
    evidence: int = everything - lowered - t.total[n, in_field]
    return evidence


@njit(cache=True, error_model="numpy")
def verify(start: Integers, points: Integers, area: Integers, t: Tables) -> tuple[int, int, int, Integers, Integers]:
    """Match, refit until it settles, weigh; at one gate after the other.

    Parameters
    ----------
    start : (3, 3)
        Attitude of 2.30 to begin with, rows: x (right), y (down), boresight.
    points, area : (N, 2), (N,)
        Observed stars in the plane, and what `local_areas` says of them.
    t : Tables

    Returns
    -------
    state : int
        `FEW_FIT`, `NOT_SPREAD` or `FIT`.
    evidence : int
        log₂ of the Bayes factor where it is `FIT`.
    matched : int
    index : (N,)
        Guide star of each point, −1: none.
    matrix : (3, 3)
    """
    n = len(points)
    matrix = start.copy()
    most = min(2 * n + MOST_EXTRA, t.seeing.shape[1] - 1)
    field = np.empty(most, np.int64)
    in_field = _field(matrix, t, most, field)
    places = np.empty((in_field, 2), np.int64)
    owner = np.empty(in_field, np.int64)
    index, last, square = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int64)
    state, evidence, matched = FEW_FIT, _NEVER, 0
    best_index, best_matrix = np.full(n, -1, np.int64), start.copy()
    count = 0
    for gate in t.gates:
        settled = False
        last[:] = -2
        for _ in range(_ROUNDS):
            for k in range(in_field):
                if not _predict(matrix, t.guide[field[k]], t.focal, places[k]):
                    return state, evidence, matched, best_index, best_matrix
            count = _match(points, places, gate, index, square, owner)
            if count < 3:
                return state, evidence, matched, best_index, best_matrix
            if settled and np.array_equal(index, last):
                break
            last[:] = index
            step = _refit(matrix, points, places, index, count, t.focal)
            if step == 0:
                return state, evidence, matched, best_index, best_matrix
            settled = step == 2
        spans, lever = _spans(points, index, count, t)
        state = max(state, NOT_SPREAD)
        if not spans:
            continue
        state = FIT
        value = _weigh(square, index, area, count, in_field, lever, t)
        if value > evidence:
            evidence, matched = value, count
            best_matrix[:] = matrix
            for i in range(n):
                best_index[i] = field[index[i]] if index[i] >= 0 else -1
    return state, evidence, matched, best_index, best_matrix
