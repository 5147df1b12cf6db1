"""Compilation of kernels before workers start: once, on two cores, instead of in every worker."""

from __future__ import annotations

import contextlib
from multiprocessing import get_context

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

    Runs a trial and, concurrently in another process, solves a list of stars, which needs the kernels that the trial
    uses last.
    """
    if is_compiled(_TASK):
        return
    runner = TrialRunner(scenario)
    beside = get_context("spawn").Process(target=_solve_field, args=(scenario, runner.renderer.camera), daemon=True)
    with no_interrupt_for_children():
        beside.start()
    try:
        with contextlib.suppress(BoresightError):  # errors are reported by the trials themselves
            runner.run(0)
    finally:
        beside.terminate()
        beside.join()


def _solve_field(scenario: Scenario, camera: Camera) -> None:
    """Solve the stars of the catalogue around the centre of Orion."""
    tracker = build_tracker(scenario, camera)
    matrix = Attitude.from_radec_roll(_ORION_RA_DEG, _ORION_DEC_DEG).as_matrix()
    index, _, xy = tracker.guide.in_field(matrix)
    tracker.solve_centroids(xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index]), sigma_px=0.1)
