"""Progress messages while kernels are compiled: number, total, and remaining time.

This module does not load the compiler, so that a command can announce the compilation before it starts.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

_SILENT_S = 2.0
"""Compile time after which a program other than our commands gets a message."""
_SILENT_IN_FILES_S = 10.0
"""Compile time after which a log file gets a message."""
_LOOK_S = 2.0
"""How often kernels compiled by other processes are counted."""
_CLEAR_LINE = "\r\x1b[K"


class Progress:
    """Counts and times the compilation of kernels, and shows the progress on the terminal.

    Attributes
    ----------
    seconds, processor_s : float
        Compile time so far, wall-clock and CPU.
    """

    def __init__(self) -> None:
        self.seconds = self.processor_s = 0.0
        self._task, self._at_once = "solve", False
        self._depth = self._done = 0
        self._done_weight = 0.0
        self._began = self._processor_began = self._looked_at = 0.0
        self._left: dict[str, float] | None = None
        self._told_file = False

    def announce(self, task: str) -> None:
        """Announce at once that a command compiles; `task` is one of the list of `expected_kernels`."""
        self._task, self._at_once = task, True

    def begin(self, on_disk: Callable[[Iterable[str]], list[str]]) -> None:
        """Start of a kernel; kernels that it calls start within it. `on_disk` gives those of some kernels that are
        compiled."""
        if not self._depth:
            self._began, self._processor_began = time.perf_counter(), time.process_time()
        if self._left is None:
            self._left = dict(expected_kernels(self._task))
            for name in on_disk(self._left):
                del self._left[name]
            self._looked_at = time.perf_counter()
        elif not self._depth and self._began - self._looked_at > _LOOK_S:
            self._looked_at = self._began
            for name in on_disk(self._left):
                self._count(name)
        self._depth += 1
        self._tell()

    def end(self, name: str | None) -> None:
        """End of a kernel; without `name` it is a function of NumPy used by a kernel, which is not counted."""
        self._depth -= 1
        if name is not None and self._left is not None:
            self._count(name)
        if not self._depth:
            self.seconds += time.perf_counter() - self._began
            self.processor_s += time.process_time() - self._processor_began
            if self._shows():
                sys.stderr.write(_CLEAR_LINE)
                sys.stderr.flush()

    def _count(self, name: str) -> None:
        """A kernel that this process has compiled, or another one beside it."""
        assert self._left is not None
        self._done += 1
        self._done_weight += self._left.pop(name, 0.0)

    @property
    def line(self) -> str:
        """Progress line: number of kernels, total, remaining time."""
        left = self._left or {}
        text = f"Compiling kernels, once for this installation: {self._done} of {self._done + max(len(left), 1)}"
        if self._done_weight and left:
            text += f", about {self._elapsed_s() * sum(left.values()) / self._done_weight:.0f} s left"
        return text

    def _elapsed_s(self) -> float:
        return self.seconds + (time.perf_counter() - self._began if self._depth else 0.0)

    def _shows(self) -> bool:
        """Whether the progress line on the terminal is updated."""
        try:
            terminal = sys.stderr.isatty()
        except (AttributeError, ValueError):  # no standard error, or a closed one
            return False
        return terminal and not _in_worker() and (self._at_once or self._elapsed_s() > _SILENT_S)

    def _tell(self) -> None:
        if self._shows():
            sys.stderr.write(f"{_CLEAR_LINE}{self.line}")
            sys.stderr.flush()
        elif self._at_once and not self._told_file and self._elapsed_s() > _SILENT_IN_FILES_S and not _in_worker():
            self._told_file = True
            print(self.line, file=sys.stderr, flush=True)


progress = Progress()
"""Progress of this process."""


@cache
def expected_kernels(task: str) -> dict[str, float]:
    """Kernels compiled by a task, with the measured CPU seconds of each.

    ``python -m benchmarks.cold_start --write`` measures and writes the list.
    """
    lines = (Path(__file__).parent / "kernels.txt").read_text(encoding="utf-8").splitlines()
    rows = [line.split() for line in lines if not line.startswith("#")]
    return {name: float(seconds) for seconds, tasks, name in rows if task in tasks.split(",")}


def _in_worker() -> bool:
    return multiprocessing.parent_process() is not None
