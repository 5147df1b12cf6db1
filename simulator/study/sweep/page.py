"""The page of a sweep: self-contained, light and dark."""

from __future__ import annotations

from typing import Any

from simulator.study.html_page import TONES, Table, drawn, provenance, render_page
from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED
from simulator.study.statistics import AXES, BODY_AXES
from simulator.study.sweep.plots import SweepFigure, key_label
from simulator.study.texts import deg_text


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
            str(s["wrong"]),
            percent_text(s),
            *(interval_text(s, axis) for axis in BODY_AXES),
            s.get("verdict", "–"),
        ))  # fmt: skip
    names = (f"rms {axis} (95 %)" for axis in BODY_AXES)
    return Table(
        ("point", *keys, "solved", "wrong", "identified (95 %)", *names, "verdict"),
        tuple(rows),
        note="All statistics are in points.csv and sweep.json, all trials in sweep.parquet.",
    )
