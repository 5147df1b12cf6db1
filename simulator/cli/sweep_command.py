"""``boresight sweep`` and ``boresight compare``: progress over all points, and the tables."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from simulator.cli.checks import at_least, processes
from simulator.cli.requests import SweepRequest
from simulator.cli.terminal import WorkBar, open_console, print_table
from simulator.cli.verdicts import coloured, outcome_cell
from simulator.paths import write_atomically
from simulator.study.axes import BODY_AXES
from simulator.study.sweep.files import RESULT_FILES

if TYPE_CHECKING:
    from simulator.study.sweep.run import Plan, Point, Sweep

_WIDTH = 130  # columns of the tables where the output is not a terminal
MOST_ROWS = 60
"""Points that the terminal's table shows; all are in the files."""


def main(request: SweepRequest) -> int:
    """Run the sweep; exit status 0, or 130 where it was interrupted."""
    from simulator.study.sweep.run import plan_sweep, run_sweep

    at_least(1, trials=request.trials, lhs=request.lhs)
    at_least(0, seed=request.seed)
    plan = plan_sweep(
        request.scenario,
        request.over,
        lhs=request.lhs,
        trials=request.trials,
        seed=request.seed,
        set_values=request.set_values or (),
    )
    workers = processes(request.workers, request.dask, plan.scenario.study.trials * len(plan.points))
    folder = request.out or Path("out") / f"{plan.scenario.name}-sweep"
    with SweepProgress(plan) as bar:
        sweep = run_sweep(
            plan,
            folder,
            workers=workers,
            dask=request.dask,
            resume=request.resume,
            force=request.force,
            progress=bar.update,
        )
    _print(sweep, open_console(_WIDTH))
    return 130 if sweep.table["interrupted"] else 0


class SweepProgress(WorkBar):
    """One bar over all trials of a sweep; without a terminal, a line a point on standard error."""

    def __init__(self, plan: Plan, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(plan.scenario.name, "trials", clock=clock)
        self.points = len(plan.points)
        self.point: int | None = None

    def update(self, done: int, total: int, point: Point) -> None:
        """Take note of progress, as `simulator.study.sweep.run.run_sweep` reports it."""
        at = f"point {point.index + 1} of {self.points}"
        self.show(done, total, at)
        if not self.console.is_terminal and point.index != self.point:
            print(f"{at}: {done} of {total} trials are done, {self.times}", file=sys.stderr)
            self.point = point.index


def _print(sweep: Sweep, console: Console) -> None:
    from simulator.study.texts import rate_text, rms_text, short_name, value_text

    table = sweep.table
    done = [point for point in table["points"] if "statistics" in point]
    paths = [axis["path"] for axis in table["swept"]]
    short = [short_name(path) for path in paths]
    keys = short if len(set(short)) == len(short) else paths

    def row(point: dict[str, Any]) -> list[str]:
        statistics = point["statistics"]
        values = [value_text(point["values"][path]) for path in paths]
        errors = [rms_text(statistics, axis) for axis in BODY_AXES]
        wrong = outcome_cell(statistics)
        rate = rate_text(statistics).partition(" (")[0]
        return [*values, rate, *errors, wrong, coloured(statistics["verdict"]) if "verdict" in statistics else "–"]

    title = f"{table['name']}: rms errors (95 % interval)"
    print_table(
        console, title, (*keys, "identified", *BODY_AXES, "wrong", "specification"), map(row, done[:MOST_ROWS]), words=0
    )
    if len(done) > MOST_ROWS:
        console.print(f"… and {len(done) - MOST_ROWS} points more")
    for point in table["points"]:
        if point["status"] == "refused":
            values = ", ".join(f"{path} {value_text(value)}" for path, value in point["values"].items())
            console.print(f"Refused: {values}: {point['reason']}", markup=False)
    if table["interrupted"]:
        console.print(
            f"Interrupted: {len(done)} of {len(table['points'])} points are finished and kept; run again to continue."
        )
    for note in sweep.notes:
        console.print(note, markup=False, soft_wrap=True)
    console.print(f"{sweep.folder}: {', '.join(RESULT_FILES)}", markup=False)


def compare_runs(folders: list[str], out: Path) -> int:
    """Compare runs; prints a table and writes the page."""
    from simulator.study.pages.html import html_of
    from simulator.study.sweep.compare import compare
    from simulator.study.sweep.comparison_page import comparison_page
    from simulator.study.texts import rate_text, rms_text, value_text

    comparison = compare(folders)
    write_atomically(out, html_of(comparison_page(comparison)))
    console = open_console(_WIDTH)
    rows = [
        (
            f"{number}: {run.name}",
            rate_text(run.statistics).partition(" (")[0],
            *(rms_text(run.statistics, axis) for axis in BODY_AXES),
        )
        for number, run in enumerate(comparison.runs, start=1)
    ]
    print_table(console, "rms errors (95 % interval)", ("run", "identified", *BODY_AXES), rows)
    for path, values in comparison.differences.items():
        console.print(f"{path}: " + ", ".join("–" if v is None else value_text(v) for v in values), markup=False)
    console.print(str(out), markup=False)
    return 0
