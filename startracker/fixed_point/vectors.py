"""Directions in integers: unit vectors of 2.30, their products and normalisation.

The C export (`c/tracker_integers.c`) performs the same operations in the same order.
"""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.fixed_point.formats import Format, Integers

DIRECTION = Format(2, 30)
"""Components of unit vectors; a unit is 0.0002″."""
_ONE = 1 << 30


@kernel_part
def quotient(n: int, d: int) -> int:
    """n / d for d > 0, truncated towards zero as in C."""
    return n // d if n >= 0 else -(-n // d)


@kernel_part
def dot(a: Integers, b: Integers) -> int:
    """Scalar product of 2.30, rounded down."""
    product: int = (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) >> 30
    return product


def cross(a: Integers, b: Integers) -> Integers:
    """Vector products (..., 3) of 2.30, rounded down."""
    i, j = [1, 2, 0], [2, 0, 1]
    return np.asarray((a[..., i] * b[..., j] - a[..., j] * b[..., i]) >> 30)


@kernel
def normalize(v: Integers, least: int) -> bool:
    """Normalise a vector with components below 2³⁶ in place; False if all components are below `least`."""
    largest = max(abs(v[0]), abs(v[1]), abs(v[2]))
    if largest < least:
        return False
    while largest >= _ONE:
        v[0], v[1], v[2] = v[0] >> 1, v[1] >> 1, v[2] >> 1
        largest >>= 1
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    length = int(math.sqrt(square))  # at most one off, see `startracker.fixed_point.square_root`
    length -= length * length > square
    length += (length + 1) * (length + 1) <= square
    for k in range(3):
        v[k] = quotient(v[k] * _ONE, length)
    return True


def normalized(v: Integers, least: int) -> Integers | None:
    """Unit vector (3,) of components below 2³⁶, as `normalize`; None if all are below `least`."""
    largest = int(np.abs(v).max())
    if largest < least:
        return None
    while largest >= _ONE:
        v, largest = v >> 1, largest >> 1
    length = math.isqrt(int(v @ v))
    return np.array([quotient(int(c) * _ONE, length) for c in v], dtype=np.int64)
