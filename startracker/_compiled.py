"""Kernels: functions compiled by numba on their first use and kept on disk.

Everything here uses numba's documented interface: `numba.njit`, and the events of `numba.core.event`, by which compile
time is measured and announced.
"""

from __future__ import annotations

import contextlib
import hashlib
import multiprocessing
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numba import njit
from numba.core import event

_PACKAGES = ("startracker", "simulator")
_SILENT_S = 0.5
"""Compile time after which the terminal shows it."""
_CLEAR_LINE = "\r\x1b[K"


def kernel(function: Callable[..., Any]) -> Any:
    """Decorator: the function is compiled on its first call, once for each combination of types.

    Division is that of NumPy, which allows loops to use vector instructions. numba has a type for each integer constant
    in a call from another kernel: pass ``np.int64(3)`` where different constants would compile the function again.
    """
    return kernel_with()(function)


def kernel_part(function: Callable[..., Any]) -> Any:
    """Decorator: the function's statements are copied into each kernel that calls it.

    For up to some ten statements: a function of its own takes 0.1 to 0.3 s to compile, and the time for the types of
    a kernel grows with the square of its length.
    """
    return kernel_with(inline="always")(function)


def kernel_with(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator like `kernel`, with additional options of `numba.njit`."""

    def compiled(function: Callable[..., Any]) -> Any:
        # Nothing calls a kernel from C, so the second of numba's two wrappers of each kernel is not compiled.
        dispatcher = njit(cache=True, error_model="numpy", no_cfunc_wrapper=True, **options)(function)
        _remove_stale_files(function, Path(dispatcher.stats.cache_path))
        return dispatcher

    return compiled


_sources: dict[str, str] = {}
"""Digest of the sources of each module with kernels."""


def _remove_stale_files(function: Callable[..., Any], folder: Path) -> None:
    """Delete the compiled kernels of the function's module if what they import has changed.

    numba compares the date of a kernel's own file only. A change in another file, to a kernel that it calls or to a
    constant, would go unnoticed, and a class that is gone would be an error when numba reads its index.
    """
    name = function.__module__
    if name in _sources:  # the first kernel of a module decides for all, as imports precede it
        return
    _sources[name] = digest = _digest(name, function.__globals__)
    stem = Path(function.__code__.co_filename).stem
    stamp = folder / f"{stem}.sources"
    with contextlib.suppress(OSError):
        if not stamp.exists() or stamp.read_text(encoding="ascii") != digest:
            for file in (*folder.glob(f"{stem}.*.nbi"), *folder.glob(f"{stem}.*.nbc")):
                file.unlink(missing_ok=True)
            folder.mkdir(parents=True, exist_ok=True)
            stamp.write_text(digest, encoding="ascii")


def _digest(name: str, variables: dict[str, Any]) -> str:
    """Digest of the files from which a module imports, and of its constants so far."""
    modules, constants = set(), []
    for variable, value in sorted(variables.items()):
        module = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None) or ""
        if module != name and module.partition(".")[0] in (*_PACKAGES, name.partition(".")[0]):
            modules.add(module)
        constants.append(f"{variable}={_constant(value)}")
    states = [f"{module}={_sources.get(module, '')}{_state(module)}" for module in sorted(modules)]
    return hashlib.sha256("\n".join(states + constants).encode()).hexdigest()


def is_on_disk(kernel: Any) -> bool:
    """Whether a kernel has been compiled earlier, for some types."""
    function = kernel.py_func
    stem = Path(function.__code__.co_filename).stem
    return any(Path(kernel.stats.cache_path).glob(f"{stem}.{function.__qualname__}-*.nbi"))


def _constant(value: Any) -> str:
    """Text of a number, an array, or a tuple of these; empty for everything else."""
    if isinstance(value, tuple):
        return ",".join(map(_constant, value))
    if isinstance(value, np.ndarray):
        return value.tobytes().hex()
    return repr(value) if isinstance(value, bool | int | float | np.number) else ""


def _state(module: str) -> str:
    """Size and date of a module's file."""
    found = Path(sys.modules[module].__file__ or "").stat()
    return f"{found.st_size},{found.st_mtime_ns}"


class _CompileTime(event.Listener):  # type: ignore[misc]  # numba has no types
    """Measures the time spent compiling and shows it on the terminal, in one line that is removed in the end.

    numba compiles under a lock, so that events of different threads do not mix; kernels called by a kernel are compiled
    within it.
    """

    def __init__(self) -> None:
        self.seconds = self.processor_s = 0.0
        self._depth = self.count = 0
        self._began = self._processor_began = 0.0

    def on_start(self, seen: event.Event) -> None:
        if not self._depth:
            self._began, self._processor_began = time.perf_counter(), time.process_time()
        self._depth += 1
        self.count += 1
        elapsed_s = self.seconds + time.perf_counter() - self._began
        if elapsed_s > _SILENT_S and _has_terminal():
            line = f"Compiling kernels, once for this installation: {self.count} so far, {elapsed_s:.0f} s"
            print(f"{_CLEAR_LINE}{line}", end="", file=sys.stderr, flush=True)

    def on_end(self, seen: event.Event) -> None:
        self._depth -= 1
        if not self._depth:
            self.seconds += time.perf_counter() - self._began
            self.processor_s += time.process_time() - self._processor_began
            if self.seconds > _SILENT_S and _has_terminal():
                print(_CLEAR_LINE, end="", file=sys.stderr, flush=True)


def _has_terminal() -> bool:
    """Whether this is a process with a terminal, not one of its workers."""
    try:
        return sys.stderr.isatty() and multiprocessing.parent_process() is None
    except (AttributeError, ValueError):  # no standard error, or a closed one
        return False


compile_time = _CompileTime()
"""Compile time of this process."""
event.register("numba:compile", compile_time)


def clock() -> float:
    """Seconds as from `time.perf_counter`, without the time spent compiling kernels."""
    return time.perf_counter() - compile_time.seconds


def processor_clock() -> float:
    """Seconds as from `time.process_time`, without the time spent compiling kernels."""
    return time.process_time() - compile_time.processor_s
