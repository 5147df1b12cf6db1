"""``boresight warm-up``: its rounds, what a task counts, processes that die, and Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import pytest

from simulator.cli import warm_up_command
from simulator.cli.warm_up_command import run_task, warm_up
from simulator.scenario.files import included_scenarios
from startracker._compiled import compile_time
from startracker.errors import BoresightError, InputError


class Pool(ThreadPoolExecutor):
    """Threads in place of processes."""

    def __init__(self, workers, context, initializer):
        super().__init__(workers)


@pytest.fixture
def tasks(monkeypatch):
    """Tasks that were run, one after the other, each of which compiles two kernels."""
    done = []
    monkeypatch.setattr(warm_up_command, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(warm_up_command, "available_cores", lambda: 1)
    monkeypatch.setattr(warm_up_command, "run_task", lambda task: done.append(task) or 2)
    return done


def test_every_included_scenario_is_run_once_after_what_needs_few_kernels(tasks, capsys):
    assert warm_up() == 0
    assert tasks[:4] == ["list", "frame", "cubesat", "photograph"]
    assert sorted(tasks[2:]) == sorted(["photograph", *included_scenarios()])
    assert f"{2 * len(tasks)} kernels compiled in " in capsys.readouterr().out


def test_with_nothing_to_compile_it_says_so(tasks, monkeypatch, capsys):
    monkeypatch.setattr(warm_up_command, "run_task", lambda task: 0)
    warm_up()
    assert capsys.readouterr().out == "all kernels are compiled\n"


@pytest.mark.parametrize("error", [None, InputError])
def test_a_task_counts_the_kernels_that_it_compiles_and_may_fail(monkeypatch, error):
    def solve():
        compile_time.count += 3
        if error:
            raise error("no such file")

    monkeypatch.setattr(warm_up_command, "_solve_list", solve)
    assert run_task("list") == 3


def test_a_process_that_dies_is_one_line(tasks, monkeypatch):
    def submit(self, function, task):
        raise BrokenProcessPool

    monkeypatch.setattr(Pool, "submit", submit)
    with pytest.raises(BoresightError, match="run boresight warm-up again"):
        warm_up()


def is_alive(group):
    """Whether any process of a group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.system
def test_an_interrupt_ends_it_and_its_processes(tmp_path):
    """With an empty cache its first round takes minutes, which Ctrl-C of a terminal, sent to all processes, ends."""
    process = subprocess.Popen(
        [sys.executable, "-m", "simulator.cli", "warm-up"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    while not list(tmp_path.rglob("*.nbi")):  # the first kernel of a worker
        time.sleep(0.1)
        assert process.poll() is None, process.communicate()
    interrupted = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert time.monotonic() - interrupted < 20.0
    assert "Traceback" not in errors
    while is_alive(process.pid) and time.monotonic() - interrupted < 20.0:
        time.sleep(0.1)  # multiprocessing's resource tracker ends after its parent
    assert not is_alive(process.pid)
