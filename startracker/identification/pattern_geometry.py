"""Geometry of a pattern of four stars: which star is which, and the attitude that it gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.estimation.directions import normal_equations, pair_rotation
from startracker.identification.pattern_table import chord
from startracker.kernels import kernel
from startracker.linalg import solve, transform, triple_product, turned

__all__ = ["correspondence", "pattern_attitude"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_PERMUTATIONS = np.array(
    [[a, b, c, 6 - a - b - c] for a in range(4) for b in range(4) for c in range(4) if len({a, b, c}) == 3]
)


@kernel
def correspondence(
    observed: FloatArray, reference: FloatArray, tolerance: float, sense: float, order: IntArray
) -> float:
    """Which star of a catalogue pattern (4, 3) is which of an observed one (4, 3), scale free.

    Of the 24 orders the one whose six edges agree best within the tolerance, all of them, is put into `order` (4,).
    Mirror images are refused: the largest of the four triangles has to turn the same way in both, unless its area is
    below what noise can turn over.

    Parameters
    ----------
    tolerance : float
        Of each edge.
    sense : float
        Least triple product (twice a triangle's area) whose sign is sure.

    Returns
    -------
    Factor of the observed edges against the catalogue's; 0 where nothing agrees.
    """
    mine, theirs = np.empty((4, 4)), np.empty((4, 4))
    total, other = 0.0, 0.0
    for i in range(4):
        for j in range(i):
            mine[i, j] = mine[j, i] = chord(observed[i], observed[j])
            theirs[i, j] = theirs[j, i] = chord(reference[i], reference[j])
            total += mine[i, j]
            other += theirs[i, j]
    scale = total / other
    best, best_order = np.inf, -1
    for p in range(24):
        rss = 0.0
        fits = True
        for i in range(4):
            for j in range(i):
                difference = abs(mine[i, j] - scale * theirs[_PERMUTATIONS[p, i], _PERMUTATIONS[p, j]])
                if difference > tolerance:
                    fits = False
                    break
                rss += difference * difference
            if not fits:
                break
        if fits and rss < best:
            best, best_order = rss, p
    if best_order < 0:
        return 0.0
    order[:] = _PERMUTATIONS[best_order]
    largest, mirrored = 0.0, False
    for left_out in range(4):
        a, b, c = (1 if left_out == 0 else 0), (2 if left_out <= 1 else 1), (3 if left_out <= 2 else 2)
        seen = triple_product(observed[a], observed[b], observed[c])
        if abs(seen) > largest:
            largest = abs(seen)
            mirrored = seen * triple_product(reference[order[a]], reference[order[b]], reference[order[c]]) < 0.0
    return 0.0 if mirrored and largest > sense else scale


@kernel
def pattern_attitude(observed: FloatArray, reference: FloatArray) -> FloatArray:
    """Rotation (3, 3) of four or so pairs of unit vectors, reference to observed: least squares.

    From the two of greatest separation, then three Gauss–Newton steps.
    """
    n = len(observed)
    longest, a, b = -1.0, 0, 1
    for i in range(n):
        for j in range(i):
            d = chord(observed[i], observed[j])
            if d > longest:
                longest, a, b = d, j, i
    matrix: FloatArray = pair_rotation(observed, reference, a, b)
    predicted, every, sigma = np.empty((n, 3)), np.arange(n), np.ones(n)
    for _ in range(3):
        transform(matrix, reference, predicted)
        change = solve(*normal_equations(observed, observed, predicted, every, sigma, 3))
        matrix = turned(matrix, change[0], change[1], change[2])
    return matrix
