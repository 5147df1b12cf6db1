"""Compilation of kernels on two cores: beside the first trial, another process solves a list of stars.

The list needs the kernels that a trial uses last, and each kernel is compiled by the process that needs it first; the
other loads it from disk (`startracker.kernels`).
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator

from simulator.scenario import Scenario
from simulator.study.trials.stopping import no_interrupt_for_children
from simulator.study.trials.trial import TrialRunner, build_tracker
from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.errors import BoresightError
from startracker.kernels import is_compiled

_TASK = "run"
_ORION_RA_DEG, _ORION_DEC_DEG = 83.0, 0.0


def warm_up(scenario: Scenario) -> None:
    """Compile the kernels needed by the trials of a scenario, unless compiled earlier.

    Once, on two cores, instead of in every worker.
    """
    if is_compiled(_TASK):
        return
    runner = TrialRunner(scenario)
    with compiling_beside(runner), contextlib.suppress(BoresightError):  # errors are reported by the trials themselves
        runner.run(0)


@contextlib.contextmanager
def compiling_beside(runner: TrialRunner) -> Iterator[None]:
    """Within this context another process compiles kernels of the trials, unless they are compiled or it has no core.

    The process ends with the context. It is an aid only: without it, or if it is killed, this process compiles all
    kernels.
    """
    if is_compiled(_TASK) or _cores() < 2:
        yield
        return
    command = [sys.executable, "-c", "from simulator.study.trials.warm_up import solve_field; solve_field()"]
    nowhere = subprocess.DEVNULL
    with no_interrupt_for_children():
        beside = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere)
    assert beside.stdin is not None
    try:
        with contextlib.suppress(OSError), beside.stdin as sent:  # a process that has been killed reads nothing
            pickle.dump((runner.scenario, runner.renderer.camera), sent)
        yield
    finally:
        beside.terminate()
        beside.wait()


def _cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def solve_field() -> None:
    """In the other process: solve the stars of the catalogue around the centre of Orion, for the scenario and the
    camera on standard input."""
    scenario: Scenario
    camera: Camera
    scenario, camera = pickle.load(sys.stdin.buffer)
    tracker = build_tracker(scenario, camera)
    matrix = Attitude.from_radec_roll(_ORION_RA_DEG, _ORION_DEC_DEG).as_matrix()
    index, _, xy = tracker.guide.in_field(matrix)
    tracker.solve_centroids(xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index]), sigma_px=0.1)
