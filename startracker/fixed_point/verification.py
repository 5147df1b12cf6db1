"""Verification of an attitude against all observed stars and all guide stars of the field, in integers.

The steps are those of `startracker.identification.verification` in floating point: match, refit, compute the evidence.
Observed and predicted positions are compared in the tangent plane at the boresight in units of 2⁻¹² pixel, with y
scaled by the ratio of the two focal lengths. The attitude is refitted as a rigid motion of that plane (shift and
rotation by least squares with fixed focal length), which converges on iteration to the fit on the sphere.

The evidence is in `startracker.fixed_point.evidence`. The C export (`c/tracker_verification.c`) performs the same
operations in the same order.
"""

from __future__ import annotations

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.fixed_point.evidence import NEVER, PLANE_BITS, Tables, spans, weigh
from startracker.fixed_point.formats import Integers
from startracker.fixed_point.vectors import dot, normalize, quotient

FEW_FIT, NOT_SPREAD, FIT = 0, 1, 2
"""States of `verify`: fewer than three stars match; the matches are clustered or collinear; the evidence is valid."""
MOST_EXTRA = 10
"""The brightest guide stars of a field are used: twice the number of points plus this."""
_ONE = 1 << 30
_ROUNDS = 8
_SETTLED = 8  # units of the plane: 0.002 pixel
_SETTLED_ANGLE = 1 << 12  # of 2.30: 0.8″
_LEAST_LENGTH = 1 << 20
_LARGEST_ANGLE = 1 << 27  # of 2.30: 7°


def plane(xy: Integers, tables: Tables) -> Integers:
    """Centroids (N, 2) of 10.22 with y up, converted to the plane with y down."""
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
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        matrix[0, k], matrix[2, k] = first[k], third[k]
        matrix[1, k] = (third[i] * first[j] - third[j] * first[i]) >> 30
    return True


@kernel_part
def _predict(matrix: Integers, guide: Integers, focal: int, out: Integers) -> bool:
    """Position (2,) of a guide star in the plane; False if it is 45° or more off-axis in x or y."""
    u, v, w = dot(matrix[0], guide), dot(matrix[1], guide), dot(matrix[2], guide)
    if w <= 0 or abs(u) > w or abs(v) > w:
        return False
    out[0], out[1] = quotient(u * focal, w), quotient(v * focal, w)
    return True


@kernel_part
def _field(matrix: Integers, tables: Tables, most: int, out: Integers) -> int:
    """Guide stars on the image, brightest first, at most `most`; returns their number."""
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
def _match(points: Integers, predicted: Integers, gate: int, index: Integers, square: Integers, owner: Integers) -> int:
    """Match each point (N, 2) to the nearest predicted position (K, 2) within the gate, one to one; returns the number
    of matches."""
    count = 0
    owner[: len(predicted)] = -1
    for i in range(len(points)):
        best, at = gate + 1, -1
        for k in range(len(predicted)):
            dx, dy = predicted[k, 0] - points[i, 0], predicted[k, 1] - points[i, 1]
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
def _refit(matrix: Integers, points: Integers, predicted: Integers, index: Integers, count: int, focal: int) -> int:
    """One iteration of the fit, in place. Returns 0 if it failed, 1 if not yet converged, 2 if converged."""
    px = py = ex = ey = 0
    for i in range(len(points)):
        if index[i] >= 0:
            px += predicted[index[i], 0]
            py += predicted[index[i], 1]
            ex += points[i, 0] - predicted[index[i], 0]
            ey += points[i, 1] - predicted[index[i], 1]
    px, py = quotient(px, count), quotient(py, count)
    ex, ey = quotient(ex, count), quotient(ey, count)
    turning = lever = 0
    for i in range(len(points)):
        if index[i] >= 0:
            x, y = predicted[index[i], 0] - px, predicted[index[i], 1] - py
            turning += x * (points[i, 1] - predicted[index[i], 1]) - y * (points[i, 0] - predicted[index[i], 0])
            lever += x * x + y * y
    lever >>= 16
    if lever == 0:
        return 0
    angle = quotient(turning * 16384, lever)
    # correct the shift for the rotation about the boresight
    shift_x = ex + ((angle * py) >> 30)
    shift_y = ey - ((angle * px) >> 30)
    x, y = quotient(-shift_y * _ONE, focal), quotient(shift_x * _ONE, focal)
    if max(abs(angle), abs(x), abs(y)) > _LARGEST_ANGLE or not _turn(matrix, x, y, angle):
        return 0
    return 2 if max(abs(shift_x), abs(shift_y)) <= _SETTLED and abs(angle) <= _SETTLED_ANGLE else 1


@kernel
def verify(start: Integers, points: Integers, area: Integers, t: Tables) -> tuple[int, int, int, Integers, Integers]:
    """Match, refit until convergence and compute the evidence, for each gate in turn.

    Parameters
    ----------
    start : (3, 3)
        Initial attitude of 2.30, rows: x (right), y (down), boresight.
    points, area : (N, 2), (N,)
        Observed stars in the plane, and their `local_areas`.
    t : Tables

    Returns
    -------
    state : int
        `FEW_FIT`, `NOT_SPREAD` or `FIT`.
    evidence : int
        log₂ of the Bayes factor if the state is `FIT`.
    matched : int
    index : (N,)
        Guide star of each point, −1 for none.
    matrix : (3, 3)
    """
    n = len(points)
    matrix = start.copy()
    most = min(2 * n + MOST_EXTRA, t.seeing.shape[1] - 1)
    field = np.empty(most, np.int64)
    in_field = _field(matrix, t, most, field)
    predicted = np.empty((in_field, 2), np.int64)
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
                if not _predict(matrix, t.guide[field[k]], t.focal, predicted[k]):
                    return state, evidence, matched, best_index, best_matrix
            count = _match(points, predicted, gate, index, square, owner)
            if count < 3:
                return state, evidence, matched, best_index, best_matrix
            if settled and np.array_equal(index, last):
                break
            last[:] = index
            step = _refit(matrix, points, predicted, index, count, t.focal)
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
