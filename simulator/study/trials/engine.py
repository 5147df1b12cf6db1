"""The Monte Carlo engine: trials here, on processes of this machine or on a cluster, kept as they come.

Every block of finished trials is written at once to a folder of its own beside the results, so that an interrupt, a
kill or a full disk costs no finished block; `resume` goes on from there. The rows depend on (scenario, seed, index)
alone.
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
from startracker.errors import InputError

__all__ = ["Progress", "Trials", "discard_parts", "run_trials"]

Progress = Callable[[int, int], None]
"""Called with (trials finished, trials in all)."""


@dataclass(frozen=True, eq=False)
class Trials:
    """Finished trials, by index.

    Parameters
    ----------
    store : PartStore
        Where they are.
    finished : int
        How many there are.
    taken_over : int
        How many of them an earlier run left.
    requested : int
        Trials asked for.
    interrupted : bool
        Whether the run was stopped before all were done.
    workers : int
        Processes, or threads of the cluster, that ran them.
    runner : TrialRunner, optional
        What ran them, where that was this process.
    """

    store: PartStore
    finished: int
    taken_over: int
    requested: int
    interrupted: bool
    workers: int
    runner: TrialRunner | None = None

    @cached_property
    def table(self) -> pa.Table:
        """A row a trial, in memory."""
        return self.store.table(self.requested)


def run_trials(
    scenario: Scenario,
    trials: int,
    *,
    workers: int = 1,
    dask: str | None = None,
    pool: WorkerPool | None = None,
    folder: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Trials:
    """Run trials 0 … `trials` − 1 of a scenario.

    Parameters
    ----------
    scenario : Scenario
        Its seed is the run's.
    trials : int
        Number of trials, at least 1.
    workers : int
        Processes; 1 runs in this one.
    dask : str, optional
        Address of a dask.distributed scheduler; the trials run on its workers instead.
    pool : WorkerPool, optional
        Processes that are there already, in place of new ones.
    folder : Path, optional
        Where finished blocks are kept until the results are written; none: in memory.
    resume : bool
        Take over the finished trials that an earlier run of the *same* scenario left in `folder`.
    progress : callable, optional
        Told after every block.

    Raises
    ------
    InputError
        For no trials, no workers, no cluster, a full disk, or a resume from another scenario's trials.
    BoresightError
        When workers die again and again, or the cluster is gone.
    """
    if trials < 1:
        raise InputError(f"trials: must be at least 1, not {trials}")
    if workers < 1:
        raise InputError(f"workers: must be at least 1, not {workers}")
    store = PartStore(scenario, folder, resume)
    blocks = Blocks(store.missing(trials), pool.workers if pool else workers)
    done = taken_over = trials - blocks.left
    if progress:
        progress(done, trials)
    with stop_on_signal() as stop:
        here = dask is None and blocks.workers == 1
        runner = TrialRunner(scenario) if here and blocks else None
        found = _run_here(runner, blocks, stop) if here else _run_elsewhere(scenario, blocks, dask, pool, stop)
        with contextlib.closing(found) as results:
            for result in results:
                store.put(result.block, result.table)
                done += len(result.block)
                if progress:
                    progress(done, trials)
        interrupted = stop.is_set() and done < trials
    return Trials(store, done, taken_over, trials, interrupted, blocks.workers, runner)


def _run_elsewhere(
    scenario: Scenario, blocks: Blocks, dask: str | None, pool: WorkerPool | None, stop: threading.Event
) -> Generator[Result, None, None]:
    if dask is not None:
        from simulator.study.trials.dask_pool import run_on_cluster

        return run_on_cluster(scenario, blocks, dask, stop)
    return run_in_pool(scenario, blocks, pool, stop) if pool else _run_in_own_pool(scenario, blocks, stop)


def _run_in_own_pool(scenario: Scenario, blocks: Blocks, stop: threading.Event) -> Generator[Result, None, None]:
    with WorkerPool(blocks.workers) as pool:
        yield from run_in_pool(scenario, blocks, pool, stop)


def _run_here(runner: TrialRunner | None, blocks: Blocks, stop: threading.Event) -> Generator[Result, None, None]:
    """Trials in this process; a stop ends after the trial under way, and keeps what its block has."""
    while runner and blocks and not stop.is_set():
        result = run_block(runner.run, blocks.take(), stop.is_set)
        if result.block:
            blocks.finished(result)
            yield result
