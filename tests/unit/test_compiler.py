"""Shortcuts through the compiler: the same machine code, and numba as it was afterwards."""

import contextlib
import math
import re
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit, types
from numba.core import ir
from numba.core.registry import cpu_target
from numba.core.types.functions import BaseFunction

from startracker.compiler import _SHORTCUTS, shortcuts


class Window(NamedTuple):
    pixels: np.ndarray
    half: int


@njit(inline="always")
def _row_sum(window, row):
    total, highest = 0.0, -np.inf
    for x in range(window.pixels.shape[1]):
        value = window.pixels[row, x]
        if value < 0.0:
            continue
        total += math.sqrt(value) * window.half
        highest = max(highest, value)
    return total, highest


@njit(error_model="numpy")
def _product(a, b):
    return a * b if a > b else b / a


def _measured(image, counts, half):
    window, out = Window(image[1:], half), np.empty((len(image) - 1, 2))
    for row in range(len(out)):
        total, highest = _row_sum(window, row)
        if total > half and counts[row] > half // 2:
            out[row] = total, highest
        else:
            out[row, 0], out[row, 1] = _row_sum(window, 0)
    return out, _product(half, 3), _product(1.0, out[0, 0])


def compiled(image, counts):
    """The function's assembly without names, in which numba counts its functions, and its results."""
    function = njit(error_model="numpy")(_measured)
    result = function(image, counts, 4)
    (assembly,) = function.inspect_asm().values()
    lines = [line for line in assembly.splitlines() if not line.startswith("\t.size")]  # sizes of names among them
    return re.sub(r"\.?[\w.]*_ZN[\w.]*|\"[^\"]*\"", "name", "\n".join(lines)), result


@pytest.fixture
def frame(rng=np.random.default_rng(1)):
    return rng.normal(1.0, 1.0, (5, 9)), np.arange(5)


def test_this_version_of_numba_has_what_the_shortcuts_replace():
    assert [name for _, name, _ in _SHORTCUTS] == ["get_call_type", "run", "__deepcopy__"]


def test_machine_code_is_that_of_numba_alone(frame):
    with shortcuts():
        code, (out, *products) = compiled(*frame)
    plain_code, (plain_out, *plain_products) = compiled(*frame)
    assert code == plain_code
    assert len(code.splitlines()) > 200
    assert np.array_equal(out, plain_out, equal_nan=True)
    assert products == plain_products


def test_numba_is_as_before_after_the_outermost_context():
    before = BaseFunction.get_call_type, hasattr(ir.Scope, "__deepcopy__")
    with contextlib.suppress(KeyError), shortcuts():
        with shortcuts():
            pass
        assert BaseFunction.get_call_type is not before[0]
        assert hasattr(ir.Scope, "__deepcopy__")
        raise KeyError
    assert (BaseFunction.get_call_type, hasattr(ir.Scope, "__deepcopy__")) == before


def _greater_and_ratio(a, b):
    return max(a, b) + a / b


def test_options_of_one_kernel_are_not_those_of_another():
    """The maximum of two numbers is compiled with the options of the kernel that calls it, also when its signature is
    remembered and kernels with other options have been compiled since."""
    used = []
    with shortcuts():
        for options in ({}, {"fastmath": True}) * 2:
            assert njit(error_model="numpy", **options)(_greater_and_ratio)(1.0, 0.0) == np.inf
            greatest = cpu_target.typing_context.resolve_value_type(max)
            used.append(greatest.get_impl_key(types.float64(types.StarArgUniTuple(types.float64, 2))))
    assert used[0] is used[2] is not used[1] is used[3]
