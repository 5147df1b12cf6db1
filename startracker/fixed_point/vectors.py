"""Directions in integers: unit vectors of 2.30, their products and normalisation.

The C export (`c/tracker_integers.c`) performs the same operations in the same order.
"""

from __future__ import annotations

from startracker.fixed_point.formats import Format, Integers
from startracker.fixed_point.square_root import root
from startracker.kernels import kernel

DIRECTION = Format(2, 30)
"""Components of unit vectors; a unit is 0.0002″."""
_ONE = 1 << 30


@kernel
def quotient(n: int, d: int) -> int:
    """n / d for d > 0, truncated towards zero as in C."""
    return n // d if n >= 0 else -(-n // d)


@kernel
def dot(a: Integers, b: Integers) -> int:
    """Scalar product of 2.30, rounded down."""
    product: int = (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) >> 30
    return product


@kernel
def cross(a: Integers, b: Integers, out: Integers) -> None:
    """Vector product of 2.30 into `out` (3,), rounded down."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[k] = (a[i] * b[j] - a[j] * b[i]) >> 30


@kernel
def normalize(v: Integers, least: int) -> bool:
    """Normalise a vector with components below 2³⁶ in place; False if all components are below `least`."""
    largest = max(abs(v[0]), abs(v[1]), abs(v[2]))
    if largest < least:
        return False
    while largest >= _ONE:
        v[0], v[1], v[2] = v[0] >> 1, v[1] >> 1, v[2] >> 1
        largest >>= 1
    length = root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for k in range(3):
        v[k] = quotient(v[k] * _ONE, length)
    return True
