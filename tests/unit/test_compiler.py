"""Shortcuts through the compiler: the same results as of numba alone, and numba as it was afterwards.

Integers, indices and sums in order are the same in every bit. Sums that may be reordered (``reassoc``) are not compared
here: their order is the compiler's.
"""

import contextlib
import math
import re
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit, types
from numba.core import ir
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python, rtsys
from numba.core.types.functions import BaseFunction

from startracker import compiler
from startracker.compiler import _SHORTCUTS, shortcuts
from startracker.kernels import _has_loop, kernel, kernel_part
from startracker.lowering import lowering_shortcuts
from startracker.machine_code import machine_code_shortcuts


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


def test_this_version_of_numba_is_one_with_which_the_shortcuts_are_tested():
    assert len(_SHORTCUTS) == 3 + len(lowering_shortcuts()) + len(machine_code_shortcuts())


def test_results_are_those_of_numba_alone(frame):
    with shortcuts():
        _, (out, *products) = compiled(*frame)
    _, (plain_out, *plain_products) = compiled(*frame)
    assert np.array_equal(out, plain_out, equal_nan=True)
    assert products == plain_products


def test_instructions_that_are_left_out_are_those_that_llvm_removes(frame, monkeypatch):
    """All but those of the start of a loop, which numba writes with a branch."""
    same = [shortcut for shortcut in lowering_shortcuts() if shortcut[1] != "lower_expr"]
    monkeypatch.setattr(compiler, "_SHORTCUTS", _SHORTCUTS[:3] + tuple(same))
    with shortcuts():
        code, _ = compiled(*frame)
    assert code == compiled(*frame)[0]
    assert len(code.splitlines()) > 200


STARS = np.dtype([("x", np.float32), ("index", np.int32)], align=True)


def _indexed(cube, flipped, stars, words):
    """Elements by any index, of arrays of any layout, of which parts are returned; loops over any range."""
    total, parts = 0.0, np.zeros((3, 4))
    for i in range(-2, 2):
        total = total * 1.5 + cube[i, -1, i] + cube[i][1, 0] + flipped[-i] + words[np.uint64(i + 2)]
    for i in range(7, 0, -3):
        for j in range(np.uint64(2)):
            parts[i % 3, j] = total + i * 10 + j
    for i in range(3, 1):
        parts[i, 0] = np.nan
    row, column = parts[1:, :2], cube[0].T[:, 1]
    row[-1] = 7.0
    count, last = 0, stars[-1]
    for value in flipped[::-2]:
        count += int(value > last["x"]) + last["index"]
    stars[0]["index"] = count
    return row, column, total, count, parts[-1].sum()


def indexed_with(function):
    rng = np.random.default_rng(2)
    stars = np.array([(0.5, 3), (0.2, 4)], STARS)
    given = (
        rng.normal(size=(4, 3, 4)),
        np.asfortranarray(rng.normal(size=(5, 2)))[:, 1],
        stars,
        np.arange(9, dtype="u8"),
    )
    return *function(*given), stars.copy()


def test_indices_and_loops_are_those_of_numba_alone():
    with shortcuts():
        found = indexed_with(njit(error_model="numpy")(_indexed))
    for alone in (njit(error_model="numpy")(_indexed), _indexed):
        for value, expected in zip(found, indexed_with(alone), strict=True):
            assert np.array_equal(value, expected)


@kernel
def _halves(values):
    middle = len(values) // 2
    return values[:middle], 2.0 * values[middle:]


@kernel
def _swapped(values):
    first, second = _halves(values)
    out = np.empty_like(values)
    out[: len(second)], out[len(second) :] = second, first
    return out, first


def test_arrays_within_kernels_are_released_and_their_parts_are_kept():
    values = np.arange(10.0)
    _swapped(values)
    _nrt_python.memsys_enable_stats()
    counts, before = sys.getrefcount(values), rtsys.get_allocation_stats()
    for _ in range(50):
        out, first = _swapped(values)
        assert out.tolist() == [10.0, 12.0, 14.0, 16.0, 18.0, 0.0, 1.0, 2.0, 3.0, 4.0]
        assert first.base is not None
    del out, first
    after = rtsys.get_allocation_stats()
    _nrt_python.memsys_disable_stats()
    assert after.alloc - before.alloc == after.free - before.free > 50
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free
    assert sys.getrefcount(values) == counts


def test_a_kernel_within_others_is_called_from_python_and_from_functions_of_users_as_well():
    first, second = _halves(np.arange(4.0))
    assert first.tolist() == [0.0, 1.0]
    assert second.tolist() == [4.0, 6.0]

    @njit
    def of_a_user(values):
        return _swapped(_halves(values)[1])[0]

    assert of_a_user(np.arange(8.0)).tolist() == [24.0, 28.0, 8.0, 10.0]


@kernel_part
def _sum_of(values):
    total = 0.0
    for value in values:
        total += value
    return total


def test_loops_of_a_kernel_are_seen_also_in_its_parts():
    def repeats(values):
        while values[0] < 3:
            values[0] += 1

    def does_not(values):
        return max(values[0], 2) if len(values) else 3

    def has_a_part_that_repeats(values):
        return _sum_of(values)

    assert [_has_loop(repeats), _has_loop(does_not), _has_loop(has_a_part_that_repeats)] == [True, False, True]


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
