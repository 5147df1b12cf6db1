"""Verification of an attitude against all observed stars and guide stars of the field, on the sphere, in integers.

The steps are those of `startracker.identification.verification`: match within a gate, refit until the match no longer
changes, compute the evidence, narrow the gate. Directions are unit vectors of 2.30; the refit is the Gauss–Newton step
of `startracker.estimation.directions` with weights from the stated variances.

The C (`c/tracker_verify.c`) performs the same operations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from startracker.core import IntArray
from startracker.fixed_point.evidence import LOG_BITS, NEVER
from startracker.fixed_point.vectors import cross, quotient
from startracker.flight.apparent import FlightObserver, apparent
from startracker.flight.directions import turned
from startracker.flight.evidence import LOG_UP, Match, Sight, log_down, weigh
from startracker.flight.integers import shifted
from startracker.flight.search_tables import QUADRANT, SQUARE_BITS, SearchTables
from startracker.identification.verification import MOST_EXTRA

GATES = (
    ((1016064, 254016), (28224, 28224), (3318, 3318)),
    ((5308416, 1327104), (147456, 147456), (16384, 16384), (3318, 3318)),
)
"""Squares of the gates in units of the stated variances, 8 fraction bits, of the first round and of the others: 4.5
times 14, 7, 7/3 and 0.8 stated errors; 4.5 times 32, 16, 16/3, 16/9 and 0.8."""
ROUNDS, STEPS = 5, 500
"""Most rounds of a gate; steps of a verification besides those that grow with the numbers of stars."""
WEIGHT_BITS = 12
_ONE = 1 << 30
_LARGEST_TURN = 1 << 27  # of 2.30: 7°
_DIVISOR_SHIFT = 16
_FARTHEST2 = 1 << 54  # squared chord of 7°


class Field(NamedTuple):
    """Guide stars of a field, brightest first: numbers (K,), apparent directions (K, 3), V (K,)."""

    guide: IntArray
    direction: IntArray
    magnitude: IntArray


class Verified(NamedTuple):
    """An attitude as all stars see it.

    Parameters
    ----------
    evidence : int
        log₂ of its Bayes factor; `NEVER`: fewer than three stars agree.
    matrix : (3, 3)
    guide : (N,)
        Guide star of each star of the `Sight`, −1 for none.
    width : int
        Number of the width that fits best.
    steps : int
    """

    evidence: int
    matrix: IntArray
    guide: IntArray
    width: int
    steps: int


def field_at(matrix: IntArray, observer: FlightObserver, most: int, t: SearchTables) -> Field:
    """Guide stars on the image at an attitude, the brightest `most` of them."""
    axes = (t.outline_axes @ matrix) >> 30
    seen = (t.guide @ axes.T) >> 30
    index = np.flatnonzero(inside(seen, t))[:most]
    return Field(index, apparent(t.guide[index], t.motion[index], observer), t.magnitude[index])


def inside(seen: IntArray, t: SearchTables) -> IntArray:
    """Mask of directions in the axes of the outline that are on the image."""
    x, y, z = seen.T
    total = np.abs(x) + np.abs(y)
    near = z >= t.least_cosine
    part = np.where((x >= 0) == (y >= 0), np.abs(y), np.abs(x))
    quadrant = np.where(y >= 0, np.where(x >= 0, 0, 1), np.where(x < 0, 2, 3))
    share = (part * (QUADRANT << 8)) // np.maximum(total, 1) + quadrant * (QUADRANT << 8)
    low, rest = share >> 8, share & 255
    low, rest = np.where(low == 4 * QUADRANT, low - 1, low), np.where(low == 4 * QUADRANT, 256, rest)
    least = t.outline[low] + (((t.outline[low + 1] - t.outline[low]) * rest) >> 8)
    return np.asarray(near & (z >= least))


def matched(seen: Sight, predicted: IntArray, gate: int) -> tuple[IntArray, IntArray]:
    """Nearest prediction (N,) of each star within the gate, one to one, −1 for none; squared residuals (N,)."""
    away = seen.direction[:, None] - predicted[None]
    d2 = (away * away).sum(axis=-1)
    at = np.argmin(d2, axis=1)
    least = d2[np.arange(len(at)), at]
    square = (np.minimum(least, _FARTHEST2) << SQUARE_BITS) // seen.variance
    near = np.flatnonzero((square <= gate) & (least < _FARTHEST2))
    # of the stars nearest to one prediction the one with the smallest residual keeps it, of equal ones the first
    order = near[np.lexsort((near, square[near], at[near]))]
    first = order[np.unique(at[order], return_index=True)[1]]
    index = np.full(len(at), -1, np.int64)
    index[first] = at[first]
    return index, square


def _weights(variance: IntArray) -> tuple[IntArray, int]:
    """Weights of 1 to 4097, and the least variance, that of weight 2¹²."""
    least = int(variance.min())
    return (least << WEIGHT_BITS) // variance + 1, least


class _Normal(NamedTuple):
    """Normal matrix of small rotations in 30 bits: its cofactors and determinant, shifted by 30; the shift of the
    matrix; the gradient; the least variance."""

    cofactors: IntArray
    determinant: int
    shift: int
    gradient: IntArray
    least: int


def _normal(seen: Sight, predicted: IntArray, index: IntArray) -> _Normal:
    star = np.flatnonzero(index >= 0)
    weight, least = _weights(seen.variance[star])
    p = predicted[index[star]]
    e = seen.direction[star] - p
    products = (p[:, :, None] * p[:, None, :]) >> 30
    a = (weight[:, None, None] * (np.eye(3, dtype=np.int64) * _ONE - products)).sum(axis=0)
    right = (weight[:, None] * cross(p, e)).sum(axis=0)
    shift = max(int(np.abs(a).max()).bit_length() - 30, 0)
    a = a >> shift
    c = np.empty((3, 3), np.int64)
    for i in range(3):
        for j in range(3):
            p1, p2, q1, q2 = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            c[i, j] = (a[p1, q1] * a[p2, q2] - a[p1, q2] * a[p2, q1]) >> 30
    determinant = int((a[0] * c[0]).sum())
    return _Normal(c, determinant, shift, right, least)


def _log_determinant(normal: _Normal, t: SearchTables) -> int:
    """log₂ of the determinant of the normal matrix in 2⁻¹⁸⁰ rad⁶, rounded up."""
    scale = 30 + 3 * (normal.shift - 30 - WEIGHT_BITS)
    least = int(log_down(np.array(normal.least), t))
    return int(log_down(np.array(normal.determinant), t)) + LOG_UP + 2 + (scale << LOG_BITS) - 3 * least


def _step(normal: _Normal) -> IntArray | None:
    """Rotation vector (3,) of 2.30 of a Gauss–Newton step; None if it is not determined or too large."""
    divisor = normal.determinant >> _DIVISOR_SHIFT
    if divisor < 1 << 12:
        return None
    down = max(int(np.abs(normal.gradient).max()).bit_length() - 30, 0)
    right = normal.gradient >> down
    power = 30 - normal.shift + down - _DIVISOR_SHIFT
    step = np.empty(3, np.int64)
    for i in range(3):
        value = quotient(int((normal.cofactors[i] * right).sum()), divisor)
        if abs(value).bit_length() + power > 40:
            return None
        step[i] = shifted(value, power)
    return None if int(np.abs(step).max()) > _LARGEST_TURN else step


def verify(start: IntArray, wide: int, seen: Sight, observer: FlightObserver, t: SearchTables) -> Verified:
    """Match, refit until the match no longer changes, and compute the evidence, for each gate in turn.

    Parameters
    ----------
    start : (3, 3)
        Attitude of 2.30 to begin with: rows are the camera's axes.
    wide : int
        Row of `GATES`.
    seen : Sight
    observer : FlightObserver
    t : SearchTables
    """
    n = len(seen)
    field = field_at(start, observer, min(2 * n + MOST_EXTRA, t.seeing.shape[1] - 1), t)
    depth, steps, matrix = len(field.guide), STEPS, start
    none = np.full(n, -1, np.int64)
    best = Verified(NEVER, start, none, 0, steps)
    weighed = none
    if depth < 3:
        return best
    for gates in GATES[wide]:
        settled = _settle(matrix, seen, field, gates)
        steps += settled.rounds * n * depth
        if settled.rank is None:
            break
        matrix, index = settled.matrix, settled.rank
        if np.array_equal(index, weighed):
            continue
        weighed = index
        star = np.flatnonzero(index >= 0)
        normal = _normal(seen, settled.predicted, index)
        steps += 14 * depth * len(star)
        if normal.determinant < 1:
            break
        match = Match(star, index[star], settled.square[star], _log_determinant(normal, t))
        evidence, width = weigh(seen, match, field.magnitude, t)
        if evidence > best.evidence:
            guide = np.where(index >= 0, field.guide[index], -1)
            best = Verified(evidence, matrix, guide, width, 0)
    return best._replace(steps=steps)


class _Settled(NamedTuple):
    """Result of `_settle`; no ranks if fewer than three stars match or the fit fails."""

    matrix: IntArray
    rank: IntArray | None
    square: IntArray
    predicted: IntArray
    rounds: int


def _settle(matrix: IntArray, seen: Sight, field: Field, gates: tuple[int, int]) -> _Settled:
    """Match and refit until the match no longer changes."""
    last: IntArray | None = None
    for round_ in range(ROUNDS):
        predicted = (field.direction @ matrix.T) >> 30
        index, square = matched(seen, predicted, gates[min(round_, 1)])
        count = int((index >= 0).sum())
        if count < 3:
            return _Settled(matrix, None, square, predicted, round_ + 1)
        if (last is not None and np.array_equal(index, last)) or round_ == ROUNDS - 1:
            return _Settled(matrix, index, square, predicted, round_ + 1)
        last = index
        step = _step(_normal(seen, predicted, index))
        rotated = None if step is None else turned(matrix, -step)
        if rotated is None:
            return _Settled(matrix, None, square, predicted, round_ + 1)
        matrix = rotated
    raise AssertionError("unreachable")
