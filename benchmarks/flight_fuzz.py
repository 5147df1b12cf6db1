"""Fuzzing of the flight build (libFuzzer): frames and lists of stars, in both arithmetics.

    python -m benchmarks.flight_fuzz [--seconds 600] [--what frames stars] [--arithmetic fixed float] [--corpus DIR]

A small camera, 48 × 48 pixels, and searches of at most 2,000 steps make an execution short; the code is that of every
camera. Exits with 1 if anything is found; the input is in the folder of the corpus.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from simulator.study.exported_c.fuzz import FuzzResult, build_fuzzer, run_fuzzer
from startracker import StarTracker
from startracker.camera import Camera
from startracker.fixed_point.c_table import CTable
from startracker.fixed_point.export_c import CExport
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.flight.export import assemble, flight_parts
from startracker.flight.solver import FlightTracker

MOST_STEPS = 2000
WHAT = {"frames": 300, "stars": 200}
"""Fuzzers, and their longest inputs, bytes."""


def fuzz_design(arithmetic: str) -> FlightDesign:
    """A small camera whose fields have five guide stars on average."""
    tracker = StarTracker(Camera.from_fov(5.4, 48, 48), magnitude_limit=6.2)
    numbers = DetectorNumbers(1.0, 5.0, 4095)
    settings = tracker.detection, tracker.centroid, tracker.identification
    return FlightDesign(tracker.camera, tracker.guide, numbers, 0.9, *settings, arithmetic, name="fuzz")


def fuzz_export(arithmetic: str) -> CExport:
    """The export of that camera, whose searches end early."""
    tracker = FlightTracker.build(fuzz_design(arithmetic))
    parts = [
        part._replace(arrays=[_shortened(table) if table.name == "search_row" else table for table in part.arrays])
        for part in flight_parts(tracker)
    ]
    return assemble(tracker.design, parts, "tracker", "")


def _shortened(table: CTable) -> CTable:
    """The table of the searches with fewer steps, its last column."""
    rows = table.values.copy()
    rows[:, -1] = np.minimum(rows[:, -1], MOST_STEPS)
    return replace(table, values=rows)


def fuzz(what: str, arithmetic: str, seconds: int, corpus: Path, folder: Path) -> FuzzResult:
    """Build a fuzzer in a folder and run it."""
    export = fuzz_export(arithmetic)
    program = build_fuzzer(export, export.files[f"fuzz_{what}.c"], folder)
    return run_fuzzer(program, corpus, seconds, WHAT[what])


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns 1 if something is found."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.flight_fuzz", description=__doc__.splitlines()[0])
    made.add_argument("--seconds", type=int, default=600, help="of each fuzzer")
    made.add_argument("--what", nargs="*", default=list(WHAT), choices=list(WHAT))
    made.add_argument("--arithmetic", nargs="*", default=["fixed", "float"])
    made.add_argument("--corpus", type=Path, help="folder that keeps the inputs")
    options = made.parse_args(arguments)
    found = 0
    for arithmetic in options.arithmetic:
        for what in options.what:
            with tempfile.TemporaryDirectory() as folder:
                kept = (options.corpus or Path(folder)) / f"{what}_{arithmetic}"
                result = fuzz(what, arithmetic, options.seconds, kept, Path(folder))
                for crash in Path(folder).glob("*-*"):
                    if crash.name.startswith(("crash", "timeout", "oom", "leak")):
                        crash.rename(kept.parent / crash.name)
            found += bool(result.finding)
            print(
                f"{what}, {arithmetic}: {result.executions:,} executions in {result.seconds:.0f} s, "
                f"{result.edges} edges, {result.finding or 'nothing found'}",
                flush=True,
            )
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
