"""``boresight warm-up``: compiles the kernels ahead of their first use, on all cores."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context

from simulator.cli.checks import available_cores
from simulator.study.trials.process_pool import start_worker
from simulator.study.trials.stopping import no_interrupt_for_children
from startracker.errors import BoresightError

_FRAMES = 5
"""Of a sequence: the second is tracked, the others are for what needs several."""
_LIST, _FRAME, _PHOTOGRAPH = "list", "frame", "photograph"


def warm_up() -> int:
    """Solve and simulate what needs most kernels, in one process for each core.

    A kernel is compiled by the process that needs it and loaded from disk by those that need it later. Each round needs
    kernels of the rounds before, and its tasks few of each other's, so that little is compiled twice.

    Returns
    -------
    int
        Exit status: 0, as a task that fails for want of an optional file or package leaves its kernels to their use.
    """
    from simulator.cli.terminal import WorkBar

    began, rounds = time.monotonic(), list(_rounds())
    total, done, compiled = sum(map(len, rounds)), 0, 0
    with (
        WorkBar("Compiling", "tasks", total) as bar,
        ProcessPoolExecutor(available_cores(), get_context("spawn"), initializer=start_worker) as pool,
    ):
        try:
            for tasks in rounds:
                with no_interrupt_for_children():
                    pending = [pool.submit(run_task, task) for task in tasks]
                for finished in as_completed(pending):
                    compiled, done = compiled + finished.result(), done + 1
                    bar.show(done, total)
        except KeyboardInterrupt:
            for process in active_children():  # numba replaces its files whole: what is compiled stays
                process.terminate()
            raise
        except BrokenProcessPool:
            raise BoresightError("a process that compiles died (out of memory?); run boresight warm-up again") from None
    print(
        f"{compiled} kernels compiled in {time.monotonic() - began:.0f} s" if compiled else "all kernels are compiled"
    )
    return 0


def _rounds() -> Iterator[list[str]]:
    from simulator.scenario.files import included_scenarios

    yield [_LIST, _FRAME]
    yield ["cubesat", _PHOTOGRAPH]
    yield [name for name in included_scenarios() if name != "cubesat"]


def run_task(task: str) -> int:
    """In a process: one of the tasks, or the first trial or frames of a scenario; the number of kernels compiled."""
    from startracker._compiled import compile_time

    before = compile_time.count
    with contextlib.suppress(BoresightError):
        {_LIST: _solve_list, _FRAME: _render, _PHOTOGRAPH: _solve_photograph}.get(task, lambda: _simulate(task))()
    return compile_time.count - before


def _solve_list() -> None:
    """The stars around the centre of Orion, and in tracking mode again."""
    from startracker import Attitude, Camera, StarTracker, TrackingSession

    tracker = StarTracker(Camera.from_fov(fov_deg=10.0, width=512, height=512))
    index, _, xy = tracker.guide.in_field(Attitude.from_radec_roll(83.0, 0.0).as_matrix())
    flux = 10.0 ** (-0.4 * tracker.guide.v_mag[index])
    tracker.solve_centroids(xy, flux, sigma_px=0.1)
    session = TrackingSession(tracker)
    for second in range(_FRAMES):
        session.update_centroids(xy, flux, float(second))


def _render() -> None:
    from simulator import render

    render("cubesat")


def _solve_photograph() -> None:
    from startracker import solve_unknown_fov
    from startracker.images.reading import read_image, sample_photo

    photo = read_image(sample_photo())
    solve_unknown_fov(photo.image, saturation_dn=photo.saturation_dn)


def _simulate(name: str) -> None:
    from simulator import Scenario
    from simulator.study.sequence.run import run_sequence
    from simulator.study.trials.trial import TrialRunner

    scenario = Scenario.load(name)
    if scenario.sequence != type(scenario.sequence)():
        run_sequence(scenario.changed({"sequence.frames": _FRAMES}))
    else:
        TrialRunner(scenario).run(0)
