"""Smooth functions of time, costly to compute, interpolated between values at regular dates."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["Nodes"]

FloatArray = NDArray[np.float64]

_POINTS = 12
_STEP_DAY = 0.5
_J2000_JD = 2_451_545.0


class Nodes:
    """A function of time from its values every half day, computed when first asked for.

    The polynomial through 12 values, the date in the middle of them (Lagrange), leaves of an oscillation of period P no
    more than 5.4e-5 (π day/P)¹² of its amplitude: 7e-14 of the fortnightly one, 2e-5 of one of three and a half days.

    Parameters
    ----------
    function : callable
        ``function(jd1, jd2) -> (M,)`` of a two-part Julian date.
    """

    def __init__(self, function: Callable[[float, float], FloatArray]) -> None:
        self._function = function
        self._node = functools.lru_cache(maxsize=4096)(self._at_node)
        self._around = functools.lru_cache(maxsize=1024)(self._values_around)

    def at(self, jd1: float, jd2: float) -> FloatArray:
        """The function (M,) at a two-part Julian date."""
        place = ((jd1 - _J2000_JD) + jd2) / _STEP_DAY
        before = math.floor(place)
        return np.asarray(_interpolated(self._around(before), place - before))

    def _values_around(self, before: int) -> FloatArray:
        first = before - _POINTS // 2 + 1
        return np.stack([self._node(number) for number in range(first, first + _POINTS)])

    def _at_node(self, number: int) -> FloatArray:
        return self._function(_J2000_JD, number * _STEP_DAY)


@njit(cache=True, error_model="numpy")
def _interpolated(values: FloatArray, share: float) -> FloatArray:
    """Kernel: polynomial through values (N, M) at 0, 1, …, N − 1, at `share` of the way from the middle one on."""
    count = len(values)
    x = count // 2 - 1 + share
    out = np.zeros(values.shape[1])
    for i in range(count):
        weight = 1.0
        for j in range(count):
            if j != i:
                weight *= (x - j) / (i - j)
        for m in range(values.shape[1]):
            out[m] += weight * values[i, m]
    return out
