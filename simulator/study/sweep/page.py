"""Pages with tables of several studies: that of a sweep, and that of a comparison. Self-contained, light and dark."""

from __future__ import annotations

import base64
from typing import Any

from simulator.study.html_page import render_page
from simulator.study.statistics import AXES, BODY_AXES, deg_text
from simulator.study.sweep.plots import SweepFigure


def sweep_page(table: dict[str, Any], figures: list[SweepFigure]) -> str:
    """Whole page of a sweep: no script, no link to anything outside it.

    Parameters
    ----------
    table : dict
        As in ``sweep.json``.
    figures : list of SweepFigure
        From `simulator.study.sweep.plots.sweep_figures`.
    """
    done = [point for point in table["points"] if "statistics" in point]
    specification = table["specification_deg"]
    return table_page(
        "sweep.html.j2",
        table=table,
        done=done,
        refused=[point for point in table["points"] if point["status"] == "refused"],
        not_run=[point for point in table["points"] if point["status"] == "not run"],
        meeting=[point for point in done if meets(point["statistics"], specification)],
        best=[(axis, best) for axis in AXES if (best := _best(done, axis))],
        figures=[(f, embedded(f.png)) for f in figures],
    )


def meets(statistics: dict[str, Any], specification_deg: dict[str, float]) -> bool:
    """Whether 99.7 % of the errors about every body axis are within the specification, and nothing is wrong.

    Of the trials of the point alone: a point has too few of them for an interval of that percentile.
    """
    found = [(statistics[f"{axis}_p997_deg"], specification_deg[axis]) for axis in BODY_AXES]
    return statistics["wrong"] == 0 and all(p997 is not None and p997 <= limit for p997, limit in found)


def table_page(template: str, **values: Any) -> str:
    """A template of this folder filled in, with what pages of tables share."""
    return render_page(
        f"sweep/{template}",
        axes=AXES,
        body_axes=BODY_AXES,
        deg=deg_text,
        interval=interval_text,
        percent=percent_text,
        text=value_text,
        **values,
    )


def embedded(png: bytes) -> str:
    """A picture as a data address."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def interval_text(statistics: dict[str, Any], axis: str) -> str:
    """Rms of an axis and its 95 % interval, for people."""
    rms, low, high = (deg_text(statistics[f"{axis}_{name}_deg"]) for name in ("rms", "rms_low", "rms_high"))
    if "–" in (low, high):
        return rms
    return f"{rms} ({low[:-1] if low[-1] == high[-1] else low}–{high})"


def percent_text(statistics: dict[str, Any]) -> str:
    """Share identified and its 95 % interval, for people."""
    rate, low, high = (statistics[f"identification_rate{end}"] for end in ("", "_low", "_high"))
    return "–" if rate is None else f"{100 * rate:.2f} % ({100 * low:.1f} to {100 * high:.1f})"


def value_text(value: Any) -> str:
    """A value of a key, for people."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _best(done: list[dict[str, Any]], axis: str) -> dict[str, Any] | None:
    name = f"{axis}_rms_deg"
    return min(
        (p for p in done if p["statistics"][name] is not None), key=lambda p: p["statistics"][name], default=None
    )
