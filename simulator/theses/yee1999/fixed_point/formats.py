"""Binary fixed-point numbers M.N in two's complement (Yee 1999, sections 3.2 and 3.3).

A number of format M.N is an integer of M + N bits in units of 2⁻ᴺ; the sign is the first of the M bits. All formats are
stored in int64 arrays, so that every result can be checked against the range of its format: a result out of range
raises `FixedPointOverflow` with the operation and the value, and never wraps around. Only `encode` and `decode` use
floating point; every other operation rejects arrays that are not integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.errors import BoresightError
from startracker.flight.integers import DIRECTION_BITS, Integers
from startracker.flight.integers import divide as truncated


class FixedPointOverflow(BoresightError, OverflowError):
    """A result outside the range of its fixed-point format.

    Attributes
    ----------
    operation : str
        What was computed.
    value : int
        The integer that did not fit.
    format : str
        Format or word length that was exceeded.
    """

    def __init__(self, operation: str, value: int, format: str) -> None:
        self.operation, self.value, self.format = operation, value, format
        super().__init__(f"fixed-point overflow: {operation} gives {value}, which {format} cannot hold")


def integers(value: Any) -> Integers:
    """The value as an array of int64; only integers and booleans are accepted.

    Raises
    ------
    TypeError
        If the array is of floating-point numbers or objects.
    """
    array = np.asarray(value)
    if array.dtype == np.int64:
        return array
    if array.dtype.kind not in "iub":
        raise TypeError(f"integer arithmetic was given an array of {array.dtype}")
    return array.astype(np.int64)


def check_product(a: ArrayLike, b: ArrayLike, operation: str) -> None:
    """Raise `FixedPointOverflow` if the product of two arrays could exceed 64 bits.

    The test uses the largest magnitudes of both, so it can also reject element-wise products that would fit.
    """
    left, right = integers(a), integers(b)
    if left.size and right.size:
        largest = int(np.abs(left).max()) * int(np.abs(right).max())
        if largest >= 1 << 63:
            raise FixedPointOverflow(operation, largest, "64 bits")


def divide(dividend: ArrayLike, divisor: ArrayLike) -> Integers:
    """Quotient truncated towards zero, as in C99.

    Raises
    ------
    FixedPointOverflow
        Division by zero.
    """
    n, d = integers(dividend), integers(divisor)
    if not d.all():
        raise FixedPointOverflow("division by zero", 0, "no format")
    return truncated(n, d)


@dataclass(frozen=True)
class Format:
    """A fixed-point format M.N."""

    integer_bits: int
    fraction_bits: int
    """M, including the sign bit if there is one, and N."""
    signed: bool = True
    """Two's complement; else unsigned."""

    def __post_init__(self) -> None:
        if self.fraction_bits < 0 or self.integer_bits < int(self.signed) or not 1 <= self.bits <= 64:
            raise ValueError(f"not a fixed-point format: {self.integer_bits}.{self.fraction_bits}")

    def __str__(self) -> str:
        return f"{self.integer_bits}.{self.fraction_bits}" + ("" if self.signed else " unsigned")

    @property
    def bits(self) -> int:
        """Word length, M + N."""
        return self.integer_bits + self.fraction_bits

    @property
    def one(self) -> int:
        """The integer that represents 1."""
        return 1 << self.fraction_bits

    @property
    def smallest(self) -> int:
        """The smallest integer, −2^(M+N−1) or 0."""
        return -(1 << (self.bits - 1)) if self.signed else 0

    @property
    def largest(self) -> int:
        """The largest integer."""
        return (1 << (self.bits - int(self.signed))) - 1

    def check(self, value: ArrayLike, operation: str = "a value") -> Integers:
        """Return the integers unchanged after checking their range.

        Raises
        ------
        FixedPointOverflow
            If one is out of range.
        """
        array = integers(value)
        outside = (array < self.smallest) | (array > self.largest)
        if outside.any():
            raise FixedPointOverflow(operation, int(array[outside].flat[0]), str(self))
        return array

    # ------------------------------------------------------------------ conversion, while tables are built
    def encode(self, value: ArrayLike, *, rounded: bool = False) -> Integers:
        """Real numbers × 2ᴺ, truncated towards zero as by assignment to an integer in C, or rounded to nearest.

        Raises
        ------
        FixedPointOverflow
            Out of range.
        ValueError
            Not finite.
        """
        real = np.asarray(value, dtype=np.float64)
        if not np.isfinite(real).all():
            raise ValueError("fixed-point numbers must be finite")
        scaled = np.ldexp(real, self.fraction_bits)
        scaled = np.rint(scaled) if rounded else np.trunc(scaled)
        outside = (scaled < self.smallest) | (scaled > self.largest)
        if outside.any():
            raise FixedPointOverflow("conversion", int(scaled[outside].flat[0]), str(self))
        return scaled.astype(np.int64)

    def decode(self, value: ArrayLike) -> NDArray[np.float64]:
        """The real numbers represented by integers of this format."""
        return np.ldexp(integers(value).astype(np.float64), -self.fraction_bits)

    # ------------------------------------------------------------------ arithmetic, integers only
    def from_integer(self, value: ArrayLike) -> Integers:
        """Integers converted to this format: shifted left by N."""
        return self.check(integers(value) * self.one, "conversion of an integer")

    def add(self, a: ArrayLike, b: ArrayLike) -> Integers:
        """a + b, both of this format."""
        return self.check(integers(a) + integers(b), "addition")

    def subtract(self, a: ArrayLike, b: ArrayLike) -> Integers:
        """a − b, both of this format."""
        return self.check(integers(a) - integers(b), "subtraction")

    def multiply(self, a: ArrayLike, b: ArrayLike, b_fraction_bits: int | None = None) -> Integers:
        """a × b: the product with 2N fraction bits is shifted right by N, which rounds down.

        Parameters
        ----------
        a, b : array_like of int
            Numbers of this format; `b` may have `b_fraction_bits` fraction bits instead.
        """
        check_product(a, b, "multiplication")
        shift = self.fraction_bits if b_fraction_bits is None else b_fraction_bits
        return self.check((integers(a) * integers(b)) >> shift, "multiplication")

    def divide(self, a: ArrayLike, b: ArrayLike) -> Integers:
        """a ÷ b: the dividend is shifted left by N first; truncated towards zero."""
        check_product(a, self.one, "division")
        return self.check(divide(integers(a) * self.one, b), "division")

    def text(self, value: int) -> str:
        """The bits with the binary point, such as ``0011.1000``."""
        bits = f"{int(value) & ((1 << self.bits) - 1):0{self.bits}b}"
        return f"{bits[: self.integer_bits]}.{bits[self.integer_bits :]}"


CENTROID = Format(10, 22)
"""Centroids in pixels, ±511 (Yee 1999, section 4.2.4.1)."""
SEPARATION = Format(6, 10)
"""Angular separations in degrees, below 32° (section 4.2.4.2)."""
COSINE = Format(1, 15, signed=False)
"""Cosines from 0 to 1 (section 3.4)."""
ANGLE = Format(10, 6)
"""Enclosed and rotation angles in degrees (section 3.3.3)."""
DIRECTION = Format(32 - DIRECTION_BITS, DIRECTION_BITS)
"""Components of unit vectors; a unit is 0.0002″."""
