"""Plots of the rules of operation: exposure and actions, map of defective pixels, magnitudes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from simulator.study.sequence.time_axis import draw_defects, time_axis
from simulator.study.style import BLUE, GREEN, INK, ORANGE, VERMILION, Panel
from startracker.core import Columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARKS = {
    "exposure": (VERMILION, "v", "over-exposed: discarded"),
    "sun": (ORANGE, "*", "Sun: suspended"),
    "moon": (GREEN, "o", "Moon: cleared"),
}
"""Colour, marker and label by rule."""


def operation_panels(columns: Columns) -> list[Panel]:
    """Panels of a sequence under the rules of operation."""
    return [
        Panel(
            "Exposure", "Exposure of each frame, and frames in which a rule acted.", lambda ax: _exposure(ax, columns)
        ),
        Panel(
            "Defective pixels",
            "Number of pixels in the map.",
            lambda ax: draw_defects(ax, columns, "blemished_px"),
            2.2,
        ),
        Panel(
            "Magnitudes",
            "Measured minus catalogue magnitude: mean and rms of each frame.",
            lambda ax: _magnitudes(ax, columns),
        ),
    ]


def _exposure(ax: Axes, columns: Columns) -> None:
    t, exposure = columns["elapsed_s"], columns["exposure_s"]
    ax.step(t, exposure, where="mid", color=BLUE, linewidth=1.0, label="exposure")
    for rule, (colour, marker, words) in _MARKS.items():
        acted = columns["rule"] == rule
        if acted.any():
            ax.plot(t[acted], exposure[acted], marker, color=colour, markersize=4, linestyle="none", label=words)
    ax.set_yscale("log")
    ax.set_ylim(0.6 * float(exposure.min()), 4.0 * float(exposure.max()))
    ax.set_yticks(np.unique(exposure), [f"{value:.3g}" for value in np.unique(exposure)])
    ax.minorticks_off()
    ax.set_ylabel("exposure [s]")
    ax.legend(loc="upper center", ncols=2)
    time_axis(ax, columns)


def _magnitudes(ax: Axes, columns: Columns) -> None:
    t = columns["elapsed_s"]
    measured = columns["magnitude_stars"] > 0
    mean, rms = columns["magnitude_error_mean"][measured], columns["magnitude_error_rms"][measured]
    spread = np.sqrt(np.maximum(rms**2 - mean**2, 0.0))
    ax.errorbar(t[measured], mean, spread, fmt=".", color=BLUE, markersize=3, elinewidth=0.5)
    ax.axhline(0.0, color=INK, linewidth=0.8)
    ax.set_ylabel("error [mag]")
    time_axis(ax, columns)
