"""Instructions that the exported C executes under emulation, by module and by answer.

They are counted by a plugin of QEMU, ``machine/count_instructions.c``.
"""

from __future__ import annotations

import bisect
import re
import shutil
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from simulator.study.exported_c.build import Build, command
from simulator.study.exported_c.targets import MACHINE, Target
from startracker.errors import InputError

_SECTION = re.compile(r"^ \.text\S*\s+0x([0-9a-f]+)\s+0x([0-9a-f]+)\s+(\S.*)$", re.MULTILINE)
_ENTRIES = ("start", "row", "finish", "solve_stars")
_MARKS = ("enter", "leave", "answer")


class InstructionCounts(NamedTuple):
    """Executed instructions."""

    modules: dict[str, int]
    """By module of the solver, such as ``rows``, and ``library``: what it calls of the compiler's own."""
    answers: tuple[int, ...]
    """Of each frame or list, if the program was compiled for a `marked` target."""

    @property
    def total(self) -> int:
        """Instructions of the solver."""
        return sum(self.modules.values())


def marked(target: Target, prefix: str) -> Target:
    """The target with functions around those of the interface, so that each answer is counted."""
    wrapped = tuple(f"-Wl,--wrap={prefix}_{name}" for name in _ENTRIES)
    flags = (f"-DPREFIX={prefix}", f'-DHEADER="{prefix}.h"')
    return replace(target, machine=(*target.machine, "marks.c"), link=(*flags, *target.link, *wrapped))


def count_instructions(build: Build, data: bytes, *arguments: str) -> InstructionCounts:
    """Instructions of the solver for this standard input, without those of ``main`` and the C library.

    Parameters
    ----------
    build : Build
        For an emulated target.
    data : bytes
        Standard input of the program.
    *arguments : str
        Of the program.

    Raises
    ------
    InputError
        If the target is not emulated, or there is no native compiler for QEMU's plugin.
    """
    if not build.target.emulator:
        raise InputError(f"{build.target.name}: instructions are counted under emulation only")
    with tempfile.TemporaryDirectory() as name:
        plugin, out = Path(name) / "count.so", Path(name) / "counts"
        compiler = next((word for word in ("gcc", "cc", "clang") if shutil.which(word)), None)
        if compiler is None:
            raise InputError("counting instructions needs a native C compiler (Debian: gcc)")
        command([compiler, "-O2", "-fPIC", "-shared", "-o", str(plugin), str(MACHINE / "count_instructions.c")])
        build.run(data, *arguments, plugin=f"{plugin},out={out}{_mark_options(build)}")
        lines = [line.split() for line in out.read_text().splitlines()]
    sections = _sections(build.program.with_suffix(".map"))
    starts = [start for start, _, _ in sections]
    modules: Counter[str] = Counter()
    for address, count in ((int(words[1], 16), int(words[2])) for words in lines if words[0] == "block"):
        at = bisect.bisect_right(starts, address) - 1
        if at >= 0 and address < sections[at][1]:
            modules[_module(sections[at][2], build.prefix)] += count
    modules.pop("", None)
    return InstructionCounts(dict(modules), tuple(int(words[1]) for words in lines if words[0] == "answer"))


def _mark_options(build: Build) -> str:
    symbols = command([build.target.symbols, str(build.program)]).stdout
    found = {name: re.search(rf"^([0-9a-f]+) [tT] mark_{name}$", symbols, re.MULTILINE) for name in _MARKS}
    return "".join(f",{name}={match[1]}" for name, match in found.items() if match)


def _sections(path: Path) -> list[tuple[int, int, str]]:
    """Start, end and object of each part of the program's instructions."""
    found = []
    for start, size, name in _SECTION.findall(path.read_text(encoding="utf-8")):
        if int(size, 16):
            found.append((int(start, 16), int(start, 16) + int(size, 16), name))
    return sorted(found)


def _module(path: str, prefix: str) -> str:
    """Module of an object; empty: not the solver."""
    if "libgcc" in path:
        return "library"
    name = Path(path).name
    return name[len(prefix) + 1 : -2] if name.startswith(f"{prefix}_") and name.endswith(".o") else ""
