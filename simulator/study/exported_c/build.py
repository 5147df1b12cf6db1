"""Compilation and measurement of the exported C: memory, stack, time, instructions.

By the native compiler, or by a cross compiler with an emulator (QEMU user mode), which also counts instructions. Not
required for an export.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from startracker.errors import InputError
from startracker.fixed_point.export_c import CExport

FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
_HEAP = re.compile(r"^_*(malloc|calloc|realloc|free|aligned_alloc|posix_memalign|sbrk)$")


@dataclass(frozen=True)
class Target:
    """Target processor."""

    name: str
    """Description."""
    compiler: str
    size: str = "size"
    symbols: str = "nm"
    """Tool chain: compiler, ``size`` and ``nm``."""
    flags: tuple[str, ...] = ()
    """Compiler options for this processor."""
    runner: tuple[str, ...] = ()
    """Command that runs the program; empty: run directly."""
    counter: tuple[str, ...] = ()
    """The same, printing one line per instruction to standard error; empty: instructions cannot be counted."""

    def missing(self) -> str | None:
        """The first command that is not installed, or None."""
        needed = [self.compiler, self.size, self.symbols, *self.runner[:1]]
        return next((command for command in needed if shutil.which(command) is None), None)


HOST = Target("this machine", "gcc")
M68K = Target(
    "Motorola 68k (CPU32, emulated)",
    "m68k-linux-gnu-gcc",
    "m68k-linux-gnu-size",
    "m68k-linux-gnu-nm",
    ("-mcpu=cpu32",),
    ("qemu-m68k", "-cpu", "m68020"),
    ("qemu-m68k", "-cpu", "m68020", "-singlestep", "-d", "nochain,exec"),
)
"""The MC68360 of Yee 1999 is a CPU32+, whose instructions run on a 68020; Debian: gcc-m68k-linux-gnu, qemu-user."""


def native_compiler() -> Target | None:
    """The native compiler, if there is one."""
    for command in ("gcc", "cc"):
        target = Target("this machine", command)
        if target.missing() is None:
            return target
    return None


@dataclass(frozen=True)
class Build:
    """A compiled export."""

    target: Target
    program: Path
    table_bytes: int
    """Size of the constant arrays."""
    code_bytes: int
    """Size of the solver's instructions, without tables, C library and ``main``."""
    static_bytes: int
    """Size of its static variables: none."""
    context_bytes: int
    """Working memory provided by the caller."""
    stack_bytes: int
    """Upper limit: sum of the frames of all functions (``-fstack-usage``), as none is recursive."""
    heap_calls: tuple[str, ...]
    """Heap functions called: none."""

    def solve(self, text: str, times: int = 1) -> list[str]:
        """Output lines of the program for lists of centroids, with each list solved `times` times."""
        command = [*self.target.runner, str(self.program), str(times)]
        return _run(command, text).stdout.splitlines()

    def time_s(self, text: str, times: int) -> float:
        """Seconds per list, from runs with 1 and `times` + 1 repetitions, best of three."""
        lists = len(self.solve(text))
        spent = []
        for repetitions in (1, times + 1):
            best = float("inf")
            for _ in range(3):
                start = time.perf_counter()
                self.solve(text, repetitions)
                best = min(best, time.perf_counter() - start)
            spent.append(best)
        return (spent[1] - spent[0]) / times / lists

    def instructions(self, text: str) -> int:
        """Instructions for the lists, minus those of a start without lists."""
        return self._counted(text) - self._counted("")

    def _counted(self, text: str) -> int:
        command = [*self.target.counter, str(self.program)]
        with tempfile.TemporaryFile() as lists:
            lists.write(text.encode())
            lists.seek(0)
            pipes: dict[str, Any] = {"stdin": lists, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
            with subprocess.Popen(command, **pipes) as process:
                said = process.stderr
                return 0 if said is None else sum(part.count(b"\n") for part in iter(lambda: said.read(1 << 20), b""))


def compile_export(export: CExport, folder: Path, target: Target = HOST, extra: Sequence[str] = ()) -> Build:
    """Compile an export in a folder and measure it.

    Raises
    ------
    InputError
        If the compiler is not installed or fails.
    """
    missing = target.missing()
    if missing:
        raise InputError(f"{missing} is not installed; the exported C can be compiled elsewhere with its Makefile")
    for name, text in export.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    objects = []
    solver = [f"{export.prefix}_{module}" for module in ("tables", *export.modules)]
    for name in (*solver, "main"):
        objects.append(str(folder / f"{name}.o"))
        source = ["-fstack-usage", "-c", "-o", objects[-1], str(folder / f"{name}.c")]
        _run([target.compiler, *FLAGS, *target.flags, *extra, *source])
    program = folder / "solve"
    _run([target.compiler, *(("-static",) if target.runner else ()), *extra, "-o", str(program), *objects])
    text, data, bss = (sum(column) for column in zip(*(_sizes(target, path) for path in objects[1:-1]), strict=True))
    tables = sum(export.table_bytes.values())
    undefined = _run([target.symbols, "-u", *objects[:-1]]).stdout.split()
    heap = tuple(sorted({name for name in undefined if _HEAP.match(name)}))
    variables = _run([target.symbols, "-S", objects[-1]]).stdout.splitlines()
    context = next(int(line.split()[1], 16) for line in variables if line.split()[-1].startswith("context"))
    stack = sum(
        int(line.split("\t")[1])
        for name in solver
        if (folder / f"{name}.su").exists()
        for line in (folder / f"{name}.su").read_text(encoding="utf-8").splitlines()
    )
    return Build(target, program, tables, text, data + bss, context, stack, heap)


def _sizes(target: Target, path: str) -> tuple[int, int, int]:
    text, data, bss = _run([target.size, path]).stdout.splitlines()[1].split()[:3]
    return int(text), int(data), int(bss)


def _run(command: Sequence[str], text: str | None = None) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr.strip() or f"status {done.returncode}").splitlines()[0]
        raise InputError(f"{Path(command[0]).name}: {said}")
    return done
