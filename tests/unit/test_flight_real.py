"""Real numbers of the flight build, integers and single precision, beside exact ones."""

import ctypes
import math
import shutil
from fractions import Fraction

import numpy as np
import pytest
from flight_c import SANITIZED, Real, library

from simulator.randomness import stream

pytestmark = pytest.mark.system

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
BINARY = ("add", "times", "over")
UNARY = ("real_root", "log2", "power_of_2")


@pytest.fixture(scope="module")
def integers(tmp_path_factory):
    lib = library(tmp_path_factory.mktemp("c"), ("integers", "arithmetic"), extra=SANITIZED)
    for name in (*BINARY, *UNARY, "arctangent", "real_of"):
        getattr(lib, f"tracker_{name}").restype = Real
    lib.tracker_real_of.argtypes = (ctypes.c_int64, ctypes.c_int)
    lib.tracker_integer_of.restype, lib.tracker_integer_of.argtypes = ctypes.c_int64, (Real, ctypes.c_int)
    return lib


@pytest.fixture(scope="module")
def floats(tmp_path_factory):
    lib = library(tmp_path_factory.mktemp("c"), ("integers", "arithmetic"), arithmetic="float", extra=SANITIZED)
    for name in (*UNARY, "arctangent", "real_of"):
        getattr(lib, f"tracker_{name}").restype = ctypes.c_float
        getattr(lib, f"tracker_{name}").argtypes = (ctypes.c_float,) * (2 if name == "arctangent" else 1)
    lib.tracker_real_of.argtypes = (ctypes.c_int64, ctypes.c_int)
    lib.tracker_integer_of.restype, lib.tracker_integer_of.argtypes = ctypes.c_int64, (ctypes.c_float, ctypes.c_int)
    return lib


def exact(x):
    """A number as a fraction; of a mantissa of 31 bits, or zero."""
    assert x.m == 0 or 1 << 30 <= abs(x.m) < 1 << 31
    return Fraction(x.m) * Fraction(2) ** x.e


def numbers(integers, rng, count):
    """Numbers of all sizes, with zeros, powers of two, the longest mantissas."""
    mantissa = rng.integers(-(1 << 62), 1 << 62, count)
    kind = rng.integers(0, 8, count)
    mantissa[kind == 0] = 0
    mantissa[kind == 1] = (1 << 31) - 1
    mantissa[kind == 2] = -(1 << 30)
    return [
        integers.tracker_real_of(m, int(e))
        for m, e in zip(mantissa.tolist(), rng.integers(-120, 60, count), strict=True)
    ]


@needs_gcc
def test_integer_arithmetic_against_exact_numbers(integers):
    """Sums, products, quotients and roots to 2⁻³⁰, a truncated unit of the mantissa; functions to 1e-8, a few units and
    the next term of their series. Every fourth sum is a difference of close numbers."""
    rng, unit = stream(2, "real"), Fraction(1, 1 << 30)
    for k, (a, b) in enumerate(zip(numbers(integers, rng, 5000), numbers(integers, rng, 5000), strict=True)):
        other = Real(-a.m + (k % 3) * (abs(a.m) < (1 << 31) - 2), a.e) if k % 4 == 0 and abs(a.m) > 1 << 30 else b
        x, y, z = exact(a), exact(b), exact(other)
        total, product = exact(integers.tracker_add(a, other)), exact(integers.tracker_times(a, b))
        assert abs(total - (x + z)) <= unit * max(abs(x), abs(z), abs(x + z))
        assert abs(product - x * y) <= unit * abs(x * y)
        bits = int(rng.integers(-40, 120))
        scaled = x * Fraction(2) ** bits
        if abs(scaled) < 1 << 61:  # of a larger one it is 2⁶²
            assert abs(integers.tracker_integer_of(a, bits) - scaled) <= Fraction(1, 2)
        root = exact(integers.tracker_real_root(Real(abs(a.m), a.e)))
        assert abs(root**2 - abs(x)) <= 4 * unit * abs(x)
        assert integers.tracker_real_root(Real(-abs(a.m), a.e)).m == 0
        if b.m:
            assert abs(exact(integers.tracker_over(a, b)) - x / y) <= unit * abs(x / y)
            size, top = Real(abs(b.m), b.e), Real(abs(a.m), a.e)
            logarithm, angle = integers.tracker_log2(size), integers.tracker_arctangent(top, size)
            assert float(exact(logarithm)) == pytest.approx(math.log2(abs(y)), rel=3e-9, abs=3e-9)
            assert float(exact(angle)) == pytest.approx(math.atan2(abs(x), abs(y)), rel=1e-8, abs=1e-30)
    for n in rng.integers(-60 << 24, 60 << 24, 1000).tolist():
        power = integers.tracker_power_of_2(integers.tracker_real_of(n, -24))
        assert float(exact(power)) == pytest.approx(2.0 ** (n / 2**24), rel=1e-8)


@needs_gcc
def test_single_precision_of_c(floats):
    """Roots to two units of the mantissa; functions to 1e-6, some ten units."""
    rng = stream(3, "real")
    for x in np.float32(2.0 ** rng.uniform(-100.0, 100.0, 3000)):
        assert floats.tracker_real_root(x) == pytest.approx(math.sqrt(x), rel=2.5e-7)
        assert floats.tracker_log2(x) == pytest.approx(math.log2(x), rel=1e-6, abs=1e-6)
        y = np.float32(x * 2.0 ** rng.uniform(-10.0, 10.0))
        assert floats.tracker_arctangent(y, x) == pytest.approx(math.atan2(y, x), rel=1e-6)
    for x in np.float32(rng.uniform(-60.0, 60.0, 1000)):
        assert floats.tracker_power_of_2(x) == pytest.approx(2.0 ** float(x), rel=1e-6)
    for n, e in zip(rng.integers(-(2**40), 2**40, 1000).tolist(), rng.integers(-60, 20, 1000).tolist(), strict=True):
        assert floats.tracker_real_of(n, e) == pytest.approx(n * 2.0**e, rel=1e-7)
        exact = n * 2.0**-20  # a rounding to single precision, that of the sum with a half, and to an integer
        assert abs(floats.tracker_integer_of(n * 2.0**-40, 20) - exact) <= 0.5 + 2.0**-23 * abs(exact)
