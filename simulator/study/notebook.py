"""What a notebook shows of a study: its answer as a table, and the distribution of its errors as a chart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.statistics import BODY_AXES
from startracker.arrays import FloatArray
from startracker.display import html_card

_LINES = {"roll": ("#2f81c9", ""), "pitch": ("#c9730a", "7 3"), "yaw": ("#2a9d6f", "2 3")}
"""Colour, 3 : 1 and more against white and black alike, and dashes of each body axis."""
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 420.0, 250.0, 42.0, 38.0, 22.0


def study_card(summary: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> str:
    """HTML with the number of solved and wrong trials, each axis beside its specification, and the chart of errors."""
    trials, wrong = summary["trials"], summary["wrong"]
    rows = {"trials": f"{trials}, seed {summary['seed']}", "solved": f"{summary['solved']}, {wrong} wrong"}
    for judged in summary["specification"].values():
        title, _, said = judged["text"].partition(": ")
        rows[title] = said
    rows["specification"] = summary["verdict"]["text"].partition(": ")[2]
    errors = {axis: np.abs(np.asarray(columns[f"error_{axis}_deg"], dtype=float)) for axis in BODY_AXES}
    finite = {axis: np.sort(values[np.isfinite(values) & (values > 0.0)]) for axis, values in errors.items()}
    chart = _distribution(finite) if all(len(values) > 1 for values in finite.values()) else ""
    return html_card(f"Study of {summary['name']}", rows, chart)


def _distribution(errors_deg: Mapping[str, FloatArray]) -> str:
    """Share of the solved trials with an error below x, about each body axis, as SVG with a logarithmic scale."""
    arcsec = {axis: values * 3600.0 for axis, values in errors_deg.items()}
    low = math.floor(math.log10(min(float(np.quantile(values, 0.02)) for values in arcsec.values())))
    high = math.ceil(math.log10(max(float(values[-1]) for values in arcsec.values())))
    right, down = _WIDTH - 8.0, _HEIGHT - _BOTTOM

    def across(value: float) -> float:
        return _LEFT + (right - _LEFT) * (math.log10(value) - low) / max(high - low, 1)

    def up(share: float) -> float:
        return down - (down - _TOP) * share

    lines, labels = "", ""
    for power in range(low, high + 1):
        x, text = across(10.0**power), f"{10.0**power:g}″"
        lines += f"M{x:.1f} {_TOP}V{down}"
        labels += f'<text x="{x:.1f}" y="{down + 14}" text-anchor="middle">{text}</text>'
    for percent in (0, 50, 100):
        y = up(percent / 100)
        lines += f"M{_LEFT} {y:.1f}H{right}"
        labels += f'<text x="{_LEFT - 5}" y="{y + 3.5:.1f}" text-anchor="end">{percent} %</text>'
    curves = ""
    for k, (axis, values) in enumerate(arcsec.items()):
        colour, dashes = _LINES[axis]
        shown = np.unique(np.linspace(0, len(values) - 1, 200).astype(int))
        points = [(across(max(values[n], 10.0**low)), up((n + 1) / len(values))) for n in shown.tolist()]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        style = f'fill="none" stroke="{colour}" stroke-width="2" stroke-dasharray="{dashes}"'
        x = _LEFT + 8 + 78 * k
        curves += f'<polyline points="{line}" {style}/>'
        curves += f'<path d="M{x} 10h22" {style}/><text x="{x + 27}" y="14">{axis}</text>'
    return (
        f'<svg role="img" aria-label="distribution of the errors" viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" '
        f'style="display:block;width:100%;max-width:{_WIDTH:.0f}px;height:auto" xmlns="http://www.w3.org/2000/svg">'
        '<g fill="currentColor" font-size="11" font-family="sans-serif" stroke="none">'
        f'<path d="{lines}" stroke="currentColor" stroke-opacity="0.18" fill="none"/>{labels}{curves}'
        f'<text x="{(_LEFT + right) / 2:.0f}" y="{_HEIGHT - 6:.0f}" text-anchor="middle">'
        "error; share of solved trials below it</text></g></svg>"
    )
