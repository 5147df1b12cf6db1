"""Compilation beside the first trial: an aid that solves what it should, and does no harm when it dies."""

import io
import pickle
import subprocess
import sys
from types import SimpleNamespace

import pytest

from simulator.study.trials import warm_up
from startracker import Camera, StarTracker

RUNNER = SimpleNamespace(tracker=StarTracker(Camera.from_fov(fov_deg=10.0, width=512, height=512)))


def test_its_list_of_stars_is_solved(monkeypatch):
    """A list that is not solved would leave the last kernels of a trial to the first process."""
    solutions = []

    def solve(tracker, *arguments, **named):
        solutions.append(solve_centroids(tracker, *arguments, **named))

    solve_centroids = StarTracker.solve_centroids
    monkeypatch.setattr(StarTracker, "solve_centroids", solve)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(pickle.dumps(RUNNER.tracker))))
    warm_up.solve_field()
    assert [solution.status for solution in solutions] == ["solved"]


@pytest.mark.parametrize("kill", [False, True])
def test_its_process_ends_with_the_context(monkeypatch, kill):
    started = []

    def start(*arguments, **named):
        started.append(popen(*arguments, **named))
        if kill:
            started[0].kill()
        return started[0]

    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(warm_up, "is_compiled", lambda task: False)
    monkeypatch.setattr(warm_up, "_cores", lambda: 2)
    with warm_up.compiling_beside(RUNNER):
        assert len(started) == 1
    assert started[0].returncode is not None


def test_a_tracker_that_cannot_be_sent_is_compiled_by_one_process(monkeypatch):
    monkeypatch.setattr(warm_up, "is_compiled", lambda task: False)
    monkeypatch.setattr(warm_up, "_cores", lambda: 2)
    monkeypatch.setattr(subprocess, "Popen", lambda *arguments, **named: pytest.fail("a process was started"))
    with warm_up.compiling_beside(SimpleNamespace(tracker=lambda: None)):
        pass


@pytest.mark.parametrize(("compiled", "cores"), [(True, 2), (False, 1)])
def test_without_need_or_core_there_is_no_process(monkeypatch, compiled, cores):
    monkeypatch.setattr(subprocess, "Popen", lambda *arguments, **named: pytest.fail("a process was started"))
    monkeypatch.setattr(warm_up, "is_compiled", lambda task: compiled)
    monkeypatch.setattr(warm_up, "_cores", lambda: cores)
    with warm_up.compiling_beside(RUNNER):
        pass
