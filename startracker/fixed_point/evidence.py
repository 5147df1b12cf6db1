"""Evidence of a match of observed stars and guide stars against chance, in integers.

The evidence is log₂ of the Bayes factor of `startracker.identification.bayes_factor`, with 12 fraction bits; every
table entry and logarithm is rounded so that the factor is never overestimated. The null hypothesis differs: each point
has the local density of the points around it, at least that of the image. For the k-th nearest of n points at the
distance d the density is k/((n − 1) π d²), and the largest for k = 1 … n − 1 is used, so that a cluster of points is
not evidence. In addition, matches must span the field (`Tables.spread`).

The C export (`c/tracker_verification.c`) performs the same operations in the same order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.fixed_point.formats import Integers
from startracker.fixed_point.vectors import quotient

PLANE_BITS = 12
"""Fraction bits of pixels in the tangent plane."""
LOG_BITS = 12
"""Fraction bits of logarithms to base 2."""
NEVER = -(1 << 28)
"""Logarithm of zero."""
_LOG_UP = 24  # maximum error of `log2`: 4096 log₂(1 + 1/256), rounded up
_SUM_STEP = 8  # shift from differences of logarithms to indices into the table of sums


class Tables(NamedTuple):
    """Guide stars and constants of one camera, computed by `startracker.identification.integer_acceptance`."""

    guide: Integers
    """Directions of 2.30, brightest first, (G, 3)."""
    focal: int
    ratio: int
    """Horizontal focal length, 2⁻¹² pixels; ratio of the horizontal to the vertical focal length, of 12.20."""
    half: Integers
    """Half the image size in the plane, (2,)."""
    gates: Integers
    """Squares of the successive matching radii, (R,)."""
    same: int
    same_roll: int
    """Maximum differences between the elements of two matrices of 2.30 that count as the same attitude: of the
    boresight, and of the axis to the right. Either moves the image by at most the widest gate."""
    spread: int
    """Minimum determinant of the second moments of the matched points over the square of their number, in pixels; a
    fraction of that of a uniformly filled image."""
    log_area: int
    """log₂ of the image's area in units of the plane, rounded down."""
    log_pi: int
    """log₂ π, rounded down."""
    log_cell: Integers
    """log₂ 2πσ² of each width σ averaged over, in units of the plane, rounded up, (S,)."""
    quadratic: Integers
    farthest: Integers
    """log₂ e / 2σ² × 2³² per unit of squared distance, rounded up, and squared distance beyond which nothing matches,
    (S,) each."""
    log_volume: Integers
    """log₂ of the prior of the width and of the volume of attitudes of one match with a lever arm of one pixel, rounded
    down, (S,)."""
    log_table: Integers
    sum_table: Integers
    """log₂(1 + k/256), and log₂(1 + 2⁻ˣ) of x = (k + 1)/16, both rounded down, (256,), (T,)."""
    distracting: Integers
    """log₂ of the weight of k false stars, (N + 1,)."""
    seeing: Integers
    """log₂ of the weight of M guide stars detected and k not detected, (N + 1, D + 1)."""
    total: Integers
    """log₂ of the total weight of all numbers of stars, for n observed and up to D guide stars, rounded up,
    (N + 1, D + 1)."""
    threshold: int
    """log₂ of the minimum factor that is accepted, rounded up."""


@kernel_part
def log2(n: int, table: Integers) -> int:
    """log₂ of n ≥ 1, rounded down."""
    bits, m = 0, n
    while m > 1:
        m >>= 1
        bits += 1
    top = (n >> (bits - 8)) if bits >= 8 else (n << (8 - bits))
    value: int = (bits << LOG_BITS) + table[top - 256]
    return value


@kernel_part
def log_sum(a: int, b: int, table: Integers) -> int:
    """log₂(2ᵃ + 2ᵇ), rounded down."""
    high, low = max(a, b), min(a, b)
    k = (high - low) >> _SUM_STEP
    return high + table[k] if k < len(table) else high


@kernel
def local_areas(points: Integers, tables: Tables) -> Integers:
    """log₂ of the area per point (N,) at each point, at most that of the image, rounded down."""
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
            log_area = log2(area, tables.log_table) + tables.log_pi if area > 0 else NEVER
            out[i] = min(out[i], log_area)
    return out


@kernel
def spans(points: Integers, index: Integers, count: int, tables: Tables) -> tuple[bool, int]:
    """Whether the matched points span the field, and the sum of their squared distances from their mean."""
    mx = my = 0
    for i in range(len(points)):
        if index[i] >= 0:
            mx += points[i, 0]
            my += points[i, 1]
    mx, my = quotient(mx, count), quotient(my, count)
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


@kernel
def weigh(square: Integers, index: Integers, area: Integers, count: int, in_field: int, lever: int, t: Tables) -> int:
    """log₂ of the Bayes factor of the given matches, rounded down."""
    n = len(index)
    gain = np.empty(count, np.int64)
    rank = np.empty(count, np.int64)
    lowered = log2(count, t.log_table) + _LOG_UP + ((log2(max(lever, 1), t.log_table) + _LOG_UP + 1) >> 1)
    everything = NEVER
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
        of_width = NEVER
        for depth in range(1, in_field + 1):
            value = t.distracting[n] + t.seeing[0, depth]
            total = m = 0
            for k in range(found):
                if rank[k] < depth:
                    m += 1
                    total += gain[k]
                    value = max(value, total + t.distracting[n - m] + t.seeing[m, depth - m])
            of_width = log_sum(of_width, value, t.sum_table)
        everything = log_sum(everything, of_width + t.log_volume[s], t.sum_table)
    evidence: int = everything - lowered - t.total[n, in_field]
    return evidence
