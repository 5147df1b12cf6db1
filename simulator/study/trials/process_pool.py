"""Blocks of trials on processes of this machine; if a process dies, only the time of its blocks is lost."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from simulator.constants import GARBAGE_THRESHOLDS
from simulator.scenario import Scenario
from simulator.study.results_folder import refuse_other_files, scenario_sha256
from simulator.study.trials.blocks import MAX_ATTEMPTS, Blocks, Result, run_block
from simulator.study.trials.stopping import no_interrupt_for_children
from simulator.study.trials.trial import TrialRunner
from simulator.study.trials.warm_up import warm_up
from startracker.errors import BoresightError

STOP_CHECK_S = 0.2
"""Seconds between checks for a stop."""

_local = threading.local()


class WorkerPool:
    """Local processes that run blocks of trials of successive scenarios; started when first needed.

    Parameters
    ----------
    workers : int
        How many.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._executor: ProcessPoolExecutor | None = None

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def submit(self, scenario: Scenario, key: str, block: range) -> Future[Result]:
        """Submit a block to the next free process; `key` identifies the scenario."""
        if self._executor is None:
            self._executor = ProcessPoolExecutor(self.workers, get_context("spawn"), initializer=start_worker)
        return self._executor.submit(_run_block, scenario, key, block)

    def close(self) -> None:
        """End the processes after their current blocks; the next block starts new ones."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)
            self._executor = None


def run_in_pool(
    scenario: Scenario, blocks: Blocks, pool: WorkerPool, stop: threading.Event
) -> Generator[Result, None, None]:
    """Finished blocks in order of completion, with only a few submitted at a time to limit memory.

    On a stop blocks that have not been started are dropped, and the others are awaited briefly. If a worker dies, its
    blocks are run again by new processes.

    Raises
    ------
    InputError
        Errors of the scenario reported by a worker.
    BoresightError
        If workers die repeatedly with the same block.
    """
    key = scenario_sha256(scenario)
    warm_up(scenario)
    while blocks and not stop.is_set():
        pending: dict[Future[Result], range] = {}
        try:
            while blocks or pending:
                if stop.is_set():
                    blocks.drop()
                    pending = {future: block for future, block in pending.items() if not future.cancel()}
                with no_interrupt_for_children():
                    while blocks and len(pending) < 2 * pool.workers:
                        block = blocks.take()
                        try:
                            pending[pool.submit(scenario, key, block)] = block
                        except BrokenProcessPool:
                            pending[Future()] = block
                            raise
                ready, _ = wait(pending, timeout=STOP_CHECK_S, return_when=FIRST_COMPLETED)
                for future in ready:
                    result = future.result()
                    blocks.finished(result)
                    del pending[future]
                    yield result
        except BrokenProcessPool:
            pool.close()
            if not blocks.give_back(sorted(pending.values(), key=lambda block: block.start)):
                raise BoresightError(
                    f"the worker processes died {MAX_ATTEMPTS} times with the same trials (out of memory?); the "
                    "finished trials are kept: run again with --resume and fewer --workers"
                ) from None
        finally:
            for future in pending:  # of an earlier end, no longer awaited
                future.cancel()


def start_worker() -> None:
    """Prepare a worker process: Ctrl-C is the parent's affair, and the worker ends with it."""
    gc.set_threshold(*GARBAGE_THRESHOLDS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _run_block(scenario: Scenario, key: str, block: range) -> Result:
    """In a worker: common data of a scenario is built once; only the last one is kept."""
    if getattr(_local, "key", None) != key:
        runner = TrialRunner(scenario)
        refuse_other_files(scenario, key)
        _local.runner, _local.key = runner, key
    return run_block(_local.runner.run, block)


def _end_with_parent() -> None:
    """End this worker if its parent is killed, which would otherwise leave it waiting forever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
