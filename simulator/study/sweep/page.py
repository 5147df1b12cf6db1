"""Pages with tables of several studies (sweep, comparison): self-contained, light and dark."""

from __future__ import annotations

import base64
from typing import Any

from simulator.study.html_page import render_page
from simulator.study.statistics import AXES, BODY_AXES, deg_text
from simulator.study.sweep.plots import SweepFigure


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

    Based on the sample alone, as a point has too few trials for an interval of this percentile.
    """
    found = [(statistics[f"{axis}_p997_deg"], specification_deg[axis]) for axis in BODY_AXES]
    return statistics["wrong"] == 0 and all(p997 is not None and p997 <= limit for p997, limit in found)


def table_page(template: str, **values: Any) -> str:
    """Rendered template of this folder, with common values of pages with tables."""
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
    """A picture as a data URL."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


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


def value_text(value: Any) -> str:
    """A value of a key, for display."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _best(done: list[dict[str, Any]], axis: str) -> dict[str, Any] | None:
    name = f"{axis}_rms_deg"
    return min(
        (p for p in done if p["statistics"][name] is not None), key=lambda p: p["statistics"][name], default=None
    )
