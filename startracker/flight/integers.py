"""Integers of the flight build's tables, and the operations of its C on them."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Integers: TypeAlias = NDArray[np.int64]
DIRECTION_BITS = 30
"""Fraction bits of unit vectors: 2.30, of which a unit is 0.0002″."""
ANGLE_BITS = 6
"""Fraction bits of the angles of triads, degrees."""
FINE_BITS = 40
"""Fraction bits of the degrees that CORDIC (Volder 1959) adds up."""
ROTATION_STEPS = tuple(round(math.ldexp(math.degrees(math.atan(2.0**-k)), FINE_BITS)) for k in range(40))
"""Its steps, atan 2⁻ᵏ, degrees of `FINE_BITS` fraction bits."""


def rounded(values: ArrayLike, bits: int) -> Integers:
    """Real numbers with a number of fraction bits, rounded to nearest."""
    return np.asarray(np.rint(np.ldexp(np.asarray(values, dtype=float), bits)).astype(np.int64))


def divide(dividend: Integers, divisor: Integers | int) -> Integers:
    """Quotient truncated towards zero, as in C99; the divisor is not zero."""
    return np.asarray(np.sign(dividend) * np.sign(divisor) * (np.abs(dividend) // np.abs(divisor)))


def square_root(n: Integers) -> Integers:
    """⌊√n⌋ of integers from 0 to below 2⁶²: the root of the nearest double, which is at most one off, made exact.

    The C iterates x ← (x + n/x)/2 (Newton–Raphson) to the same root.
    """
    root = np.sqrt(n).astype(np.int64)
    root -= root * root > n
    return np.asarray(root + ((root + 1) * (root + 1) <= n))
