"""The pages of a sweep and of a comparison of runs: self-contained, light and dark."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.study.html_page import DIGEST_DIGITS, TONES, Table, drawn, provenance, render_page
from simulator.study.plots import TITLES
from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED
from simulator.study.statistics import AXES, BODY_AXES
from simulator.study.style import BLUE, SOFT, Panel
from simulator.study.sweep.compare import ComparedRun, Comparison
from simulator.study.sweep.plots import SweepFigure, key_label
from simulator.study.texts import deg_text
from startracker.core import ARCSEC_PER_DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def sweep_page(table: dict[str, Any], figures: list[SweepFigure]) -> str:
    """Complete page of a sweep, without scripts or external links.

    Parameters
    ----------
    table : dict
        As in ``sweep.json``.
    figures : list of SweepFigure
        From `simulator.study.sweep.plots.sweep_figures`.
    """
    done = [point for point in table["points"] if "statistics" in point]
    refused = [point for point in table["points"] if point["status"] == "refused"]
    states = [point["statistics"].get("verdict") for point in done]
    counts = {state: states.count(state) for state in (MET, NOT_MET, UNDECIDED)}
    swept = [axis["path"] for axis in table["swept"]]
    keys = tuple(key_label(axis) for axis in table["swept"])
    return render_page(
        "sweep/sweep.html.j2",
        sweep=table,
        provenance=provenance(table, table["identity"]["sha256"]),
        verdicts=[(TONES[state], state, count) for state, count in counts.items() if count],
        specified=", ".join(f"{name} {deg_text(limit)}" for name, limit in table["specification_deg"].items()),
        not_run=sum(point["status"] == "not run" for point in table["points"]),
        best=_best(done, keys, swept),
        figures=[
            {
                "title": figure.title,
                "note": figure.note,
                "legend": figure.legend,
                "panels": [drawn(panel, f"p{i}-{k}") for k, panel in enumerate(figure.panels)],
            }
            for i, figure in enumerate(figures)
        ],
        points=_points(done, keys, swept),
        refused=Table(
            ("point", *keys, "reason"),
            tuple((str(point["point"]), *_values(point, swept), point["reason"]) for point in refused),
            (len(keys) + 1,),
        ),
    )


def interval_text(statistics: dict[str, Any], axis: str) -> str:
    """Rms of an axis and its 95 % interval, for display."""
    rms, low, high = (deg_text(statistics[f"{axis}_{name}_deg"]) for name in ("rms", "rms_low", "rms_high"))
    if "–" in (low, high):
        return rms
    return f"{rms} ({low[:-1] if low[-1] == high[-1] else low}–{high})"


def percent_text(statistics: dict[str, Any]) -> str:
    """Identification rate and its 95 % interval, for display."""
    rate, low, high = (statistics[f"identification_rate{end}"] for end in ("", "_low", "_high"))
    return "–" if rate is None else f"{100 * rate:.2f} % ({100 * low:.1f} to {100 * high:.1f})"


def number_text(value: float | None) -> str:
    """A mean or a time with one decimal, for display; – if missing."""
    return "–" if value is None else f"{value:.1f}"


def value_text(value: Any) -> str:
    """A value of a key, for display; – if missing."""
    return "–" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def _values(point: dict[str, Any], swept: list[str]) -> list[str]:
    return [value_text(point["values"][path]) for path in swept]


def _best(done: list[dict[str, Any]], keys: tuple[str, ...], swept: list[str]) -> Table:
    """The point with the smallest rms error about each axis."""
    rows = []
    for axis in AXES:
        known = [point for point in done if point["statistics"][f"{axis}_rms_deg"] is not None]
        if known:
            point = min(known, key=lambda p: p["statistics"][f"{axis}_rms_deg"])
            title = axis.replace("_", " ")
            rows.append((title, interval_text(point["statistics"], axis), str(point["point"]), *_values(point, swept)))
    return Table(("axis", "rms (95 % interval)", "point", *keys), tuple(rows))


def _points(done: list[dict[str, Any]], keys: tuple[str, ...], swept: list[str]) -> Table:
    """Statistics of all points."""
    rows = []
    for point in done:
        s = point["statistics"]
        rows.append((
            str(point["point"]),
            *_values(point, swept),
            f"{s['solved']} of {s['trials']}",
            " / ".join(str(s.get(name, "–")) for name in ("misidentified", "inconsistent", "wrong")),
            percent_text(s),
            *(interval_text(s, axis) for axis in BODY_AXES),
            s.get("verdict", "–"),
        ))  # fmt: skip
    names = (f"rms {axis} (95 %)" for axis in BODY_AXES)
    return Table(
        ("point", *keys, "solved", "mis. / inc. / wrong", "identified (95 %)", *names, "verdict"),
        tuple(rows),
        note="mis. / inc. / wrong: misidentified, inconsistent and wrong attitudes. All statistics are in points.csv "
        "and sweep.json, all trials in sweep.parquet.",
    )


_QUANTITIES = (*AXES, "rate", "stars")


def comparison_page(comparison: Comparison) -> str:
    """Complete page of a comparison, without scripts or external links."""
    runs = comparison.runs
    names = tuple(axis.replace("_", " ") for axis in AXES)
    return render_page(
        "sweep/compare.html.j2",
        runs=Table(
            ("run", "results", "scenario digest", "seed", "version"),
            tuple((str(n + 1), run.name, *_origin(run)) for n, run in enumerate(runs)),
            (1, 2),
        ),
        differences=_differences(comparison),
        panels=[drawn(panel, f"c{k}") for k, panel in enumerate(comparison_panels(comparison))],
        errors=Table(
            ("run", *(f"rms {name} (95 %)" for name in names)),
            _rows(runs, lambda run: tuple(interval_text(run.statistics, axis) for axis in AXES)),
            note="Rms errors of the solved trials with 95 % bootstrap intervals; identification rates with Wilson's. "
            "The dotted line is run 1.",
        ),
        ratios=Table(
            ("run", *names),
            tuple((str(n + 1), *_ratios(found)) for n, found in enumerate(comparison.ratios) if n),
            note="Ratio of the rms error to that of run 1 over the trials solved by both, with 95 % interval by "
            "bootstrap of pairs; an interval without 1 is a significant difference. Trials are common to runs "
            "of the same seed and sampling.",
        ),
        rates=Table(
            (
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
            ),
            _rows(runs, _rates),
        ),
    )


def _differences(comparison: Comparison) -> Table:
    """Values of the keys that differ: one row per key, or one per run if there are more runs than keys."""
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


def _rates(run: ComparedRun) -> tuple[str, ...]:
    s = run.statistics
    times = (s["stars_matched_mean"], s["median_render_ms"], s["median_solve_ms"], run.trials_per_second)
    outcomes = (str(s[name]) for name in ("misidentified", "inconsistent", "wrong"))
    return f"{s['solved']} of {s['trials']}", *outcomes, percent_text(s), *map(number_text, times)


def comparison_panels(comparison: Comparison) -> list[Panel]:
    """Rms error about each axis, identification rate and matched stars, one line per run, with 95 % intervals."""
    height_in = 1.1 + 0.3 * max(3, len(comparison.runs))
    titles = {"rate": "identified", "stars": "stars matched, mean"}
    return [
        Panel(titles.get(name, TITLES.get(name, "")), "", functools.partial(_draw, comparison, name), height_in)
        for name in _QUANTITIES
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
