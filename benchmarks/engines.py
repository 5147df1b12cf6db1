"""The two engines of a scenario on the same frames: the reference in Python, and the flight build (`tracker.engine`).

    python -m benchmarks.engines [--frames 200] [--case WORD ...] [--arithmetic fixed float] [--document FILE.md]

Frames are those of ``boresight run`` of the scenario. Errors are the rms across the boresight and about it, over the
frames that both solve, with the ratio to the reference and its interval of 95 % by bootstrap; the aim is
`benchmarks.flight.LIMITS`. NEES is the mean over what the engine solves, 3 if its covariances are right. Times are
medians of the solution on this machine. `--document` writes the table between its marks in a page.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import chosen
from benchmarks.flight import ALLOWED, LIMITS, SCENARIOS, error_ratio
from benchmarks.report import provenance
from simulator.checks import load_scenario
from simulator.study.axes import CAMERA_AXES
from simulator.study.trackers import tracker_of
from simulator.study.trials.trial import TrialRunner, solve_frame
from startracker._compiled import clock
from startracker.core import ARCSEC_PER_DEG, BoolArray, FloatArray

BEGIN, END = "<!-- engines: python -m benchmarks.engines --document docs/flight.md -->", "<!-- end of engines -->"
_METHODS = (
    "tracker.detector=components",
    "tracker.centroider=maximum_likelihood",
    "tracker.identifier=adaptive",
    "tracker.centroid={flat_field_error: 0.01}",
    "tracker.identification.max_stars=null",
    "tracker.identification.separation_tolerance_deg=null",
)
"""The methods of the flight build, in place of those of the thesis."""
CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "`cubesat`": ("cubesat.yaml", ()),
    "`cubesat_ideal`": ("cubesat_ideal.yaml", ()),
    "`tc211`": ("tc211.yaml", _METHODS),
    "`gallery/hot_pixels`": ("gallery/hot_pixels.yaml", ()),
    "`gallery/moon`": ("gallery/moon.yaml", ()),
    "`cubesat_ideal`, smeared over 5 px": ("cubesat_ideal.yaml", ("pointing.rate_deg_s=[0.2, 0, 0.2]",)),
    "`gallery/smear`, over 36 px": ("gallery/smear.yaml", ()),
}
"""Scenario and values of each row of the table."""
COLUMNS = (
    "frames",
    "engine",
    "solved",
    "same status",
    "misidentified",
    "across, ″",
    "about, ″",
    "ratio",
    "95 %",
    "NEES",
    "ms",
)


@dataclass
class Engine:
    """Rows of the trials of one engine, and the times of its solutions, ms."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    times_ms: list[float] = field(default_factory=list)

    @property
    def solved(self) -> BoolArray:
        """Which frames have an attitude."""
        return np.array([row["status"] == "solved" for row in self.rows])

    @property
    def statuses(self) -> Counter[str]:
        """Number of frames with each status."""
        return Counter(row["status"] for row in self.rows)

    @property
    def misidentified(self) -> int:
        """Frames whose attitude has the wrong stars."""
        return sum(bool(row["misidentified"]) for row in self.rows)

    @property
    def error_arcsec(self) -> FloatArray:
        """Errors (N, 3) about the camera's axes."""
        return np.array([[row[f"error_{axis}_deg"] for axis in CAMERA_AXES] for row in self.rows]) * ARCSEC_PER_DEG

    @property
    def nees(self) -> float:
        """Mean of the squared errors normalised by their covariance."""
        return float(np.mean(np.array([row["nees"] for row in self.rows])[self.solved]))


def run_engines(name: str, arithmetics: list[str], count: int) -> dict[str, Engine]:
    """Both engines on the frames of a case, each rendered once."""
    file, values = CASES[name]
    runner = TrialRunner(load_scenario(SCENARIOS / file, values))
    trackers = {"reference": runner.tracker}
    for arithmetic in arithmetics:
        chosen_engine = ["tracker.engine=flight", f"tracker.flight.arithmetic={arithmetic}"]
        trackers[arithmetic] = tracker_of(load_scenario(SCENARIOS / file, [*values, *chosen_engine]), runner.renderer)
    engines = {engine: Engine() for engine in trackers}
    for index in range(count):
        frame, truth = runner.renderer.frame(index)
        for engine, tracker in trackers.items():
            begun = clock()
            solution = solve_frame(tracker, frame)
            engines[engine].times_ms.append((clock() - begun) * 1e3)
            engines[engine].rows.append(runner.row(index, frame, truth, solution))
    return engines


@dataclass(frozen=True)
class Comparison:
    """An engine compared with the reference."""

    agreement: float
    """Share of the frames with the same status."""
    ratio: float
    interval: tuple[float, float]
    """Of the rms errors across the boresight."""
    misidentified: int

    def meets(self, arithmetic: str) -> bool:
        """Whether the limits of the flight build are met."""
        return self.agreement >= 1.0 - ALLOWED and self.ratio <= LIMITS[arithmetic] and self.misidentified == 0


def compared(engine: Engine, reference: Engine) -> Comparison:
    """Agreement and errors over the frames that both solve."""
    both = engine.solved & reference.solved
    same = [ours["status"] == theirs["status"] for ours, theirs in zip(engine.rows, reference.rows, strict=True)]
    ratio, interval = error_ratio(engine.error_arcsec[both], reference.error_arcsec[both])
    return Comparison(float(np.mean(same)), ratio, interval, engine.misidentified)


def table_rows(name: str, engines: dict[str, Engine]) -> list[list[str]]:
    """Rows of the table: the reference, then each arithmetic."""
    reference, out = engines["reference"], []
    both = np.all([engine.solved for engine in engines.values()], axis=0)
    for label, engine in engines.items():
        square = np.mean(engine.error_arcsec[both] ** 2, axis=0)
        row = [name if engine is reference else "", label if engine is reference else f"flight, {label}"]
        row += [f"{engine.solved.sum()} of {len(engine.rows)}"]
        found = compared(engine, reference)
        row += (
            ["", str(engine.misidentified)]
            if engine is reference
            else [f"{100 * found.agreement:.1f} %", str(engine.misidentified)]
        )
        row += [f"{np.sqrt(square[0] + square[1]):.3f}", f"{np.sqrt(square[2]):.2f}"]
        low, high = found.interval
        row += ["", ""] if engine is reference else [f"{found.ratio:.3f}", f"{low:.3f}–{high:.3f}"]
        row += [f"{engine.nees:.2f}", f"{np.median(engine.times_ms):.0f}"]
        out.append(row)
    return out


def markdown(rows: list[list[str]]) -> str:
    """The table in Markdown."""
    lines = [COLUMNS, ["---"] * len(COLUMNS), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns 1 if a limit is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.engines", description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=200, help="frames of a scenario")
    parser.add_argument("--case", nargs="*", default=[], metavar="WORD", help="scenarios whose name contains a word")
    parser.add_argument("--arithmetic", nargs="*", default=list(LIMITS), choices=list(LIMITS))
    parser.add_argument("--document", type=Path, help="page in which the table is replaced")
    options = parser.parse_args(arguments)
    rows: list[list[str]] = []
    met = True
    for name in chosen(options.case, list(CASES)):
        engines = run_engines(name, options.arithmetic, options.frames)
        rows += table_rows(name, engines)
        print(
            markdown(rows[-len(engines) :]).partition("|\n| ---")[2], engines_said(engines), file=sys.stderr, flush=True
        )
        for arithmetic in options.arithmetic:
            met &= compared(engines[arithmetic], engines["reference"]).meets(arithmetic)
    print(markdown(rows))
    if options.document is not None:
        text = options.document.read_text(encoding="utf-8")
        before, _, rest = text.partition(BEGIN)
        _, _, after = rest.partition(END)
        notes = "; ".join(provenance())
        table = f"{before}{BEGIN}\n\n{markdown(rows)}\n{notes}\n\n{END}{after}"
        options.document.write_text(table, encoding="utf-8")
    return int(not met)


def engines_said(engines: dict[str, Engine]) -> str:
    """Statuses of each engine."""
    return "; ".join(f"{name}: {dict(engine.statuses)}" for name, engine in engines.items())


if __name__ == "__main__":
    sys.exit(main())
