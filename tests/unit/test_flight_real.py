"""Real numbers of the flight build: integers and single precision in C beside Python's floats."""

import ctypes
import math
import shutil

import numpy as np
import pytest
from flight_c import SANITIZED, Real, library

from simulator.randomness import stream
from startracker.flight.real import Real as Number
from startracker.flight.real import arctangent, log2, power_of_2

pytestmark = pytest.mark.system

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
BINARY = {"add": "__add__", "times": "__mul__", "over": "__truediv__"}
UNARY = {"real_root": Number.root, "log2": log2, "power_of_2": power_of_2}


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


def passed(x):
    return Real(x.m, x.e)


def same(c, python):
    return (c.m, c.e) == (python.m, python.e)


def numbers(rng, count):
    """Numbers of all sizes, with zeros, powers of two, the longest mantissas and near neighbours."""
    mantissa = rng.integers(-(1 << 62), 1 << 62, count)
    kind = rng.integers(0, 8, count)
    mantissa[kind == 0] = 0
    mantissa[kind == 1] = (1 << 31) - 1
    mantissa[kind == 2] = -(1 << 30)
    return [Number(int(m), int(e)) for m, e in zip(mantissa, rng.integers(-120, 60, count), strict=True)]


@needs_gcc
def test_integers_of_c_and_python_are_the_same_bits(integers):
    rng = stream(1, "real")
    first, second = numbers(rng, 10_000), numbers(rng, 10_000)
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        near = Number(-a.m + k % 3, a.e) if k % 4 == 0 and a.m else b
        for name, method in BINARY.items():
            assert same(getattr(integers, f"tracker_{name}")(passed(a), passed(near)), getattr(a, method)(near)), (a, b)
        bits = int(rng.integers(-40, 120))
        assert integers.tracker_integer_of(passed(a), bits) == a.integer(bits)
        size = Number(abs(a.m), a.e)
        assert same(integers.tracker_real_root(passed(a)), a.root())
        if a.m and k < 2000:
            assert same(integers.tracker_log2(passed(size)), log2(size))
            small = Number(a.m, int(rng.integers(-60, -25)))
            assert same(integers.tracker_power_of_2(passed(small)), power_of_2(small))
            other = Number(abs(b.m), b.e)
            assert same(integers.tracker_arctangent(passed(other), passed(size)), arctangent(other, size))


def test_integer_arithmetic_against_exact_numbers():
    """Sums, products, quotients and roots to 2⁻³⁰, a truncated unit of the mantissa; functions to 1e-8, a few units and
    the next term of their series."""
    rng = stream(2, "real")
    for a, b in zip(numbers(rng, 3000), numbers(rng, 3000), strict=True):
        x, y = float(a), float(b)
        assert float(a * b) == pytest.approx(x * y, rel=2.0**-30, abs=0.0)
        assert abs(float(a + b) - (x + y)) <= 2.0**-30 * max(abs(x), abs(y), abs(x + y))
        if y:
            assert float(a / b) == pytest.approx(x / y, rel=2.0**-30, abs=0.0)
            assert (a < b) == (x < y)
            assert float(log2(Number(abs(b.m), b.e))) == pytest.approx(math.log2(abs(y)), rel=3e-9, abs=3e-9)
            assert float(arctangent(Number(abs(a.m), a.e), Number(abs(b.m), b.e))) == pytest.approx(
                math.atan2(abs(x), abs(y)), rel=1e-8, abs=1e-30
            )
        assert float(Number(abs(a.m), a.e).root()) == pytest.approx(math.sqrt(abs(x)), rel=2.0**-29, abs=0.0)
    for x in rng.uniform(-60.0, 60.0, 1000):
        assert float(power_of_2(Number(int(x * 2**24), -24))) == pytest.approx(
            2.0 ** (int(x * 2**24) / 2**24), rel=1e-8
        )


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
