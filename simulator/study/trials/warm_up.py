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
import tempfile
from collections.abc import Iterator
from typing import TYPE_CHECKING

from simulator.study.trials.stopping import no_interrupt_for_children
from startracker.errors import BoresightError
from startracker.geometry.attitude import Attitude
from startracker.kernels import is_compiled

if TYPE_CHECKING:
    from simulator.scenario import Scenario
    from simulator.study.trackers import Tracker
    from simulator.study.trials.trial import TrialRunner
    from startracker.tracker import StarTracker

_TASK = "run"
_ORION_RA_DEG, _ORION_DEC_DEG = 83.0, 0.0


def warm_up(scenario: Scenario) -> None:
    """Compile the kernels needed by the trials of a scenario, and its flight build, unless compiled earlier.

    Once, on two cores, instead of in every worker.
    """
    from simulator.study.trials.trial import TrialRunner

    if is_compiled(_TASK) and scenario.tracker.engine == "reference":
        return
    runner = TrialRunner(scenario)
    if is_compiled(_TASK):
        return
    with compiling_beside(runner), contextlib.suppress(BoresightError):  # errors are reported by the trials themselves
        runner.run(0)


@contextlib.contextmanager
def compiling_beside(runner: TrialRunner) -> Iterator[None]:
    """Within this context another process compiles kernels of the trials, unless they are compiled or it has no core.

    The process ends with the context. It is an aid only: without it, or if it is killed, this process compiles all
    kernels.
    """
    from simulator.study.flight.engine import FlightEngine

    if is_compiled(_TASK) or _cores() < 2 or isinstance(runner.tracker, FlightEngine):
        yield
        return
    beside = _started(runner.tracker)
    try:
        yield
    finally:
        if beside is not None:
            beside.terminate()
            beside.wait()


def _started(tracker: Tracker) -> subprocess.Popen[bytes] | None:
    """The other process; None if there is no room for the file by which it receives the tracker, or a plug-in's
    function cannot be pickled."""
    command = [sys.executable, "-c", "from simulator.study.trials.warm_up import solve_field; solve_field()"]
    nowhere = subprocess.DEVNULL
    errors = OSError, pickle.PicklingError, AttributeError, TypeError
    with contextlib.suppress(*errors), no_interrupt_for_children(), tempfile.TemporaryFile() as given:
        pickle.dump(tracker, given)
        given.seek(0)
        return subprocess.Popen(command, stdin=given, stdout=nowhere, stderr=nowhere)
    return None


def _cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def solve_field() -> None:
    """In the other process, which loads no simulator: the tracker on standard input solves the stars of its catalogue
    around the centre of Orion."""
    tracker: StarTracker = pickle.load(sys.stdin.buffer)
    matrix = Attitude.from_radec_roll(_ORION_RA_DEG, _ORION_DEC_DEG).as_matrix()
    index, _, xy = tracker.guide.in_field(matrix)
    tracker.solve_centroids(xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index]), sigma_px=0.1)
