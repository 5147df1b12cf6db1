"""Square roots and angular separations in integers (Yee 1999, section 3.4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simulator.theses.yee1999.fixed_point.formats import COSINE, SEPARATION, check_product, integers
from simulator.theses.yee1999.fixed_point.tables import arccosine_table, cosine_table
from startracker.flight.integers import Integers
from startracker.flight.integers import square_root as rooted

CROSSOVER = 11929
"""11.65° in 6.10: below it Pythagoras' theorem is more accurate than the tables; see `separation`."""


def square_root(value: ArrayLike) -> Integers:
    """⌊√n⌋ of integers 0 ≤ n < 2⁶²: the root of the nearest double, which is at most one off, and then exact.

    The root of a number of format M.N is the integer root of the number times 2ᴺ.

    Raises
    ------
    ValueError
        A negative number, or one of more than 62 bits.
    """
    n = integers(value)
    if n.size and (n.min() < 0 or n.max() >= 1 << 62):
        raise ValueError("square roots need integers from 0 to below 2**62")
    return rooted(n)


def by_pythagoras(chi: ArrayLike, psi: ArrayLike) -> Integers:
    """θ = √(χ² + ψ²) (Yee 1999, eq. 3.3), all of 6.10, truncated.

    Raises
    ------
    FixedPointOverflow
        A separation of 32° or more.
    """
    return SEPARATION.check(_hypotenuse(integers(chi), integers(psi)), "angular separation")


def by_tables(chi: ArrayLike, psi: ArrayLike) -> Integers:
    """arccos(cos χ cos ψ) (Yee 1999, eq. 3.2) from the tables, all of 6.10.

    Raises
    ------
    FixedPointOverflow
        A separation beyond the arccosine table, 32° or more.
    """
    cosine, (arccosine, discarded) = cosine_table(), arccosine_table()
    x, y = np.abs(SEPARATION.check(chi, "angle")), np.abs(SEPARATION.check(psi, "angle"))
    largest = len(cosine) - 1
    product = (cosine[np.minimum(x, largest)] * cosine[np.minimum(y, largest)]) >> COSINE.fraction_bits
    entry = product - discarded
    SEPARATION.check(np.where((entry < 0) | (x > largest) | (y > largest), SEPARATION.largest + 1, 0), "separation")
    return np.asarray(arccosine[entry])


def separation(chi: ArrayLike, psi: ArrayLike, crossover: int = CROSSOVER) -> Integers:
    """Angular separation of 6.10 of stars separated by χ and ψ along the image axes (6.10).

    Pythagoras' theorem up to the crossover and the tables beyond, whichever is more accurate; the maximum error is
    0.02°.

    Raises
    ------
    FixedPointOverflow
        A separation of 32° or more.
    """
    x, y = np.broadcast_arrays(integers(chi), integers(psi))
    plane: Integers = _hypotenuse(x, y)
    far = plane > crossover
    if far.any():
        plane[far] = by_tables(x[far], y[far])
    return plane


def _hypotenuse(x: Integers, y: Integers) -> Integers:
    check_product(x, 2 * x, "square of an angle")
    check_product(y, 2 * y, "square of an angle")
    return square_root(x * x + y * y)
