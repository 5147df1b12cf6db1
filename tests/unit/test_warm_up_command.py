"""``boresight warm-up``: its rounds, what a task counts, and processes that die."""

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
    monkeypatch.setattr(warm_up_command, "_cores", lambda: 1)
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
