"""Tasks of a datasheet: pieces of the simulation that run in any order on any number of processes.

A task is a kind of frames with a scenario and arguments; its result only depends on these. Finished tasks are stored at
once, so that an interrupted datasheet continues from them.
"""

from __future__ import annotations

import contextlib
import io
import threading
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from simulator.paths import make_folder, write_atomically
from simulator.scenario import Scenario
from simulator.study.datasheet.frames import DatasheetFrames, sequence_columns
from simulator.study.results_folder import scenario_sha256
from simulator.study.trials.process_pool import STOP_CHECK_S, start_worker
from simulator.study.trials.stopping import no_interrupt_for_children, stop_on_signal
from simulator.study.trials.warm_up import warm_up
from startracker.core import Columns
from startracker.errors import BoresightError

PARTS_FOLDER = ".datasheet-parts"
"""Folder of finished tasks within the folder of the results."""

TRIALS_PER_TASK = 50
"""Trials of a task, about half a second."""

MOST_SCENARIOS = 3
"""Scenarios whose common data a process keeps."""

_UNUSABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)
"""Errors of a damaged file, which is computed again."""

_local = threading.local()


class Interrupted(BoresightError):
    """Stopped by the user; finished tasks are kept."""


class Task(NamedTuple):
    """A piece of the simulation."""

    scenario: Scenario
    """The scenario."""
    method: str
    """A method of `DatasheetFrames`, or ``sequence``."""
    arguments: tuple[Any, ...] = ()
    """Its arguments; their representation identifies them."""

    @property
    def key(self) -> str:
        """Identity of the result: hash of the scenario, its files and the arguments."""
        return scenario_sha256(self.scenario, method=self.method, arguments=self.arguments)[:32]


def trial_tasks(
    scenario: Scenario, count: int, method: str = "trials", *more: Any, per_task: int = TRIALS_PER_TASK
) -> list[Task]:
    """Tasks of the trials 0 … `count` − 1 of a scenario, by a method with the arguments first, count and `more`."""
    return [Task(scenario, method, (first, min(per_task, count - first), *more)) for first in range(0, count, per_task)]


def joined(parts: Sequence[Columns]) -> Columns:
    """Columns of several tasks, one after the other."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def run_task(task: Task) -> Columns:
    """Result of a task; the common data of a few scenarios is kept."""
    if task.method == "sequence":
        return sequence_columns(task.scenario)
    columns: Columns = getattr(_frames_of(task.scenario), task.method)(*task.arguments)
    return columns


def _frames_of(scenario: Scenario) -> DatasheetFrames:
    if not hasattr(_local, "kept"):
        _local.kept = OrderedDict()
    kept: OrderedDict[str, DatasheetFrames] = _local.kept
    key = scenario_sha256(scenario)
    if key not in kept:
        kept[key] = DatasheetFrames(scenario)
        if len(kept) > MOST_SCENARIOS:
            kept.popitem(last=False)
    kept.move_to_end(key)
    return kept[key]


class TaskRunner:
    """Runs tasks on processes of this machine, and keeps their results.

    Parameters
    ----------
    workers : int
        Number of processes; 1 runs in this one.
    folder : Path, optional
        Folder of finished tasks; None: in memory.
    progress : callable, optional
        Called with (finished, known so far) after every task.
    """

    def __init__(
        self, workers: int = 1, folder: Path | None = None, progress: Callable[[int, int], None] | None = None
    ) -> None:
        self.workers = workers
        self.folder = folder
        self.progress = progress
        self.finished = self.known = 0
        self._memory: dict[str, Columns] = {}
        self._pool: ProcessPoolExecutor | None = None
        if folder is not None:
            make_folder(folder)

    def __enter__(self) -> TaskRunner:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def trials(self, scenario: Scenario, count: int, method: str = "trials", *more: Any) -> Columns:
        """Columns of the trials 0 … `count` − 1 (`trial_tasks`)."""
        return joined(self.run(trial_tasks(scenario, count, method, *more)))

    def run(self, tasks: Sequence[Task]) -> list[Columns]:
        """Results of tasks, in their order.

        Raises
        ------
        Interrupted
            After Ctrl-C; the results of finished tasks are kept.
        BoresightError
            If a worker process dies.
        """
        keys = [task.key for task in tasks]
        missing = {key: task for key, task in zip(keys, tasks, strict=True) if not self._known(key)}
        self.known += len(tasks)
        self._count(len(tasks) - len(missing))
        with stop_on_signal() as stop:
            if self.workers == 1 or (len(missing) == 1 and self._pool is None):
                for key, task in missing.items():
                    if stop.is_set():
                        raise Interrupted("interrupted")
                    self._keep(key, run_task(task))
            elif missing:
                self._run_in_pool(missing, stop)
            if stop.is_set():
                raise Interrupted("interrupted")
        return [self._memory[key] for key in keys]

    def _run_in_pool(self, missing: dict[str, Task], stop: threading.Event) -> None:
        if self._pool is None:
            warm_up(next(iter(missing.values())).scenario)
            self._pool = ProcessPoolExecutor(self.workers, get_context("spawn"), initializer=start_worker)
        waiting = list(missing.items())[::-1]
        pending: dict[Future[Columns], str] = {}
        try:
            while pending or (waiting and not stop.is_set()):
                with no_interrupt_for_children():
                    while waiting and len(pending) < 2 * self.workers and not stop.is_set():
                        key, task = waiting.pop()
                        pending[self._pool.submit(run_task, task)] = key
                if stop.is_set():
                    pending = {future: key for future, key in pending.items() if not future.cancel()}
                ready, _ = wait(pending, timeout=STOP_CHECK_S, return_when=FIRST_COMPLETED)
                for future in ready:
                    self._keep(pending.pop(future), future.result())
        except BrokenProcessPool:
            raise BoresightError(
                "a worker process died (out of memory?); the finished tasks are kept: run again with fewer --workers"
            ) from None
        finally:
            for future in pending:
                future.cancel()

    def _keep(self, key: str, columns: Columns) -> None:
        self._memory[key] = columns
        if self.folder is not None:
            stream = io.BytesIO()
            np.savez(stream, allow_pickle=False, **columns)
            write_atomically(self.folder / f"{key}.npz", stream.getvalue())
        self._count(1)

    def _known(self, key: str) -> bool:
        """Whether the result is in memory or, read now, in the folder."""
        if key not in self._memory and self.folder is not None:
            path = self.folder / f"{key}.npz"
            with contextlib.suppress(*_UNUSABLE), path.open("rb") as file, np.load(file) as stored:
                self._memory[key] = {name: stored[name] for name in stored.files}
        return key in self._memory

    def _count(self, number: int) -> None:
        self.finished += number
        if self.progress:
            self.progress(self.finished, self.known)
