"""How functions become compiled kernels, and clocks that leave the wait for it out.

Kernels are compiled by numba on first use and cached on disk; `startracker.compilation` shows the progress.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import IO, Any

with contextlib.suppress(ImportError):
    import fcntl

from numba import njit, types
from numba.core import event

from startracker.compilation import expected_kernels, progress

__all__ = ["clock", "is_compiled", "kernel", "kernel_part", "kernel_with", "processor_clock"]

_OPTIONS = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_OURS = ("startracker.", "simulator.")


def kernel(function: Callable[..., Any]) -> Any:
    """Decorator: the function is compiled when it is first called, once for each combination of types.

    Division is that of NumPy, which lets loops be vectorised. Wrappers for callers in C are left out, for nobody calls
    them, and a constant in a call from another kernel counts as any other number: numba would compile the function for
    each constant.
    """
    return _compiled(function)


def kernel_part(function: Callable[..., Any]) -> Any:
    """Decorator: the function is compiled as a part of the kernels that call it, which are few.

    A kernel's machine code contains that of all kernels which it calls, optimised again; a chain of five is compiled
    five times. Parts are compiled once for each call.
    """
    return _compiled(function, inline="always")


def kernel_with(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator as `kernel`, with more options of `numba.njit`."""
    return lambda function: _compiled(function, **options)


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    dispatcher = njit(**_OPTIONS, **options)(function)
    resolve = dispatcher.get_call_template

    def resolve_numbers(arguments: tuple[types.Type, ...], named: dict[str, types.Type]) -> Any:
        plain = {name: types.unliteral(argument) for name, argument in named.items()}
        return resolve(tuple(map(types.unliteral, arguments)), plain)

    dispatcher.get_call_template = resolve_numbers
    compile_now, name = dispatcher.compile, f"{function.__module__}:{function.__qualname__}"

    def compile_once(signature: Any) -> Any:
        with _held(Path(dispatcher.stats.cache_path), name):
            return compile_now(signature)

    dispatcher.compile = compile_once
    return dispatcher


@contextmanager
def _held(folder: Path, name: str) -> Iterator[None]:
    """Hold a kernel against other processes, so that one compiles it and the others load what it leaves on disk.

    A byte of one file in the folder of the cache stands for the kernel; the system frees it where a process ends.
    Where there are no such locks (Windows, some network drives), several processes may compile the same kernel.
    """
    byte = int.from_bytes(hashlib.sha256(name.encode()).digest()[:7], "little")
    file = None
    try:
        file = _lock_file(folder)
        fcntl.lockf(file, fcntl.LOCK_EX, 1, byte)
    except (OSError, NameError):
        file = None
    try:
        yield
    finally:
        if file is not None:
            fcntl.lockf(file, fcntl.LOCK_UN, 1, byte)


@cache
def _lock_file(folder: Path) -> IO[bytes]:
    """File of the locks, open as long as the process lives: closing it would free them."""
    folder.mkdir(parents=True, exist_ok=True)
    return (folder / ".compiling").open("ab")


def clock() -> float:
    """Seconds as of `time.perf_counter`, which stand still while kernels are compiled."""
    return time.perf_counter() - progress.seconds


def processor_clock() -> float:
    """Seconds as of `time.process_time`, which stand still while kernels are compiled."""
    return time.process_time() - progress.processor_s


class _Listener(event.Listener):  # type: ignore[misc]  # numba has no types
    """Passes on what the compiler says, and spares it the search for garbage.

    Its millions of small objects live until a kernel is done; looking for garbage among them takes a tenth of its time.
    """

    def __init__(self) -> None:
        self._depth, self._collects = 0, False

    def on_start(self, seen: event.Event) -> None:
        if not self._depth:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        progress.begin(_is_on_disk)

    def on_end(self, seen: event.Event) -> None:
        function = seen.data["dispatcher"].py_func
        ours = function.__module__.startswith(_OURS)
        progress.end(f"{function.__module__}:{function.__qualname__}" if ours else None)
        self._depth -= 1
        if not self._depth and self._collects:
            gc.enable()


def is_compiled(task: str) -> bool:
    """Whether most of what a task needs is on disk, by the list of `startracker.compilation.expected_kernels`."""
    expected = expected_kernels(task)
    return 2.0 * sum(s for name, s in expected.items() if _is_on_disk(name)) > sum(expected.values())


def _is_on_disk(name: str) -> bool:
    """Whether a kernel of a loaded module has been compiled by an earlier process."""
    module, _, function = name.partition(":")
    dispatcher = getattr(sys.modules.get(module), function, None)
    if dispatcher is None or not hasattr(dispatcher, "stats"):  # not loaded, or no kernel any more
        return False
    return any(Path(dispatcher.stats.cache_path).glob(f"*.{function}-*.nbi"))


event.register("numba:compile", _Listener())
