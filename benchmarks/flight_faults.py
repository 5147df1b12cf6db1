"""Faults planted in the C of the flight build, and whether its golden answers show them.

    python -m benchmarks.flight_faults [--each 6] [--modules votes pose ...] [--out FILE.md]

A fault is one operator of a source that is replaced by its neighbour (``<`` by ``<=``, ``+`` by ``-``, ``==`` by ``!=``
and so on); `--each` of them are planted in each source, one at a time, evenly spaced over it. A fault is found if the
library then answers otherwise than `tests/golden/flight.npz` to the frames, lists and sequence of
`tests/helpers/flight_answers.py`, fails, or does not end. Those not found are named, to be looked at: some change
nothing, as of a comparison of numbers that are never equal.
"""

from __future__ import annotations

import argparse
import faulthandler
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks.report import Table, show, write_markdown
from simulator.checks import load_scenario
from simulator.study.exported_c.targets import host_compiler
from simulator.study.flight.design import flight_design
from simulator.study.flight.library import FlightLibrary, library_sources
from startracker.flight.design import FlightDesign
from tests.helpers import golden_outputs
from tests.helpers.flight_answers import answers_of

CAMERA = "tc211"
"""Of small frames, which are answered soon."""
NEIGHBOURS = {
    "<": "<=",
    "<=": "<",
    ">": ">=",
    ">=": ">",
    "+": "-",
    "-": "+",
    "==": "!=",
    "!=": "==",
    "&&": "||",
    "||": "&&",
}
NEIGHBOURS |= {"+=": "-=", "-=": "+=", "*": "+", "<<": ">>", ">>": "<<"}
_OPERATOR = re.compile(r"(?<= )(" + "|".join(sorted(map(re.escape, NEIGHBOURS), key=len, reverse=True)) + r")(?= )")
_NO_CODE = re.compile(r"/\*.*?\*/|^#.*?(?<!\\)$", re.DOTALL | re.MULTILINE)
_OPTIONS = ("-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-w")
_LONGEST_S = 40.0
"""Without a fault it takes 2 s of an idle core."""


class Fault(NamedTuple):
    """One operator of a source."""

    module: str
    line: int
    old: str
    new: str
    text: str
    """The source with it."""

    def __str__(self) -> str:
        return f"line {self.line}: `{self.old}` → `{self.new}`"


def faults_of(module: str, text: str, each: int) -> list[Fault]:
    """Faults evenly spaced over a source."""
    bare = _NO_CODE.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    sites = list(_OPERATOR.finditer(bare))
    chosen = [sites[(2 * k + 1) * len(sites) // (2 * each)] for k in range(each)] if len(sites) > each else sites
    return [
        Fault(
            module,
            text.count("\n", 0, site.start()) + 1,
            site[0],
            NEIGHBOURS[site[0]],
            text[: site.start()] + NEIGHBOURS[site[0]] + text[site.end() :],
        )
        for site in chosen
    ]


class Planted:
    """The library of a design, its sources compiled once, of which one is replaced at a time.

    Parameters
    ----------
    design : FlightDesign
    folder : Path
    """

    def __init__(self, design: FlightDesign, folder: Path) -> None:
        self.design, self.folder = design, folder
        self.sources = library_sources(design)
        for name, text in self.sources.items():
            (folder / name).write_text(text, encoding="utf-8")
        self.units = [name for name in self.sources if name.endswith(".c")]
        for name in self.units:
            self._compile(folder / name, self._object(name))
        kept, _ = golden_outputs.read("flight")
        prefix = f"{CAMERA}/{design.arithmetic}/{design.identifier}/"
        self.golden = {name.removeprefix(prefix): list(kept[name]) for name in kept if name.startswith(prefix)}

    @property
    def modules(self) -> list[str]:
        """Sources of the tracker, without its tables."""
        return [name[8:-2] for name in self.units if name.startswith("tracker_") and name != "tracker_tables.c"]

    def is_found(self, fault: Fault) -> str:
        """How a fault is noticed: ``answer``, ``failure``, ``no end`` or ``compiler``; empty: it is not."""
        name, work = f"tracker_{fault.module}.c", self.folder / "fault"
        work.mkdir(exist_ok=True)
        (work / name).write_text(fault.text, encoding="utf-8")
        out = work / "fault.so"
        if not self._compile(work / name, work / "fault.o"):
            return "compiler"
        objects = [str(self._object(unit)) for unit in self.units if unit != name]
        _run([*host_compiler(), "-shared", "-o", str(out), str(work / "fault.o"), *objects, "-lm"])
        return self._noticed(out)

    def _noticed(self, library: Path) -> str:
        """In a process of its own, as a fault may end it, or keep it for ever."""
        process = multiprocessing.get_context("fork").Process(target=self._compare, args=(library,))
        process.start()
        process.join(_LONGEST_S)
        if process.is_alive():
            process.kill()
            process.join()
            return "no end"
        return {0: "", 1: "answer"}.get(process.exitcode or 0, "failure")

    def _compare(self, library: Path) -> None:
        """End this process, which is a copy of another one, without what that one does at its end."""
        faulthandler.disable()
        stages = answers_of(self.design, FlightLibrary(library))
        os._exit(int(any(lines != self.golden[stage] for stage, lines in stages)))

    def _object(self, name: str) -> Path:
        return self.folder / f"{name}.o"

    def _compile(self, source: Path, out: Path) -> bool:
        return _run([*host_compiler(), *_OPTIONS, f"-I{self.folder}", "-c", "-o", str(out), str(source)])


def _run(words: list[str]) -> bool:
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def planted(folder: Path) -> Iterator[tuple[Planted, list[str]]]:
    """Builds of both identifiers, and the modules to plant faults in: of the second those that the first has not."""
    done: set[str] = set()
    for identifier in ("adaptive", "triads"):
        sources = folder / identifier
        sources.mkdir()
        build = Planted(flight_design(load_scenario(Path(CAMERA)), "fixed", identifier), sources)
        modules = [module for module in build.modules if module not in done]
        done.update(modules)
        yield build, modules


def main() -> int:
    """Plant and print; 1 if a source has no fault that is found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=6, help="faults in each source")
    parser.add_argument("--modules", nargs="*", help="sources, without their prefix; default: all")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    asked = parser.parse_args()
    rows, blind = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for build, modules in planted(Path(folder)):
            for module in modules:
                if asked.modules and module not in asked.modules:
                    continue
                faults = faults_of(module, build.sources[f"tracker_{module}.c"], asked.each)
                found = [build.is_found(fault) for fault in faults]
                missed = "; ".join(str(fault) for fault, how in zip(faults, found, strict=True) if not how)
                first = next((f"{fault} ({how})" for fault, how in zip(faults, found, strict=True) if how), "")
                rows.append([module, str(len(faults)), str(sum(map(bool, found))), first, missed])
                blind += not any(found)
                print(*rows[-1], sep="\t", flush=True)
    table: Table = ("Faults planted in the C", ["source", "planted", "found", "the first found", "not found"], rows)
    show([table])
    if asked.out:
        write_markdown(asked.out, "Faults planted in the C of the flight build", [], [table])
    return int(blind > 0)


if __name__ == "__main__":
    sys.exit(main())
