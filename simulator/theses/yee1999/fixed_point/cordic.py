"""Angles of vectors in 64-bit integers by CORDIC (Volder 1959)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simulator.theses.yee1999.fixed_point.formats import FixedPointOverflow, Format, integers
from startracker._compiled import kernel
from startracker.flight.integers import FINE_BITS, ROTATION_STEPS, Integers

DEGREES = Format(10, 22)
"""Right ascension, declination and roll, degrees: 0.0009″ per unit."""


def fine_angles(y: ArrayLike, x: ArrayLike) -> Integers:
    """Four-quadrant arctangents of y/x, degrees in (−90°, 270°] with 40 fraction bits; 0 for (0, 0).

    The vectors are scaled up first, so that short ones do not lose precision; the error is below
    57.3 × 2⁻³⁹ + 40 × 2⁻⁴¹ < 2⁻³² degrees.

    Raises
    ------
    FixedPointOverflow
        If a component is 2⁴⁰ or more in magnitude.
    """
    a, b = np.broadcast_arrays(integers(y), integers(x))
    if a.size:
        largest = max(int(np.abs(a).max()), int(np.abs(b).max()))
        if largest >= 1 << 40:
            raise FixedPointOverflow("arctangent", largest, "40 bits")
    return np.asarray(_rotated(a.ravel(), b.ravel(), np.array(ROTATION_STEPS))).reshape(a.shape)


@kernel
def _rotated(y: Integers, x: Integers, steps: Integers) -> Integers:
    angle = np.zeros_like(y)
    for n in range(len(y)):
        a, b = y[n], x[n]
        largest = max(abs(a), abs(b))
        if largest == 0:
            continue
        while largest < 1 << 58:  # the rotations increase the length by at most 1.65 × √2
            largest, a, b = largest << 1, a << 1, b << 1
        total = 0
        if b < 0:
            a, b, total = -a, -b, 180 << FINE_BITS
        for k in range(len(steps)):
            if a > 0:
                a, b, total = a - (b >> k), b + (a >> k), total + steps[k]
            else:
                a, b, total = a + (b >> k), b - (a >> k), total - steps[k]
        angle[n] = total
    return angle
