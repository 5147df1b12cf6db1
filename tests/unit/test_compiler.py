"""Shortcuts through the compiler: the same machine code, and numba as it was afterwards."""

import contextlib
import math
import re
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit, types
from numba.core.errors import TypingError
from numba.core.registry import cpu_target
from numba.extending import overload

from startracker import compiler
from startracker.compiler import SAME_CODE, SAME_RESULTS, shortcuts


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


@njit(inline="always")
def _steps_to_one(number):
    """Collatz: variables assigned in both branches and in the loop, one of them not on every path."""
    steps, last = 0, number
    while number != 1:
        if number % 2:
            number, last = 3 * number + 1, number
        else:
            number //= 2
            last = max(last, number)
        steps += 1
    return steps, last


def _measured(image, counts, half):
    window, out = Window(image[1:], half), np.empty((len(image) - 1, 2))
    for row in range(len(out)):
        total, highest = _row_sum(window, row)
        if total > half and counts[row] > half // 2:
            out[row] = total, highest
        else:
            out[row, 0], out[row, 1] = _row_sum(window, 0)
    return out, _product(half, 3), _product(1.0, out[0, 0]), _steps_to_one(27)


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
    replaced = [
        f"{getattr(owner, '__module__', 'module')}.{owner.__name__}.{name}"
        for owner, name, _ in (*SAME_CODE, *SAME_RESULTS)
    ]
    assert replaced == [
        "numba.core.types.functions.BaseFunction.get_call_type",
        "numba.core.typeinfer.TypeVarMap.__getitem__",
        "numba.core.typeinfer.ConstraintNetwork.propagate",
        "module.numba.core.lowering.new_error_context",
        "module.numba.core.typeinfer.new_error_context",
        "numba.core.postproc.PostProcessor.run",
        "numba.core.ir.Block.__deepcopy__",
        "numba.core.ir.Scope.__deepcopy__",
        "module.numba.core.ssa._run_block_rewrite",
        "numba.core.ir.Inst._rec_list_vars",
        "llvmlite.binding.ffi._LLVMLock.__enter__",
        "llvmlite.binding.ffi._LLVMLock.__exit__",
        "numba.core.base.BaseContext.refresh",
        "numba.core.runtime.context.NRTContext.get_meminfos",
        "numba.core.lowering.Lower.storevar",
        "numba.core.lowering.Lower.delvar",
        "module.numba.np.arrayobj.basic_indexing",
        "numba.core.typed_passes.IRLegalization.run_pass",
        "numba.core.typed_passes.BaseNativeLowering.run_pass",
        "numba.core.pythonapi.PythonAPI.from_native_value",
        "numba.core.pythonapi.PythonAPI.serialize_object",
        "numba.core.pythonapi.PythonAPI.unserialize",
        "numba.core.codegen.CPUCodeLibrary.add_ir_module",
        "numba.core.codegen.CPUCodeLibrary._optimize_functions",
        "numba.core.codegen.CPUCodeLibrary._optimize_final_module",
    ]


def test_machine_code_is_that_of_numba_alone(frame, monkeypatch):
    plain_code, (plain_out, *plain_rest) = compiled(*frame)
    assert len(plain_code.splitlines()) > 200
    assert plain_rest[-1] == _steps_to_one.py_func(27) == (111, 8)
    with shortcuts():
        _, (out, *rest) = compiled(*frame)
    assert np.array_equal(out, plain_out, equal_nan=True)
    assert rest == plain_rest
    monkeypatch.setattr(compiler, "SAME_RESULTS", ())
    with shortcuts():
        code, _ = compiled(*frame)
    assert code == plain_code


def _ends(window, row):
    """A view of a view, negative indices, named tuples in and out; no array is made."""
    line = window.pixels[row]
    inner = Window(window.pixels[row : row + 1, 1:-1], window.half)
    return inner.pixels[0, 0], inner.pixels[-1, -1], line[-1], line[inner.half]


def _moved(values):
    values[1:] = values[:-1]


def _kept(window):
    return window.pixels[1:], Window(window.pixels, 1)


def _chosen(values, wanted):
    return values[wanted].sum()


def _lengths(columns):
    """Sums of squares; a row of it is not contiguous, and NumPy copies it."""
    return np.dot(columns[:, 0], columns[:, 0])


def _solution(matrix, right):
    found = np.linalg.solve(matrix, right)
    return found[0], [2.0 * number for number in found]


@pytest.mark.filterwarnings("ignore::numba.core.errors.NumbaPerformanceWarning")
def test_what_makes_arrays_or_lists_within_is_compiled_too():
    columns = np.arange(8.0).reshape(4, 2)
    with shortcuts():
        assert njit(_lengths)(columns) == 56.0
        first, found = njit(_solution)(np.diag([2.0, 4.0]), np.array([1.0, 1.0]))
    assert (first, found) == (0.5, [1.0, 0.5])


@pytest.mark.parametrize("layout", ["C", "F", "A"])
def test_arrays_of_the_caller_outlive_kernels(layout):
    """References are counted where a kernel makes, copies or returns an array, and held by the caller where not."""
    pixels = np.asfortranarray(np.arange(24.0).reshape(4, 6)) if layout == "F" else np.arange(24.0).reshape(4, 6)
    pixels = np.repeat(pixels, 2, axis=1)[:, ::2] if layout == "A" else pixels
    window, row, wanted = Window(pixels, 2), np.arange(6.0), np.array([0, 2])
    with shortcuts():
        ends, moved, kept, chosen = (njit(function) for function in (_ends, _moved, _kept, _chosen))
        counts = None
        for _ in range(3):
            assert ends(window, 1) == (7.0, 10.0, 11.0, 8.0)
            line = row.copy()
            moved(line)
            assert line.tolist() == [0.0, 0.0, 1.0, 2.0, 3.0, 4.0]
            assert chosen(row, wanted) == 2.0
            below, same = kept(window)
            assert np.array_equal(below, pixels[1:])
            assert np.array_equal(same.pixels, pixels)
            del below, same
            now = [sys.getrefcount(array) for array in (pixels, row, wanted)]
            assert counts in (None, now)
            counts = now
    assert ["NRT_incref" in code for f in (ends, kept) for code in f.inspect_llvm().values()] == [False, True]


def _growing(n):
    """A variable whose type is known to the end only after the loop was typed twice."""
    first = second = third = 1
    for _ in range(n):
        first, second, third = second, third, 0.5 * first
    return first, second, third


def _untyped(image):
    return image.no_such_name + 1


def test_types_that_change_in_loops_and_errors_are_numbas():
    expected = njit(_growing)(7)
    with pytest.raises(TypingError) as plain:
        njit(_untyped)(np.zeros(3))
    with shortcuts():
        assert njit(_growing)(7) == expected == _growing(7)
        with pytest.raises(TypingError) as ours:
            njit(_untyped)(np.zeros(3))
    assert str(ours.value) == str(plain.value)


def _halved(values):
    for n in range(len(values)):
        values[n] *= 0.5


@pytest.mark.parametrize("vectorised", [False, True])
def test_loops_use_vector_instructions_only_if_asked(vectorised):
    function, values = njit(_halved), np.arange(1001.0)
    expected = 0.5 * values
    with shortcuts(vectorised):
        function(values)
    assert np.array_equal(values, expected)
    (code,) = function.inspect_llvm().values()
    assert bool(re.search(r"fmul <\d+ x double>", code)) == vectorised


def test_kernels_of_a_vectorised_kernel_are_compiled_as_they_ask():
    """The option of a kernel compiled within another is its own."""
    values = np.arange(1001.0)
    with shortcuts(True):
        with shortcuts(False):
            few = njit(_halved)
            few(values)
        many = njit(_halved)
        many(values)
    found = [bool(re.search(r"fmul <\d+ x double>", code)) for f in (few, many) for code in f.inspect_llvm().values()]
    assert found == [False, True]


def _windows(pixels):
    return Window(pixels, 3), np.zeros(2), pixels


def test_classes_of_results_are_those_of_numba_alone(frame):
    alone, function = njit(_windows), njit(_windows)
    alone(frame[0])
    with shortcuts():
        for _ in range(3):
            window, made, pixels = function(frame[0])
            assert type(window) is Window
            assert type(made) is np.ndarray
            assert window.pixels is pixels is frame[0]
    lookups = [
        sum(code.count("call ptr @numba_unpickle") for code in f.inspect_llvm().values()) for f in (alone, function)
    ]
    assert lookups[0] - lookups[1] == 4


@njit
def _declared_late(number):
    return _late(number)


def _late(number):
    return -number


def test_functions_declared_between_two_kernels_are_known(frame):
    """An overload that is declared after kernels have been compiled."""
    with shortcuts():
        compiled(*frame)

        @overload(_late)
        def _late_compiled(number):
            return lambda number: 2 * number

        assert _declared_late(21) == 42


def numba_now():
    return [vars(owner).get(name) for owner, name, _ in (*SAME_CODE, *SAME_RESULTS)]


def test_numba_is_as_before_after_the_outermost_context():
    before = numba_now()
    with contextlib.suppress(KeyError), shortcuts():
        with shortcuts():
            pass
        assert not any(now is then for now, then in zip(numba_now(), before, strict=True))
        raise KeyError
    assert numba_now() == before


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
