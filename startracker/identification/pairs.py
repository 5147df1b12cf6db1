"""Pairs of stars by their separation: ranges in a sorted list, found in constant time (k-vector).

A straight line through the sorted values is divided into as many steps as there are values, and the number of values
below each step is tabulated. The ends of a range are then a few values away from those in the table, however long the
list is; these values are searched one by one, so that the result is exactly that of `numpy.searchsorted`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel_part
from startracker.catalog.guide import PairList
from startracker.core import FloatArray, IntArray


class KVector(NamedTuple):
    """Index of sorted values.

    Parameters
    ----------
    values : (n,)
        Sorted values, ascending.
    below : int32 (n + 1,)
        Number of values below ``start + k * step``.
    start, step : float
        Parameters of the line.
    """

    values: FloatArray
    below: NDArray[np.int32]
    start: float
    step: float


def k_vector(values: FloatArray) -> KVector:
    """Index of ascending, finite values (n,)."""
    ascending = np.ascontiguousarray(values, dtype=np.float64)
    n = len(ascending)
    if n == 0:
        return KVector(ascending, np.zeros(1, np.int32), 0.0, 1.0)
    start = float(ascending[0])
    step = (float(ascending[-1]) - start) / n
    if not step > 0.0:
        step = 1.0
    below = np.searchsorted(ascending, start + step * np.arange(n + 1), side="left").astype(np.int32)
    return KVector(ascending, below, start, step)


@kernel_part
def _first_from(index: KVector, value: float) -> int:
    """Index of the first value that is not below `value`."""
    n = len(index.values)
    if n == 0 or value <= index.values[0]:
        return 0
    if value > index.values[n - 1]:
        return n
    at = int(index.below[min(max(int((value - index.start) / index.step), 0), n)])
    # The rounded step may put the line one value off, in either direction.
    while at > 0 and index.values[at - 1] >= value:
        at -= 1
    while at < n and index.values[at] < value:
        at += 1
    return at


@kernel_part
def find_range(index: KVector, low: float, high: float) -> tuple[int, int]:
    """Half-open range of the indices whose values are ≥ `low` and ≤ `high`."""
    first = _first_from(index, low)
    last = first
    n = len(index.values)
    if high >= low and n > 0:
        last = max(_first_from(index, high), first)
        while last < n and index.values[last] <= high:  # equal to the limit
            last += 1
    return first, last


PAIR_SIGMAS = 4.0
"""Standard errors within which the separation of a true pair is measured: 6e-5 of them are lost."""
ABERRATION = 1.02e-4
"""Largest relative change of a separation by aberration, for the Earth's and a satellite's velocity."""


def separation(first: FloatArray, second: FloatArray) -> FloatArray:
    """Angles (...,) between unit vectors (..., 3), exact for small and large angles (2 asin of half the chord)."""
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)))


def observed_pairs(vectors: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """All pairs i < j of vectors (N, 3): indices and separations, each (N(N−1)/2,)."""
    i, j = np.triu_indices(len(vectors), 1)
    return i.astype(np.int64), j.astype(np.int64), separation(vectors[i], vectors[j])


def pair_tolerance(
    sigma_rad: FloatArray, i: IntArray, j: IntArray, separations: FloatArray, fixed_rad: float | None
) -> FloatArray:
    """Largest difference (P,), rad, between a measured and a catalogued separation.

    4 √(σᵢ² + σⱼ²) plus the largest change by aberration; or `fixed_rad`, as in Greyling 1995, section 5.2.
    """
    if fixed_rad is not None:
        return np.full(len(i), fixed_rad)
    return PAIR_SIGMAS * np.hypot(sigma_rad[i], sigma_rad[j]) + ABERRATION * separations


def windows(pairs: PairList, separations: FloatArray, tolerance: FloatArray) -> tuple[IntArray, IntArray]:
    """Half-open ranges [low, high) of the guide pairs within `tolerance` of each separation, each (P,)."""
    low = np.searchsorted(pairs.separation_rad, (separations - tolerance).astype(np.float32), side="left")
    high = np.searchsorted(pairs.separation_rad, (separations + tolerance).astype(np.float32), side="right")
    return low.astype(np.int64), high.astype(np.int64)
