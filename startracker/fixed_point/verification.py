"""An attitude checked against every observed star and every guide star of the field, in integers.

Match, refit, weigh, as `startracker.identification.verification` does in floating point. Observed stars and predictions
are compared in one plane: the tangent plane at the boresight in units of 2⁻¹² pixel, whose y is scaled by the ratio of
the two focal lengths. The attitude is refitted as a rigid motion of that plane (shift and rotation by least squares,
the focal length as stated), which repeated converges to the sphere's.

What matches weigh is in `startracker.fixed_point.evidence`. The C export (`c/tracker_verification.c`) does the same
operations in the same order.
"""

from __future__ import annotations

import numpy as np

from startracker.fixed_point.evidence import NEVER, PLANE_BITS, Tables, spans, weigh
from startracker.fixed_point.formats import Integers
from startracker.fixed_point.vectors import cross, dot, normalize, quotient
from startracker.kernels import kernel

__all__ = ["FEW_FIT", "FIT", "MOST_EXTRA", "NOT_SPREAD", "plane", "verify"]

FEW_FIT, NOT_SPREAD, FIT = 0, 1, 2
"""What `verify` says: fewer than three stars agree; they clump or lie in a line; their evidence counts."""
MOST_EXTRA = 10
"""Guide stars of a field that are looked at, the brightest: twice the points and these."""
_ONE = 1 << 30
_ROUNDS = 8
_SETTLED = 8  # units of the plane: 0.002 pixel
_SETTLED_ANGLE = 1 << 12  # of 2.30: 0.8″
_LEAST_LENGTH = 1 << 20
_LARGEST_ANGLE = 1 << 27  # of 2.30: 7°


def plane(xy: Integers, tables: Tables) -> Integers:
    """Centroids (N, 2) of 10.22, y up, in the plane, y down."""
    shift = 22 - PLANE_BITS
    return np.stack([xy[:, 0] >> shift, -((xy[:, 1] * tables.ratio) >> (shift + 20))], axis=1)


@kernel
def _turn(matrix: Integers, x: int, y: int, z: int) -> bool:
    """Rotate an attitude in place by the small angles (x, y, z) of 2.30 about the camera's axes."""
    first = np.empty(3, np.int64)
    third = np.empty(3, np.int64)
    for k in range(3):
        first[k] = matrix[0, k] + ((y * matrix[2, k] - z * matrix[1, k]) >> 30)
        third[k] = matrix[2, k] + ((x * matrix[1, k] - y * matrix[0, k]) >> 30)
    if not normalize(third, _LEAST_LENGTH):
        return False
    along = dot(first, third)
    for k in range(3):
        first[k] -= (along * third[k]) >> 30
    if not normalize(first, _LEAST_LENGTH):
        return False
    matrix[0], matrix[2] = first, third
    cross(third, first, matrix[1])
    return True


@kernel
def _predict(matrix: Integers, guide: Integers, focal: int, out: Integers) -> bool:
    """Position (2,) of a guide star in the plane; False for one 45° or more off the axis on either side."""
    u, v, w = dot(matrix[0], guide), dot(matrix[1], guide), dot(matrix[2], guide)
    if w <= 0 or abs(u) > w or abs(v) > w:
        return False
    out[0], out[1] = quotient(u * focal, w), quotient(v * focal, w)
    return True


@kernel
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


@kernel
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


@kernel
def _refit(matrix: Integers, points: Integers, places: Integers, index: Integers, count: int, focal: int) -> int:
    """One step of the fit, in place: 0: no step, 1: not settled yet, 2: settled."""
    px = py = ex = ey = 0
    for i in range(len(points)):
        if index[i] >= 0:
            px += places[index[i], 0]
            py += places[index[i], 1]
            ex += points[i, 0] - places[index[i], 0]
            ey += points[i, 1] - places[index[i], 1]
    px, py = quotient(px, count), quotient(py, count)
    ex, ey = quotient(ex, count), quotient(ey, count)
    turning = lever = 0
    for i in range(len(points)):
        if index[i] >= 0:
            x, y = places[index[i], 0] - px, places[index[i], 1] - py
            turning += x * (points[i, 1] - places[index[i], 1]) - y * (points[i, 0] - places[index[i], 0])
            lever += x * x + y * y
    lever >>= 16
    if lever == 0:
        return 0
    angle = quotient(turning * 16384, lever)
    # about the boresight, and how far that moves
    shift_x = ex + ((angle * py) >> 30)
    shift_y = ey - ((angle * px) >> 30)
    x, y = quotient(-shift_y * _ONE, focal), quotient(shift_x * _ONE, focal)
    if max(abs(angle), abs(x), abs(y)) > _LARGEST_ANGLE or not _turn(matrix, x, y, angle):
        return 0
    return 2 if max(abs(shift_x), abs(shift_y)) <= _SETTLED and abs(angle) <= _SETTLED_ANGLE else 1


@kernel
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
    state, evidence, matched = FEW_FIT, NEVER, 0
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
        spread, lever = spans(points, index, count, t)
        state = max(state, NOT_SPREAD)
        if not spread:
            continue
        state = FIT
        value = weigh(square, index, area, count, in_field, lever, t)
        if value > evidence:
            evidence, matched = value, count
            best_matrix[:] = matrix
            for i in range(n):
                best_index[i] = field[index[i]] if index[i] >= 0 else -1
    return state, evidence, matched, best_index, best_matrix
