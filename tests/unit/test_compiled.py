"""Kernels: compiled once, shown on the terminal while they are, and not timed; sorting within them."""

import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from startracker._compiled import compile_time
from startracker.front_end import Clock
from startracker.sorting import median, order_of, sort

SCRIPT = """
import sys, time
import numpy as np
from startracker import _compiled as kernels
from startracker.sorting import sort
kernels._SILENT_S = float(sys.argv[1])
left_out_s = lambda: np.array([time.perf_counter() - kernels.clock(), time.process_time() - kernels.processor_clock()])
before = left_out_s()
sort(np.array([2.0, 1.0]))
print(*(left_out_s() - before), kernels.is_on_disk(sort))
"""
# compiling `sort` takes 0.04 to 0.1 s, and two readings of one clock differ by some microseconds
COMPILING_S = 0.01


def run_on_terminal(cache: Path, silent_s: float) -> tuple[str, list[str]]:
    """What the script writes to standard error, a terminal, and the times that it prints."""
    controller, terminal = pty.openpty()
    try:
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, str(silent_s)],
            stdout=subprocess.PIPE,
            stderr=terminal,
            check=True,
            text=True,
            env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        )
        os.write(terminal, b"end")  # a read of nothing would wait
        said = b""
        while not said.endswith(b"end"):
            said += os.read(controller, 65536)
    finally:
        os.close(controller)
        os.close(terminal)
    return said[:-3].decode(), done.stdout.split()


def test_the_terminal_shows_that_kernels_are_compiled_and_the_clocks_leave_that_out(tmp_path):
    said, (wall_s, processor_s, on_disk) = run_on_terminal(tmp_path, 0.0)
    assert said.startswith("\r\x1b[KCompiling kernels, once for this installation: 1 so far, 0 s")
    assert "\n" not in said
    assert said.endswith("\r\x1b[K")  # the line is gone when the result comes
    assert float(wall_s) > COMPILING_S
    assert float(processor_s) > COMPILING_S
    assert on_disk == "True"
    said, (wall_s, _, _) = run_on_terminal(tmp_path, 0.0)  # kept on disk
    assert said == ""
    assert float(wall_s) < 1e-4  # two readings of one clock


def test_a_short_wait_is_not_shown(tmp_path):
    assert run_on_terminal(tmp_path, 10.0)[0] == ""


def test_a_log_file_is_not_written_to(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SCRIPT, "0"]
    assert subprocess.run(command, capture_output=True, check=True, env=environment).stderr == b""


RENAMED = """
from typing import NamedTuple
from startracker._compiled import kernel

class {name}(NamedTuple):
    value: float

@kernel
def doubled(pair):
    return 2.0 * pair.value

print(doubled({name}(1.5)))
"""


def test_a_cache_that_names_a_class_which_is_gone_is_replaced(tmp_path):
    """numba reads the types in its index before it compares dates: an upgrade in place met an AttributeError."""
    for name in ("Before", "After"):
        (tmp_path / "renamed.py").write_text(RENAMED.format(name=name))
        done = subprocess.run(
            [sys.executable, "-c", "import renamed"],
            cwd=tmp_path, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, capture_output=True, text=True,
        )  # fmt: skip
        assert done.stdout.strip() == "3.0", done.stderr


CALLING = """
from wing.called import {name}
from startracker._compiled import kernel

@kernel
def calling(number):
    return {value}

print(calling(1.0), sum(calling.stats.cache_hits.values()))
"""
CALLED = """
import numpy as np
from startracker._compiled import kernel

FACTOR = {factor}
TABLE = np.array([{factor}])

@kernel
def called(number):
    return {factor} * number
"""


@pytest.mark.parametrize(
    ("name", "value"), [("called", "called(number)"), ("FACTOR", "FACTOR * number"), ("TABLE", "TABLE[0] * number")]
)
def test_a_kernel_notices_a_change_in_another_file(tmp_path, name, value):
    """numba compares the date of the kernel's own file, which stays."""
    (tmp_path / "wing").mkdir()
    (tmp_path / "wing" / "__init__.py").touch()
    (tmp_path / "wing" / "calling.py").write_text(CALLING.format(name=name, value=value))
    said = []
    for factor in ("2.0", "2.0", "3.25"):
        if not said or factor != "2.0":
            (tmp_path / "wing" / "called.py").write_text(CALLED.format(factor=factor))
        done = subprocess.run(
            [sys.executable, "-c", "import wing.calling"],
            cwd=tmp_path, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, capture_output=True, text=True,
        )  # fmt: skip
        said.append(done.stdout.split())
    assert said == [["2.0", "0"], ["2.0", "1"], ["3.25", "0"]]


@settings(deadline=None)  # the first call compiles
@given(arrays(np.int64, st.integers(0, 70), elements=st.integers(-9, 9)))
def test_sort_is_that_of_numpy(values):
    expected = np.sort(values)
    sort(values)
    assert np.array_equal(values, expected)


@settings(deadline=None)
@given(arrays(np.float64, st.integers(1, 40), elements=st.sampled_from([-np.inf, -1.5, 0.0, 0.25, 2.0, np.inf])))
def test_order_is_that_of_a_stable_sort(values):
    order = np.empty(len(values), np.int64)
    order_of(values, order)
    assert np.array_equal(order, np.argsort(values, kind="stable"))


@settings(deadline=None)
@given(arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e6, 1e6) | st.just(np.nan)))
def test_median_is_that_of_numpy(values):
    expected = np.median(values)
    assert median(values) == pytest.approx(expected, nan_ok=True)


def test_times_of_a_solution_leave_the_compiler_out(monkeypatch):
    began = time.perf_counter()
    stages = Clock()
    time.sleep(0.05)
    monkeypatch.setattr(compile_time, "seconds", compile_time.seconds + 0.05)  # as if all of it had been compiling
    stages.lap("detection")
    total_ms = stages.times_ms()["total"]
    all_but_compiling_ms = (time.perf_counter() - began) * 1e3 - 50.0
    assert 0.0 < stages.laps["detection"] < total_ms < all_but_compiling_ms


def test_kernels_have_no_wrapper_for_callers_in_c():
    """Which numba would compile for each of them."""
    assert sort.targetoptions["no_cfunc_wrapper"]


def test_a_command_collects_garbage_less_often_than_python_does():
    """Compiling makes millions of objects, among which Python would search again and again."""
    code = "import gc, sys; sys.argv = ['boresight', '--version']; from simulator.cli import main\n"
    code += "try: main()\nfinally: print(gc.get_threshold()[0])"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert int(ended.stdout.split()[-1]) >= 10_000
