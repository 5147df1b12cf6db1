"""The Monte Carlo engine: trials here, on processes of this machine or on a cluster, kept as they come.

Every block of finished trials is written at once to a folder of its own beside the results, so that an interrupt, a
kill or a full disk costs no finished block: the next run of the scenario goes on from there. The rows depend on
(scenario, seed, index) alone.
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
"""Called with (trials finished, trials in all)."""

MAX_ROUNDS = 3
"""Times that trials are run whose finished parts are found damaged."""


@dataclass(frozen=True, eq=False)
class Trials:
    """Finished trials, by index."""

    store: PartStore
    """Where they are."""
    finished: int
    """How many there are."""
    taken_over: int
    """How many of them an earlier run left."""
    requested: int
    """Trials asked for."""
    interrupted: bool
    """Whether the run was stopped before all were done."""
    workers: int
    """Processes, or threads of the cluster, that ran them."""
    runner: TrialRunner | None = None
    """What ran them, where that was this process."""

    @cached_property
    def table(self) -> pa.Table:
        """A row a trial, in memory."""
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
        Its seed is the run's.
    trials : int
        Number of trials, at least 1.
    workers : int or WorkerPool
        Processes, or those that are there already; 1 runs in this one.
    dask : str, optional
        Address of a dask.distributed scheduler; the trials run on its workers instead.
    folder : Path, optional
        Where finished blocks are kept until the results are written; none: in memory. Those that an unfinished run of
        the same scenario left there are taken over.
    resume : bool
        Take over the trials of a finished run too.
    force : bool
        Discard what an unfinished run left in `folder`.
    progress : callable, optional
        Called after every block.

    Raises
    ------
    InputError
        For no trials, no workers, no cluster, a full disk, or unfinished trials of another scenario in `folder`.
    BoresightError
        When workers die again and again, finished trials are damaged again and again, or the cluster is gone.
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
    """Keep blocks as they come."""
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
    """Trials in this process; a stop ends after the trial under way, and keeps what its block has."""
    while runner and blocks and not stop.is_set():
        result = run_block(runner.run, blocks.take(), stop.is_set)
        if result.block:
            blocks.finished(result)
            yield result
