"""Compilation of kernels, and clocks that exclude the compile time.

Kernels are compiled by numba on first use and cached on disk; `startracker.compilation` shows the progress.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

with contextlib.suppress(ImportError):
    import fcntl

from numba import njit, types
from numba.core import event

from startracker.compilation import expected_kernels, progress
from startracker.compiler import shortcuts

_OPTIONS = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_OURS = ("startracker.", "simulator.")


def kernel(function: Callable[..., Any]) -> Any:
    """Decorator: the function is compiled on its first call, once per combination of types.

    Division is that of NumPy, which allows loops to be vectorised. Unused wrappers for callers in C are omitted, and
    constants in calls from other kernels are treated as any other number: numba would compile the function for each
    constant.
    """
    return _compiled(function)


def kernel_part(function: Callable[..., Any]) -> Any:
    """Decorator: the function is compiled as a part of the kernels that call it, which are few.

    A kernel's machine code contains that of all kernels which it calls, optimised again; a chain of five is compiled
    five times. Parts are compiled once for each call.
    """
    return _compiled(function, inline="always")


def pixel_kernel(function: Callable[..., Any]) -> Any:
    """Decorator like `kernel`, for loops over many numbers such as pixels: they use vector instructions.

    Loops over a few stars are faster without, and compiled sooner.
    """
    return _compiled(function, vectorised=True)


def kernel_with(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator like `pixel_kernel`, with additional options of `numba.njit`."""
    return lambda function: _compiled(function, vectorised=True, **options)


def _compiled(function: Callable[..., Any], vectorised: bool = False, **options: Any) -> Any:
    dispatcher = njit(**_OPTIONS, **options)(function)
    resolve = dispatcher.get_call_template

    def resolve_numbers(arguments: tuple[types.Type, ...], named: dict[str, types.Type]) -> Any:
        plain = {name: types.unliteral(argument) for name, argument in named.items()}
        return resolve(tuple(map(types.unliteral, arguments)), plain)

    dispatcher.get_call_template = resolve_numbers
    compile_now, name = dispatcher.compile, f"{function.__module__}:{function.__qualname__}"

    def compile_once(signature: Any) -> Any:
        with _held(Path(dispatcher.stats.cache_path), name), shortcuts(vectorised):
            try:
                return compile_now(signature)
            except (AttributeError, ImportError):  # the cache names a class of an earlier version, which is gone
                dispatcher._cache.flush()
                return compile_now(signature)

    dispatcher.compile = compile_once
    return dispatcher


@contextmanager
def _held(folder: Path, name: str) -> Iterator[None]:
    """Lock a kernel, so that one process compiles it and the others load it from disk.

    A byte of a file in the cache folder represents the kernel; the lock is released when the process ends. Without file
    locks (Windows, some network drives) several processes may compile the same kernel.
    """
    byte = int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "little")
    file = None
    try:
        file = _lock_file(folder)
        _wait_for_lock(file, byte)
    except (OSError, NameError):
        file = None
    try:
        yield
    finally:
        if file is not None:
            fcntl.lockf(file, fcntl.LOCK_UN, 1, byte)


def _wait_for_lock(file: int, byte: int) -> None:
    """Lock a byte; waiting for the process that compiles the kernel counts as compiling."""
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
        return
    except (BlockingIOError, PermissionError):
        progress.begin(_on_disk)
    try:
        fcntl.lockf(file, fcntl.LOCK_EX, 1, byte)
    finally:
        progress.end(None)


@cache
def _lock_file(folder: Path) -> int:
    """Descriptor of the lock file, open for the lifetime of the process, as closing it would release the locks."""
    folder.mkdir(parents=True, exist_ok=True)
    return os.open(folder / ".compiling", os.O_RDWR | os.O_CREAT)


def clock() -> float:
    """Seconds as from `time.perf_counter`, without the time spent compiling kernels."""
    return time.perf_counter() - progress.seconds


def processor_clock() -> float:
    """Seconds as from `time.process_time`, without the time spent compiling kernels."""
    return time.process_time() - progress.processor_s


class _Listener(event.Listener):  # type: ignore[misc]  # numba has no types
    """Forwards events of the compiler, and suspends garbage collection.

    Its millions of small objects live until a kernel is finished; collecting among them takes a tenth of the time.
    """

    def __init__(self) -> None:
        self._depth, self._collects = 0, False

    def on_start(self, seen: event.Event) -> None:
        if not self._depth:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        progress.begin(_on_disk)

    def on_end(self, seen: event.Event) -> None:
        function = seen.data["dispatcher"].py_func
        ours = function.__module__.startswith(_OURS)
        progress.end(f"{function.__module__}:{function.__qualname__}" if ours else None)
        self._depth -= 1
        if not self._depth and self._collects:
            gc.enable()


def is_compiled(task: str) -> bool:
    """Whether most kernels of a task are on disk, according to `startracker.compilation.expected_kernels`."""
    if task not in _compiled_tasks:
        expected = expected_kernels(task)
        if 2.0 * sum(expected[name] for name in _on_disk(expected)) <= sum(expected.values()):
            return False
        _compiled_tasks.add(task)
    return True


_compiled_tasks: set[str] = set()


def _on_disk(names: Iterable[str]) -> list[str]:
    """Those of the kernels of loaded modules that a process has compiled."""
    listed: dict[Path, set[str]] = {}
    found = []
    for name in names:
        module, _, function = name.partition(":")
        dispatcher = getattr(sys.modules.get(module), function, None)
        if dispatcher is None or not hasattr(dispatcher, "stats"):  # not loaded, or no longer a kernel
            continue
        folder = Path(dispatcher.stats.cache_path)
        if folder not in listed:
            listed[folder] = {file.name.rpartition("-")[0] for file in folder.glob("*.nbi")}
        if f"{module.rpartition('.')[2]}.{function}" in listed[folder]:
            found.append(name)
    return found


event.register("numba:compile", _Listener())
