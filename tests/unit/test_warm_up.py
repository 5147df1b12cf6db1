"""Compilation before worker processes start."""

import pytest

from simulator import Scenario
from simulator.study.trials import trial, warm_up
from startracker.errors import InputError


@pytest.fixture
def trials(monkeypatch):
    """What is prepared, and the numbers of the trials that are run, each of which fails."""
    run = []

    class Runner:
        def __init__(self, scenario):
            run.append("prepared")

        def run(self, number):
            run.append(number)
            raise InputError("for the worker to report")

    monkeypatch.setattr(trial, "TrialRunner", Runner)
    return run


@pytest.mark.parametrize(
    ("compiled", "engine", "expected"),
    [
        (True, "reference", []),
        (False, "reference", ["prepared", 0]),
        (True, "flight", ["prepared"]),  # which compiles the flight build
        (False, "flight", ["prepared", 0]),
    ],
)
def test_a_trial_is_run_unless_its_last_kernel_is_on_disk(monkeypatch, trials, compiled, engine, expected):
    monkeypatch.setattr(warm_up, "is_on_disk", lambda kernel: compiled)
    warm_up.warm_up(Scenario.load("cubesat", [f"tracker.engine={engine}"]))
    assert trials == expected
