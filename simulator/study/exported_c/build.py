"""Compilation and measurement of the exported C: memory, stack, time.

By the native compiler, or by a cross compiler with an emulator. Not required for an export.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from simulator.study.exported_c.stack import deepest_stack
from simulator.study.exported_c.targets import HOST, MACHINE, Target
from startracker.errors import InputError
from startracker.flight.c_text import CExport

FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-ffp-contract=off")
_HEAP = re.compile(r"^_*(malloc|calloc|realloc|free|aligned_alloc|posix_memalign|sbrk)$")


@dataclass(frozen=True)
class Build:
    """A compiled export."""

    target: Target
    prefix: str
    """Of all names."""
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
    """Deepest chain of calls (`deepest_stack`); without gcc's call graph 0."""
    heap_calls: tuple[str, ...]
    """Heap functions called: none."""

    def run(self, data: bytes, *arguments: str, plugin: str = "") -> bytes:
        """Standard output of the program for this standard input.

        Raises
        ------
        InputError
            If it fails: the first line that it writes to standard error, or its status.
        """
        with tempfile.NamedTemporaryFile() as given:
            given.write(data)
            given.flush()
            given.seek(0)
            command = self.target.command(self.program, arguments, Path(given.name), plugin)
            done = subprocess.run(command, stdin=given, capture_output=True, check=False)
        if done.returncode:
            raise _failure(command[0], done.stderr.decode(errors="replace"), done.returncode)
        return done.stdout

    def time_s(self, data: bytes, times: int, *arguments: str) -> float:
        """Seconds that the program needs for this standard input, from runs with it once and `times` more; the shortest
        of three runs each."""
        spent = []
        for repetitions in (1, times + 1):
            best = float("inf")
            for _ in range(3):
                start = time.perf_counter()
                self.run(data * repetitions, *arguments)
                best = min(best, time.perf_counter() - start)
            spent.append(best)
        return max(spent[1] - spent[0], 0.0) / times


def compile_export(export: CExport, folder: Path, target: Target = HOST, extra: Sequence[str] = ()) -> Build:
    """Compile an export in a folder and measure it.

    Parameters
    ----------
    export : CExport
    folder : Path
        Existing folder for the sources, objects and the program ``solve``.
    target : Target
    extra : sequence of str
        Additional options of compiler and linker.

    Raises
    ------
    InputError
        If the compiler is not installed or fails.
    """
    missing = target.missing()
    if missing:
        raise InputError(f"{missing} is not installed; the exported C can be compiled elsewhere with its Makefile")
    write_sources(export, folder)
    graph = () if "clang" in target.compiler else ("-fcallgraph-info=su",)
    solver = [f"{export.prefix}_{module}" for module in ("tables", *export.modules)]
    objects = []
    for name in (*solver, "main"):
        objects.append(str(folder / f"{name}.o"))
        flags = [*FLAGS, *target.flags, *extra, *graph]
        command([target.compiler, *flags, "-c", "-o", objects[-1], str(folder / f"{name}.c")])
    program = folder / "solve"
    machine = [str(MACHINE / name) for name in target.machine]
    link = [*target.flags, *extra, *target.link, f"-Wl,-Map={folder / 'solve.map'}", "-o", str(program)]
    command([target.compiler, "-O2", f"-I{folder}", *link, *machine, *objects, *target.libraries])
    text, data, bss = (sum(column) for column in zip(*(_sizes(target, path) for path in objects[1:-1]), strict=True))
    undefined = command([target.symbols, "-u", *objects[:-1]]).stdout.split()
    return Build(
        target,
        export.prefix,
        program,
        sum(export.table_bytes.values()),
        text,
        data + bss,
        _context_bytes(target, objects[-1]),
        deepest_stack([folder / f"{name}.ci" for name in solver]) if graph else 0,
        tuple(sorted({name for name in undefined if _HEAP.match(name)})),
    )


def write_sources(export: CExport, folder: Path) -> None:
    """Write the files of an export to an existing folder."""
    for name, text in export.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def _context_bytes(target: Target, main: str) -> int:
    """Size of the context that ``main`` provides."""
    variables = command([target.symbols, "-S", main]).stdout.splitlines()
    return next(int(line.split()[1], 16) for line in variables if "context" in line.split()[-1])


def _sizes(target: Target, path: str) -> tuple[int, int, int]:
    text, data, bss = command([target.size, path]).stdout.splitlines()[1].split()[:3]
    return int(text), int(data), int(bss)


def _failure(program: str, said: str, status: int) -> InputError:
    lines = (said.strip() or f"status {status}").splitlines()
    return InputError(f"{Path(program).name}: {next((line for line in lines if 'error' in line), lines[0])}")


def command(words: Sequence[str], check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run a tool; `InputError` with its first complaint if it fails and `check` is set."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if check and done.returncode:
        raise _failure(words[0], done.stderr, done.returncode)
    return done
