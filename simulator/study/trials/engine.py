"""Monte Carlo engine: trials in this process, in local processes or on a cluster, stored as they finish.

Every finished block is written at once to a separate folder, so that no finished block is lost on an interrupt, a kill
or a full disk: the next run of the scenario continues from there. The rows depend only on (scenario, seed, index).
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pyarrow as pa

from simulator.scenario import Scenario
from simulator.study.trials.blocks import Blocks, Result, run_block
from simulator.study.trials.parts import PartStore, discard_parts
from simulator.study.trials.process_pool import WorkerPool, run_in_pool
from simulator.study.trials.stopping import stop_on_signal
from simulator.study.trials.trial import TrialRunner
from startracker.errors import BoresightError, InputError

__all__ = ["Progress", "Trials", "discard_parts", "run_trials"]

Progress = Callable[[int, int], None]
"""Called with (trials finished, total trials)."""

MAX_ROUNDS = 3
"""Maximum number of attempts for trials whose stored parts are damaged."""


@dataclass(frozen=True, eq=False)
class Trials:
    """Finished trials, by index."""

    store: PartStore
    """Store of the trials."""
    finished: int
    """Number of trials."""
    taken_over: int
    """Number of trials reused from an earlier run."""
    requested: int
    """Requested number of trials."""
    interrupted: bool
    """Whether the run was stopped before all were done."""
    workers: int
    """Number of processes, or of threads of the cluster."""
    runner: TrialRunner | None = None
    """Runner of the trials, if run in this process."""

    @cached_property
    def table(self) -> pa.Table:
        """One row per trial, in memory."""
        return self.store.table(self.requested)


def run_trials(
    scenario: Scenario,
    trials: int,
    *,
    workers: int | WorkerPool = 1,
    dask: str | None = None,
    folder: Path | None = None,
    resume: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Trials:
    """Run trials 0 … `trials` − 1 of a scenario.

    Parameters
    ----------
    scenario : Scenario
        The scenario, including the seed.
    trials : int
        Number of trials, at least 1.
    workers : int or WorkerPool
        Number of processes, or an existing pool; 1 runs in this process.
    dask : str, optional
        Address of a dask.distributed scheduler; the trials run on its workers instead.
    folder : Path, optional
        Folder of finished blocks until the results are written; None: in memory. Blocks of an unfinished run of the
        same scenario are reused.
    resume : bool
        Also reuse the trials of a finished run.
    force : bool
        Discard the trials of an unfinished run in `folder`.
    progress : callable, optional
        Called after every block.

    Raises
    ------
    InputError
        For no trials, no workers, no cluster, a full disk, or unfinished trials of another scenario in `folder`.
    BoresightError
        If workers die repeatedly, finished trials are damaged repeatedly, or the cluster is lost.
    """
    if trials < 1:
        raise InputError(f"trials: must be at least 1, not {trials}")
    processes = workers if isinstance(workers, int) else workers.workers
    if processes < 1:
        raise InputError(f"workers: must be at least 1, not {processes}")
    store = PartStore(scenario, folder, resume, force)
    store.refuse_fewer(trials)
    taken_over = trials - sum(map(len, store.missing(trials)))
    runner = None
    with stop_on_signal() as stop:
        for _ in range(MAX_ROUNDS):
            blocks = Blocks(store.missing(trials), processes)
            if progress:
                progress(trials - blocks.left, trials)
            here = dask is None and blocks.workers == 1
            if here and blocks and runner is None:
                runner = TrialRunner(scenario)
            found = _run_here(runner, blocks, stop) if here else _run_elsewhere(scenario, blocks, dask, workers, stop)
            _keep(store, found, trials - blocks.left, trials, progress)
            if store.check() or stop.is_set():
                break
        else:
            raise BoresightError(
                f"{store.notes[-1]}: finished trials were damaged {MAX_ROUNDS} times; is the disk failing? choose "
                "another --out"
            )
        finished = trials - sum(map(len, store.missing(trials)))
        interrupted = stop.is_set() and finished < trials
    return Trials(store, finished, min(taken_over, finished), trials, interrupted, blocks.workers, runner)


def _keep(
    store: PartStore, found: Generator[Result, None, None], done: int, trials: int, progress: Progress | None
) -> None:
    """Store blocks as they finish."""
    with contextlib.closing(found) as results:
        for result in results:
            store.put(result.block, result.table)
            done += len(result.block)
            if progress:
                progress(done, trials)


def _run_elsewhere(
    scenario: Scenario, blocks: Blocks, dask: str | None, workers: int | WorkerPool, stop: threading.Event
) -> Generator[Result, None, None]:
    if dask is not None:
        from simulator.study.trials.dask_pool import run_on_cluster

        yield from run_on_cluster(scenario, blocks, dask, stop)
    elif isinstance(workers, int):
        with WorkerPool(workers) as pool:
            yield from run_in_pool(scenario, blocks, pool, stop)
    else:
        yield from run_in_pool(scenario, blocks, workers, stop)


def _run_here(runner: TrialRunner | None, blocks: Blocks, stop: threading.Event) -> Generator[Result, None, None]:
    """Trials in this process; a stop takes effect after the current trial, and its block is kept."""
    while runner and blocks and not stop.is_set():
        result = run_block(runner.run, blocks.take(), stop.is_set)
        if result.block:
            blocks.finished(result)
            yield result
