"""The page of a comparison of runs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.study.axes import AXES, AXIS_TITLES, axis_name
from simulator.study.pages.page import Figures, Page, Section, Table
from simulator.study.pages.parts import DIGEST_DIGITS
from simulator.study.style import BLUE, SOFT, Panel
from simulator.study.sweep.compare import ComparedRun, Comparison
from simulator.study.texts import rate_text, rms_text, value_text
from startracker.core import ARCSEC_PER_DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_QUANTITIES = (*AXES, "rate", "stars")
_NAMES = tuple(axis_name(axis) for axis in AXES)


def comparison_page(comparison: Comparison) -> Page:
    """Content of the page of a comparison."""
    runs = comparison.runs
    return Page(
        heading=f"Comparison of {len(runs)} runs",
        sections=(
            Section("Runs", (_runs(runs),)),
            Section("Differences between scenarios", (_differences(comparison),)),
            Section("Errors", (Figures(tuple(comparison_panels(comparison))), _errors(runs))),
            Section("Relative to run 1, trial by trial", (_relative(comparison),)),
            Section("Rates and times", (_rates(runs),)),
        ),
    )


def _runs(runs: tuple[ComparedRun, ...]) -> Table:
    headings = ("run", "results", "scenario digest", "seed", "version")
    return Table(headings, _rows(runs, lambda run: (run.name, *_origin(run))), (1, 2))


def _errors(runs: tuple[ComparedRun, ...]) -> Table:
    return Table(
        ("run", *(f"rms {name} (95 %)" for name in _NAMES)),
        _rows(runs, lambda run: tuple(rms_text(run.statistics, axis) for axis in AXES)),
        note="Rms errors of the solved trials with 95 % bootstrap intervals; identification rates with Wilson's. "
        "The dotted line is run 1.",
    )


def _relative(comparison: Comparison) -> Table:
    return Table(
        ("run", *_NAMES),
        tuple((str(n + 1), *_ratios(found)) for n, found in enumerate(comparison.ratios) if n),
        note="Ratio of the rms error to that of run 1 over the trials solved by both, with 95 % interval by "
        "bootstrap of pairs; an interval without 1 is a significant difference. Trials are common to runs "
        "of the same seed and sampling.",
    )


def _rates(runs: tuple[ComparedRun, ...]) -> Table:
    headings = (
        "run",
        "solved",
        "misidentified",
        "inconsistent",
        "wrong",
        "identified (95 %)",
        "stars matched",
        "render [ms]",
        "solve [ms]",
        "trials/s",
    )
    return Table(headings, _rows(runs, _rates_of))


def _differences(comparison: Comparison) -> Table:
    """Values of the keys that differ: one row per key, or one per run if there are more runs than keys."""
    if not comparison.differences:
        return Table(note="None: the scenarios are the same.")
    runs = [f"run {n + 1}" for n in range(len(comparison.runs))]
    rows = {path: [value_text(value) for value in values] for path, values in comparison.differences.items()}
    if len(runs) <= max(len(rows), 4):
        return Table(("key", *runs), tuple((path, *values) for path, values in rows.items()))
    return Table(("run", *rows), tuple((run, *(values[n] for values in rows.values())) for n, run in enumerate(runs)))


def _rows(
    runs: tuple[ComparedRun, ...], cells: Callable[[ComparedRun], tuple[str, ...]]
) -> tuple[tuple[str, ...], ...]:
    return tuple((str(n + 1), *cells(run)) for n, run in enumerate(runs))


def _origin(run: ComparedRun) -> tuple[str, str, str]:
    """Digest of the scenario, seed and version; – if the results do not state them."""
    digest, seed, version = (str(run.identity.get(key, "–")) for key in ("sha256", "seed", "version"))
    return digest[:DIGEST_DIGITS], seed, version


def _ratios(found: dict[str, tuple[float, float | None, float | None]] | None) -> list[str]:
    if found is None:
        return ["no common trials", *["–"] * (len(AXES) - 1)]
    texts = []
    for axis in AXES:
        ratio, low, high = found[axis]
        texts.append(f"{ratio:.3f}" + ("" if low is None or high is None else f" ({low:.3f} to {high:.3f})"))
    return texts


def _rates_of(run: ComparedRun) -> tuple[str, ...]:
    s = run.statistics
    times = (s["stars_matched_mean"], s["median_render_ms"], s["median_solve_ms"], run.trials_per_second)
    outcomes = (str(s[name]) for name in ("misidentified", "inconsistent", "wrong"))
    return f"{s['solved']} of {s['trials']}", *outcomes, rate_text(s), *(value_text(each, ".1f") for each in times)


def comparison_panels(comparison: Comparison) -> list[Panel]:
    """Rms error about each axis, identification rate and matched stars, one line per run, with 95 % intervals."""
    height_in = 1.1 + 0.3 * max(3, len(comparison.runs))
    titles = {axis: title for axis, (title, _) in AXIS_TITLES.items()}
    titles |= {"rate": "identified", "stars": "stars matched, mean"}
    return [
        Panel(titles.get(name, ""), "", functools.partial(_draw, comparison, name), height_in) for name in _QUANTITIES
    ]


def _draw(comparison: Comparison, name: str, ax: Axes) -> None:
    runs = comparison.runs
    y = np.arange(len(runs))
    value, low, high = np.array([_numbers(run.statistics, name) for run in runs], dtype=float).T
    bars = np.nan_to_num(np.maximum(np.stack([value - low, high - value]), 0.0))
    ax.errorbar(value, y, xerr=bars, fmt="o", color=BLUE, markersize=5, elinewidth=1.2, capsize=3)
    if np.isfinite(value[0]):
        ax.axvline(value[0], color=SOFT, linewidth=0.8, linestyle=":")
    ax.set_xlabel({"rate": "[%]", "stars": ""}.get(name, "rms [arcsec]"))
    if name == "rate":
        ax.set_xlim(right=102.0)  # room for the marker at 100 %
        ax.set_xticks([tick for tick in ax.get_xticks() if ax.get_xlim()[0] <= tick <= 100.0])
    elif np.any(np.isfinite(value)):
        ax.set_xlim(0.0, 1.05 * float(np.nanmax([value, high])) or 1.0)
    ax.set_yticks(y, [str(n + 1) for n in y])
    ax.set_ylim(len(runs) - 0.5, -0.5)
    ax.set_ylabel("run")


def _numbers(statistics: dict[str, Any], name: str) -> tuple[float, float, float]:
    """Value and limits of its interval in the units of the figure; NaN if missing."""
    if name == "rate":
        keys, scale = [f"identification_rate{end}" for end in ("", "_low", "_high")], 100.0
    elif name == "stars":
        keys, scale = ["stars_matched_mean", "", ""], 1.0
    else:
        keys, scale = [f"{name}_{end}_deg" for end in ("rms", "rms_low", "rms_high")], ARCSEC_PER_DEG
    found = [statistics.get(key) for key in keys]
    value, low, high = (np.nan if number is None else number * scale for number in found)
    return value, low, high
