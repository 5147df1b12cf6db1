"""Kernels for the evidence of a match against chance."""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray, IntArray
from startracker.geometry.linalg import inverse, transform, turned
from startracker.kernels import kernel_part
from startracker.sorting import order_of


@kernel_part
def log_assignments(gain: FloatArray, rank: IntArray, n: int, in_field: int) -> float:
    """ln of the likelihood ratio of matches, averaged over the detection limit and the number of true stars.

    The brightest D guide stars of the field are detectable, with equal probability for D from 1 to K; M of the n
    observed stars are true, with equal probability for M from 0 to min(n, D) and for all assignments: 1/C(n, M) and (D
    − M)!/D!. Of the matches within a depth only the best M are used; the others would increase the result.

    Parameters
    ----------
    gain : (m,)
        ln of the density of each match times the area, in descending order.
    rank : (m,)
        Rank of its guide star by brightness, from 0.
    n, in_field : int
        Observed stars, and guide stars expected, K.
    """
    total, highest = 0.0, -math.inf
    for depth in range(1, in_field + 1):
        value, cumulative, m = 0.0, 0.0, 0
        for k in range(len(gain)):
            if rank[k] >= depth:
                continue
            m += 1
            # the match, minus ln of (D − M + 1) possible guide stars, and of C(n, M) / C(n, M − 1)
            cumulative += gain[k] - math.log(depth - m + 1) - math.log((n - m + 1) / m)
            value = max(value, cumulative)
        value -= math.log(min(n, depth) + 1.0)
        if value > highest:
            total = total * math.exp(highest - value) + 1.0
            highest = value
        else:
            total += math.exp(value - highest)
    return highest + math.log(total / in_field)


@kernel_part
def log_evidence(
    observed: FloatArray,
    sigma: FloatArray,
    predicted: FloatArray,
    index: IntArray,
    precision: FloatArray,
    turn: FloatArray,
    information: FloatArray,
    area: float,
) -> float:
    """ln B of a match: see `startracker.tracking.matching.track`, for the names of the arguments."""
    loss, rank, order = np.empty(len(index)), np.empty_like(index), np.empty_like(index)
    moved, count, prior = np.empty_like(predicted), 0, 0.0
    transform(turned(np.eye(3), turn[0], turn[1], turn[2]), predicted, moved)
    for i in range(len(index)):
        if index[i] >= 0:
            p = moved[index[i]]
            d2 = (observed[i, 0] - p[0]) ** 2 + (observed[i, 1] - p[1]) ** 2 + (observed[i, 2] - p[2]) ** 2
            loss[count] = 0.5 * d2 / sigma[i] ** 2 - math.log(area / (2.0 * math.pi * sigma[i] ** 2))
            rank[count] = index[i]
            count += 1
    if count == 0:
        return -math.inf
    order_of(loss[:count], order)
    gain, ranks = np.empty(count), np.empty(count, np.int64)
    for m in range(count):
        gain[m], ranks[m] = -loss[order[m]], rank[order[m]]
    for r in range(3):
        for c in range(3):
            prior += turn[r] * precision[r, c] * turn[c]
    narrowing: float = inverse(precision + information, 3)[1] - inverse(precision, 3)[1]
    matches: float = log_assignments(gain, ranks, len(observed), len(predicted))
    return matches - 0.5 * (prior + narrowing)
