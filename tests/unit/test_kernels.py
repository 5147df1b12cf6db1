"""Kernels: compiled once, told about while they are, and not timed; sorting within them."""

import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import startracker
from startracker import compilation
from startracker.compilation import expected_kernels, progress
from startracker.front_end import Clock
from startracker.kernels import kernel
from startracker.sorting import median, order_of, sort

SCRIPT = """
import sys, time
import numpy as np
import startracker
from startracker.compilation import progress
from startracker.kernels import clock, processor_clock
from startracker.sorting import sort
if sys.argv[1:] == ["command"]:
    progress.announce("solve")
left_out_s = lambda: np.array([time.perf_counter() - clock(), time.process_time() - processor_clock()])
before = left_out_s()
sort(np.array([2.0, 1.0]))
print(*(left_out_s() - before))
"""
# compiling `sort` takes 0.04 to 0.1 s, and two readings of one clock differ by some microseconds
COMPILING_S = 0.01


def run_on_terminal(cache: Path, *arguments: str) -> tuple[str, list[float]]:
    """What the script writes to standard error, a terminal, and the times that it prints."""
    controller, terminal = pty.openpty()
    try:
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, *arguments],
            stdout=subprocess.PIPE,
            stderr=terminal,
            check=True,
            env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        )
        os.write(terminal, b"end")  # a read of nothing would wait
        said = b""
        while not said.endswith(b"end"):
            said += os.read(controller, 65536)
    finally:
        os.close(controller)
        os.close(terminal)
    return said[:-3].decode(), [float(word) for word in done.stdout.split()]


def test_a_command_says_at_once_that_it_compiles_and_its_clock_leaves_that_out(tmp_path):
    said, left_out_s = run_on_terminal(tmp_path, "command")
    assert re.search(r"\r\x1b\[KCompiling kernels, once for this installation: 0 of \d+", said)
    assert "\n" not in said
    assert said.endswith("\r\x1b[K")  # the line is gone when the result comes
    assert min(left_out_s) > COMPILING_S
    assert run_on_terminal(tmp_path, "command")[0] == ""  # kept on disk


def test_a_program_is_not_told_of_a_short_wait(tmp_path):
    assert run_on_terminal(tmp_path)[0] == ""


def test_a_log_is_not_told_of_a_short_wait(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SCRIPT, "command"]
    assert subprocess.run(command, capture_output=True, check=True, env=environment).stderr == b""


SIDE_BY_SIDE = """
import sys, time
from pathlib import Path
import numpy as np
from startracker.kernels import clock
from startracker.sorting import sort
print("ready", flush=True)
while not Path(sys.argv[1]).exists():
    time.sleep(0.001)
by_wall, by_clock = time.perf_counter(), clock()
sort(np.array([2.0, 1.0]))
print(sum(sort.stats.cache_misses.values()), time.perf_counter() - by_wall, clock() - by_clock)
"""


def test_of_two_processes_one_compiles_and_the_other_loads(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", SIDE_BY_SIDE, str(tmp_path / "go")]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) for _ in range(2)]
    assert all(process.stdout.readline() == "ready\n" for process in both)
    (tmp_path / "go").touch()
    said = [process.communicate(timeout=120)[0].split() for process in both]
    assert sorted(compiled for compiled, _, _ in said) == ["0", "1"]
    for _, wall_s, clock_s in said:  # waiting for the other process is not a time of a solution either
        assert float(clock_s) < float(wall_s) - COMPILING_S


def test_kernels_of_another_process_are_counted_as_well(monkeypatch):
    monkeypatch.setattr(compilation, "_LOOK_S", 0.0)
    seen = compilation.Progress()
    seen.announce("run")
    expected = list(expected_kernels("run"))
    for compiled in (expected[:10], expected[10:17]):  # by an earlier process, which does not count; beside this one
        seen.begin(lambda names, compiled=compiled: compiled)
        seen.end(None)
    assert f"7 of {len(expected) - 10}" in seen.line


RENAMED = """
from typing import NamedTuple
from startracker.kernels import kernel

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


@pytest.mark.parametrize("task", ["run", "solve"])
def test_most_kernels_that_a_task_expects_are_there(task):
    expected, missing = expected_kernels(task), []
    for name in expected:
        module, _, function = name.partition(":")
        file = Path(startracker.__file__).parent.parent / f"{module.replace('.', '/')}.py"
        source = file.read_text() if file.exists() else ""
        if not re.search(rf"^@(pixel_)?kernel.*\ndef {function}\(", source, re.MULTILINE):
            missing.append(name)
    assert len(expected) > 30  # the list is read; a photograph has 34
    assert len(missing) < 0.2 * len(expected), f"{missing}: python -m benchmarks.cold_start --write lists them anew"


@kernel
def _twice(number):
    return 2 * number


@kernel
def _calls(number):
    return _twice(number) + _twice(3) + _twice(4)


def test_constants_are_no_types_of_their_own():
    assert _calls(1) == 16
    _calls.recompile()  # a kernel that comes from the cache has not compiled those it calls
    assert len(_twice.signatures) == 1


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
    monkeypatch.setattr(progress, "seconds", progress.seconds + 0.05)  # as if all of it had been compiling
    stages.lap("detection")
    total_ms = stages.times_ms()["total"]
    all_but_compiling_ms = (time.perf_counter() - began) * 1e3 - 50.0
    assert 0.0 < stages.laps["detection"] < total_ms < all_but_compiling_ms
