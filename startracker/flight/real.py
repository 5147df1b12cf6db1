"""Real numbers in integers: 31-bit mantissa and exponent, each result truncated.

The attitude's normal equations and the filter's covariances span many decades; a mantissa and an exponent hold them
without a scale for each. The C source (`c/tracker_arithmetic.c`) performs the same operations in the same order.
"""

from __future__ import annotations

import math

BITS = 31
_LARGEST = 1 << 62


class Real:
    """The number m · 2ᵉ with m = 0, or 2³⁰ ≤ \\|m\\| < 2³¹; n · 2ᵉ truncated to 31 bits.

    Sums, products and quotients have relative errors below 2⁻³⁰; a quotient by zero is 0.
    """

    __slots__ = ("e", "m")

    def __init__(self, n: int, exponent: int = 0) -> None:
        more = abs(n).bit_length() - BITS
        if n == 0:
            self.m, self.e = 0, 0
            return
        u = abs(n) >> more if more > 0 else abs(n) << -more
        self.m, self.e = -u if n < 0 else u, exponent + more

    def __repr__(self) -> str:
        return f"Real({float(self)!r})"

    def __float__(self) -> float:
        return math.ldexp(self.m, self.e)

    def __add__(self, other: Real) -> Real:
        if self.m == 0:
            return other
        if other.m == 0:
            return self
        a, b = (self, other) if self.e >= other.e else (other, self)
        apart = a.e - b.e
        if apart > BITS:
            return a
        return Real((a.m << BITS) + (b.m << (BITS - apart)), a.e - BITS)

    def __neg__(self) -> Real:
        return Real(-self.m, self.e)

    def __sub__(self, other: Real) -> Real:
        return self + -other

    def __mul__(self, other: Real) -> Real:
        return Real(self.m * other.m, self.e + other.e)

    def __truediv__(self, other: Real) -> Real:
        if other.m == 0:
            return other
        u = (abs(self.m) << BITS) // abs(other.m)
        return Real(u if (self.m < 0) == (other.m < 0) else -u, self.e - other.e - BITS)

    def __lt__(self, other: Real) -> bool:
        return (self - other).m < 0

    def __gt__(self, other: Real) -> bool:
        return other < self

    def root(self) -> Real:
        """Square root; 0 of a negative number."""
        if self.m <= 0:
            return Real(0)
        shift = BITS if self.e % 2 else BITS - 1
        return Real(math.isqrt(self.m << shift), (self.e - shift) // 2)

    def integer(self, bits: int) -> int:
        """The number times 2ᵇⁱᵗˢ, rounded to nearest (halves away from zero); at most 2⁶² in magnitude."""
        u, shift = abs(self.m), self.e + bits
        if shift >= BITS:
            n = _LARGEST if u else 0
        elif shift >= 0:
            n = u << shift
        else:
            n = 0 if shift < -32 else (u + (1 << (-shift - 1))) >> -shift
        return -n if self.m < 0 else n

    def scaled(self, exponent: int) -> Real:
        """The number times 2ᵉˣᵖᵒⁿᵉⁿᵗ."""
        return Real(self.m, self.e + exponent)


ZERO, ONE = Real(0), Real(1)
_ROOT_OF_2, _TWICE_LOG2_E = Real(1518500250, -30), Real(1549082005, -29)
_RECIPROCAL = [ZERO] + [Real((1 << 40) // k, -40) for k in range(1, 10)]
_LN_2, _QUARTER_TURN = Real(1488522236, -31), Real(1686629713, -30)


def log2(x: Real) -> Real:
    """log₂ of a positive number."""
    e, x = x.e + BITS - 1, Real(x.m, 1 - BITS)
    if x > _ROOT_OF_2:
        x, e = x.scaled(-1), e + 1
    x = (x - ONE) / (x + ONE)
    return Real(e) + _odd_series(x, 5, 1) * _TWICE_LOG2_E


def power_of_2(x: Real) -> Real:
    """2ˣ."""
    whole = x.integer(0)
    term, total = (x - Real(whole)) * _LN_2, ONE
    for k in range(8, 0, -1):
        total = ONE + term * total * _RECIPROCAL[k]
    return total.scaled(whole)


def arctangent(y: Real, x: Real) -> Real:
    """Angle 0 to π/2 of the point (x, y), neither negative."""
    steep = x < y
    t = x / y if steep else y / x
    for _ in range(2):  # half of the angle
        t = t / (ONE + (ONE + t * t).root())
    t = _odd_series(t, 5, -1).scaled(2)
    return _QUARTER_TURN - t if steep else t


def _odd_series(x: Real, terms: int, sign: int) -> Real:
    square, total = x * x, ZERO
    for k in range(terms - 1, -1, -1):
        total = square * total
        total = _RECIPROCAL[2 * k + 1] + (-total if sign < 0 else total)
    return x * total
