"""Kernels that weigh a match: how likely chance does as well."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.identification.verification import turned
from startracker.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def determinant_3(m: FloatArray) -> float:
    """Determinant of a (3, 3) matrix."""
    value: float = (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        + m[0, 1] * (m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )
    return value


@kernel
def turn_places(turn: FloatArray, places: FloatArray, out: FloatArray) -> None:
    """Turned directions (K, 3), written to `out`."""
    for k in range(len(places)):
        for i in range(3):
            out[k, i] = turn[i, 0] * places[k, 0] + turn[i, 1] * places[k, 1] + turn[i, 2] * places[k, 2]


@kernel
def log_assignments(gain: FloatArray, rank: IntArray, n: int, in_field: int) -> float:
    """ln of the likelihood ratio of matches, averaged over how deep the camera sees and how many stars are true.

    The brightest D guide stars of the field can be seen, all D from 1 to K alike; M of the n observed stars are true,
    all M from 0 to min(n, D) alike, which ones and which guide stars they are too: 1/C(n, M) and (D − M)!/D!. Of the
    matches within a depth the best M are taken; the rest would only add.

    Parameters
    ----------
    gain : (m,)
        ln of each match's density times the area, largest first.
    rank : (m,)
        Place of its guide star in the order of brightness, from 0.
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
            # the match, less ln of (D − M + 1) guide stars it could be, and of C(n, M) / C(n, M − 1)
            cumulative += gain[k] - math.log(depth - m + 1) - math.log((n - m + 1) / m)
            value = max(value, cumulative)
        value -= math.log(min(n, depth) + 1.0)
        if value > highest:
            total = total * math.exp(highest - value) + 1.0
            highest = value
        else:
            total += math.exp(value - highest)
    return highest + math.log(total / in_field)


@kernel
def log_evidence(
    observed: FloatArray,
    sigma: FloatArray,
    places: FloatArray,
    index: IntArray,
    covariance: FloatArray,
    precision: FloatArray,
    delta: FloatArray,
    information: FloatArray,
    area: float,
) -> float:
    """ln B of a match: see `startracker.tracking.matching.track`, whose names these are."""
    seen = np.flatnonzero(index >= 0)
    if len(seen) == 0:
        return -math.inf
    moved = np.empty_like(places)
    turn_places(turned(np.eye(3), -delta[0], -delta[1], -delta[2]), places, moved)
    gain = np.empty(len(seen))
    for m in range(len(seen)):
        i = seen[m]
        p = moved[index[i]]
        d2 = (observed[i, 0] - p[0]) ** 2 + (observed[i, 1] - p[1]) ** 2 + (observed[i, 2] - p[2]) ** 2
        gain[m] = math.log(area / (2.0 * math.pi * sigma[i] ** 2)) - 0.5 * d2 / sigma[i] ** 2
    order = np.argsort(-gain)
    prior = 0.0
    for r in range(3):
        for c in range(3):
            prior += delta[r] * precision[r, c] * delta[c]
    narrowing = math.log(determinant_3(precision + information) / determinant_3(precision))
    matches: float = log_assignments(gain[order], index[seen[order]], len(observed), len(places))
    return matches - 0.5 * prior - 0.5 * narrowing
