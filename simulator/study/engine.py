"""The Monte Carlo engine: blocks of trials on any number of processes, kept as they come.

Every block of finished trials is written at once to a folder of its own beside the results, so that an interrupt, a
kill or a full disk costs no finished block; `resume` goes on from there. The rows depend on (scenario, seed, index)
alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from types import FrameType
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from simulator.paths import make_folder, write_atomically
from simulator.scenario import Scenario
from simulator.study.trial import TrialRunner
from startracker._version import __version__
from startracker.errors import BoresightError, InputError

BLOCK_TRIALS = 20
PARTS_FOLDER = ".trials-parts"
MAX_POOL_RESTARTS = 3
STOP_CHECK_S = 0.2

Progress = Callable[[int, int], None]
"""Called with (trials finished, trials in all)."""


@dataclass(frozen=True, eq=False)
class Trials:
    """Finished trials, by index.

    Parameters
    ----------
    table : pyarrow.Table
        A row a trial.
    requested : int
        Trials asked for.
    interrupted : bool
        Whether the run was stopped before all were done.
    """

    table: pa.Table
    requested: int
    interrupted: bool


def run_trials(
    scenario: Scenario,
    trials: int,
    *,
    workers: int = 1,
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
    folder : Path, optional
        Where finished blocks are kept until the results are written.
    resume : bool
        Take over the finished blocks that an earlier run of the *same* scenario left in `folder`.
    progress : callable, optional
        Told after every block.

    Raises
    ------
    InputError
        For no trials, no workers, or a resume from another scenario's trials.
    """
    if trials < 1:
        raise InputError(f"trials: must be at least 1, not {trials}")
    if workers < 1:
        raise InputError(f"workers: must be at least 1, not {workers}")
    store = _Store(scenario, folder, resume)
    blocks = [range(start, min(start + BLOCK_TRIALS, trials)) for start in range(0, trials, BLOCK_TRIALS)]
    todo = [block for block in blocks if not store.has(block)]
    done = sum(len(block) for block in blocks) - sum(len(block) for block in todo)
    if progress:
        progress(done, trials)
    with _stop_on_signal() as stop:
        results = _run_here(scenario, todo, stop) if workers == 1 else _run_in_pool(scenario, todo, workers, stop)
        with contextlib.closing(results):
            for block, table in results:
                store.put(block, table)
                done += table.num_rows
                if progress:
                    progress(done, trials)
        interrupted = stop.is_set() and done < trials
    return Trials(store.collect(trials), trials, interrupted)


def discard_parts(folder: Path) -> None:
    """Remove the blocks of a finished run, once its results stand in their place."""
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)


Result = tuple[range, pa.Table]


def _run_here(scenario: Scenario, blocks: list[range], stop: threading.Event) -> Generator[Result, None, None]:
    """Trials in this process; a stop ends after the trial under way, and keeps what its block has."""
    runner = TrialRunner(scenario)
    for block in blocks:
        rows: list[dict[str, Any]] = []
        for index in block:
            if stop.is_set():
                break
            rows.append(runner.run(index))
        if rows:
            yield range(block.start, block.start + len(rows)), pa.Table.from_pylist(rows)
        if stop.is_set():
            return


_runner: TrialRunner | None = None


def _start_worker(scenario: Scenario) -> None:
    global _runner  # noqa: PLW0603 - one runner a process is what a worker is
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _runner = TrialRunner(scenario)


def _run_block(block: range) -> pa.Table:
    assert _runner is not None
    return pa.Table.from_pylist([_runner.run(index) for index in block])


def _run_in_pool(
    scenario: Scenario, blocks: list[range], workers: int, stop: threading.Event
) -> Generator[Result, None, None]:
    """Trials in processes of their own, only a few blocks under way at a time, so that memory stays flat.

    A stop drops the blocks that no worker has begun and waits, a moment, for the others. When a worker dies its blocks
    are run again by a new pool.
    """
    waiting = deque(blocks)
    restarts = 0
    while waiting and not stop.is_set():
        pending: dict[Future[pa.Table], range] = {}
        pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker, initargs=(scenario,))
        try:
            while waiting or pending:
                if stop.is_set():
                    waiting.clear()
                    pending = {future: block for future, block in pending.items() if not future.cancel()}
                with _no_interrupt_for_children():
                    while waiting and len(pending) < 2 * workers:
                        pending[pool.submit(_run_block, waiting[0])] = waiting[0]
                        waiting.popleft()
                ready, _ = wait(pending, timeout=STOP_CHECK_S, return_when=FIRST_COMPLETED)
                for future in ready:
                    table = future.result()
                    yield pending.pop(future), table
        except BrokenProcessPool:
            restarts += 1
            if restarts > MAX_POOL_RESTARTS:
                raise BoresightError(
                    f"the worker processes died {restarts} times (out of memory?); the finished trials are kept: "
                    "run again with --resume and fewer --workers"
                ) from None
            waiting.extendleft(sorted(pending.values(), key=lambda block: -block.start))
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _no_interrupt_for_children() -> Iterator[None]:
    """Processes started within ignore Ctrl-C from their first instruction on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _stop_on_signal() -> Iterator[threading.Event]:
    """Event that Ctrl-C, or a polite kill, sets; a second Ctrl-C interrupts at once.

    An exception raised wherever the signal happens to arrive could come out of compiled code as something else.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Store:
    """Finished blocks: in memory, and where a folder is given as one Parquet file each."""

    def __init__(self, scenario: Scenario, folder: Path | None, resume: bool) -> None:
        self.tables: dict[tuple[int, int], pa.Table] = {}
        self.folder = folder / PARTS_FOLDER if folder else None
        if self.folder is None:
            return
        # more trials of the same scenario may join those that are done
        same = scenario.with_values(trials=1).fingerprint()
        key = hashlib.sha256(f"{__version__}\n{same}".encode()).hexdigest()
        key_file = self.folder / "scenario.sha256"
        if resume and key_file.exists():
            if key_file.read_text(encoding="utf-8") != key:
                raise InputError(
                    f"{folder}: its unfinished trials are of another scenario, seed or version; "
                    "run without --resume, or choose another --out"
                )
            self._load()
            return
        shutil.rmtree(self.folder, ignore_errors=True)
        make_folder(self.folder)
        write_atomically(key_file, key)

    def _load(self) -> None:
        assert self.folder is not None
        for path in sorted(self.folder.glob("*.parquet")):
            start, stop = (int(part) for part in path.stem.split("-"))
            self.tables[start, stop] = pq.read_table(path)

    def has(self, block: range) -> bool:
        return (block.start, block.stop) in self.tables

    def put(self, block: range, table: pa.Table) -> None:
        self.tables[block.start, block.stop] = table
        if self.folder is not None:
            sink = pa.BufferOutputStream()
            pq.write_table(table, sink)
            write_atomically(self.folder / f"{block.start:09d}-{block.stop:09d}.parquet", sink.getvalue().to_pybytes())

    def collect(self, trials: int) -> pa.Table:
        if not self.tables:
            return pa.table({"index": pa.array([], pa.int64())})
        table = pa.concat_tables([self.tables[key] for key in sorted(self.tables)], promote_options="permissive")
        # an interrupted block and its completed twin may both be there after a resume
        keep = pc.less(table["index"], trials)
        table = table.filter(keep).sort_by("index")
        index = table["index"].to_numpy()
        first = [True, *(index[1:] != index[:-1])] if len(index) else []
        return table.filter(pa.array(first, pa.bool_())).combine_chunks()
