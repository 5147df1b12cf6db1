"""Plots of a calibration in flight: each parameter with its standard deviation against the truth, and the defects."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from simulator.study.sequence.time_axis import draw_defects, time_axis
from simulator.study.style import BLUE, INK, Panel
from startracker.core import Columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TITLES = {
    "focal_length_ppm": ("Focal length", "change [ppm]"),
    "aspect_ppm": ("Ratio of the focal lengths", "change [ppm]"),
    "principal_point_x_px": ("Principal point, columns", "change [px]"),
    "principal_point_y_px": ("Principal point, rows", "change [px]"),
    "psf_width_px": ("Width of star images", "σ [px]"),
}
_SETTLED = 0.1
"""Fraction of the frames left out for the limits of the axes: the first uncertainties are many times the last."""


def calibration_panels(columns: Columns) -> list[Panel]:
    """Panels of the estimated parameters and of the map of defective pixels."""
    names = [n.removeprefix("sigma_") for n in columns if n.startswith("sigma_") and _is_parameter(n)]
    panels = [Panel(_titles(name)[0], "", _drawer(name, columns)) for name in names]
    defects = Panel(
        "Defective pixels", "Number of pixels in the map.", lambda ax: draw_defects(ax, columns, "defective_px")
    )
    return [*panels, defects]


def _is_parameter(column: str) -> bool:
    name = column.removeprefix("sigma_")
    return name in _TITLES or name.startswith("distortion_")


def _titles(name: str) -> tuple[str, str]:
    return _TITLES.get(name, (f"Distortion {name.removeprefix('distortion_')}", "change"))


def _drawer(name: str, columns: Columns) -> Callable[[Axes], None]:
    return lambda ax: draw_parameter(ax, columns, name)


def draw_parameter(ax: Axes, columns: Columns, name: str) -> None:
    """Estimate of a parameter with ±1σ and ±3σ, and its true value."""
    t, value, sigma, true = columns["elapsed_s"], columns[name], columns[f"sigma_{name}"], columns[f"true_{name}"]
    for times, shade in ((3.0, 0.13), (1.0, 0.2)):
        label = f"±{times:.0f}σ"
        ax.fill_between(t, value - times * sigma, value + times * sigma, color=BLUE, alpha=shade, lw=0, label=label)
    ax.plot(t, value, "-", color=BLUE, linewidth=1.2, label="estimate")
    if np.isfinite(true).any():
        ax.plot(t, true, "--", color=INK, linewidth=1.0, label="truth")
    late = slice(int(_SETTLED * len(t)), None)
    shown = np.concatenate([(value - 3.0 * sigma)[late], (value + 3.0 * sigma)[late], true, value[late]])
    shown = shown[np.isfinite(shown)]
    if len(shown) and np.ptp(shown) > 0.0:
        low, high = float(shown.min()), float(shown.max())
        ax.set_ylim(low - 0.1 * (high - low), high + 0.45 * (high - low))
    ax.set_ylabel(_titles(name)[1])
    ax.ticklabel_format(useOffset=False)
    ax.legend(loc="upper right", ncols=4, framealpha=0.8)
    time_axis(ax, columns)
