"""The page of a comparison: a figure of the errors of all runs with their intervals, and tables."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.study.plots import BLUE, GREY, TITLES, save_bytes
from simulator.study.statistics import AXES
from simulator.study.sweep.compare import Comparison
from simulator.study.sweep.page import embedded, table_page
from simulator.study.sweep.plots import figure_of_panels

_ARCSEC = 3600.0


def comparison_page(comparison: Comparison) -> str:
    """Complete page of a comparison, without scripts or external links."""
    return table_page("compare.html.j2", comparison=comparison, picture=embedded(comparison_picture(comparison)))


def comparison_picture(comparison: Comparison) -> bytes:
    """PNG: rms error about each axis, identification rate and matched stars, one line per run, with 95 % intervals."""
    runs = comparison.runs
    y = np.arange(len(runs))
    figure, panels = figure_of_panels((12.5, 2.4 + 0.44 * len(runs)), sharey=True)
    for ax, name in zip(panels.ravel(), [*AXES[:3], "rate", *AXES[3:], "stars"], strict=True):
        rows = [_numbers(run.statistics, name) for run in runs]
        value, low, high = np.array(rows, dtype=float).T
        bars = np.nan_to_num(np.maximum(np.stack([value - low, high - value]), 0.0))
        ax.errorbar(value, y, xerr=bars, fmt="o", color=BLUE, markersize=5, elinewidth=1.2, capsize=3)
        if np.isfinite(value[0]):
            ax.axvline(value[0], color=GREY, linewidth=0.8, linestyle=":")
        ax.set_title({"rate": "identified [%]", "stars": "stars matched, mean"}.get(name, TITLES.get(name)), fontsize=8)
        ax.set_xlabel("" if name in ("rate", "stars") else "rms [arcsec]", fontsize=8)
        if name == "rate":
            ax.set_xlim(right=102.0)
        elif np.any(np.isfinite(value)):
            ax.set_xlim(0.0, 1.05 * float(np.nanmax([value, high])) or 1.0)
        ax.set_yticks(y, [str(n + 1) for n in y])
    panels[0, 0].set_ylim(len(runs) - 0.5, -0.5)
    for row in panels:
        row[0].set_ylabel("run")
    return save_bytes(figure)


def _numbers(statistics: dict[str, Any], name: str) -> tuple[float, float, float]:
    """Value and limits of its interval in the units of the figure; NaN if missing."""
    if name == "rate":
        keys, scale = [f"identification_rate{end}" for end in ("", "_low", "_high")], 100.0
    elif name == "stars":
        keys, scale = ["stars_matched_mean", "", ""], 1.0
    else:
        keys, scale = [f"{name}_{end}_deg" for end in ("rms", "rms_low", "rms_high")], _ARCSEC
    found = [statistics.get(key) for key in keys]
    value, low, high = (np.nan if number is None else number * scale for number in found)
    return value, low, high
