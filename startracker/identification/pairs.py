"""Separations of observed stars and their windows in the sorted list of guide pairs."""

from __future__ import annotations

import numpy as np

from startracker.catalog.guide import PairList
from startracker.core import FloatArray, IntArray

PAIR_SIGMAS = 4.0
"""A true pair's separation is measured within this many standard errors: 6e-5 of them are lost."""
ABERRATION = 1.02e-4
"""Largest relative change of a separation by the Earth's and a satellite's speed over that of light."""


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
    """Largest difference (P,) between a measured and a catalogued separation, radians.

    4 √(σᵢ² + σⱼ²) plus what aberration may stretch; or `fixed_rad`, as in Greyling 1995, section 5.2.
    """
    if fixed_rad is not None:
        return np.full(len(i), fixed_rad)
    return PAIR_SIGMAS * np.hypot(sigma_rad[i], sigma_rad[j]) + ABERRATION * separations


def windows(pairs: PairList, separations: FloatArray, tolerance: FloatArray) -> tuple[IntArray, IntArray]:
    """Half-open ranges [low, high) of the guide pairs within `tolerance` of each separation, each (P,)."""
    low = np.searchsorted(pairs.separation_rad, (separations - tolerance).astype(np.float32), side="left")
    high = np.searchsorted(pairs.separation_rad, (separations + tolerance).astype(np.float32), side="right")
    return low.astype(np.int64), high.astype(np.int64)
