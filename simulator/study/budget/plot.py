"""Plot of an error budget: contributions of effects and classes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from simulator.study.budget.error_budget import Budget, Contribution

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = {
    "temporal": "#0072b2",
    "pixel_spatial": "#e69f00",
    "fov_spatial": "#009e73",
    "rate": "#cc79a7",
    "bias": "#56b4e9",
    "": "#777777",
}  # Okabe & Ito 2008: distinguishable with colour-blindness

_PANELS = (
    ("across the boresight (rms of x and y)", ("cross_x", "cross_y")),
    ("about the boresight", ("about_boresight",)),
)


def budget_figure(budget: Budget) -> Figure:
    """Bars of the contribution of each effect (coloured by class) and each class, arcseconds, with 95 % intervals;
    dotted: the rms error with all effects on, dashed: with all effects off."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    effects = sorted(budget.effects, key=lambda row: -(row.added_deg2["cross_x"] + row.added_deg2["cross_y"]))
    rows = [*effects, *budget.classes]
    figure = Figure(figsize=(9.5, 1.9 + 0.27 * len(rows)), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    positions = np.arange(len(rows)) + np.array([0.6 if k >= len(effects) else 0.0 for k in range(len(rows))])
    for ax, (title, axes) in zip(panels, _PANELS, strict=True):
        _bars(ax, rows, positions, axes)
        everything = math.sqrt(sum(budget.rms_deg[axis] ** 2 for axis in axes) / len(axes)) * 3600
        ax.axvline(everything, color="#444444", linestyle=":")
        lines = f"dotted: all effects on, {everything:.3g}″"
        if budget.remainder is not None:
            left = math.sqrt(sum(budget.remainder.rms_off_deg[axis] ** 2 for axis in axes) / len(axes)) * 3600
            ax.axvline(left, color="#444444", linestyle="--")
            lines += f"; dashed: all effects off, {left:.2g}″"
        ax.axvline(0.0, color="black", linewidth=0.8)
        ax.set_title(f"{title}\n{lines}", fontsize=9)
        ax.set_xlabel("contribution to the rms error, quadratic [arcsec]")
        ax.grid(axis="x", alpha=0.3)
        ax.set_axisbelow(True)
    panels[0].set_yticks(positions, [row.name for row in rows])
    panels[0].invert_yaxis()
    if rows:
        from simulator.study.budget.effects import CLASSES

        kinds = [kind for kind in CLASSES if any(row.kind == kind for row in rows)]
        handles = [Patch(color=_COLOURS[kind], label=CLASSES[kind]) for kind in kinds]
        figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.suptitle(f"Error budget of {budget.scenario}: {budget.trials} trials per run", fontsize=11)
    return figure


def _bars(ax: Axes, rows: list[Contribution], positions: np.ndarray, axes: tuple[str, ...]) -> None:
    for row, position in zip(rows, positions, strict=True):
        value = _root(np.mean([row.added_deg2[axis] for axis in axes]))
        ax.barh(position, value, height=0.72, color=_COLOURS[row.kind])
        ends = [row.interval_deg2[axis] for axis in axes]
        low, high = [v[0] for v in ends if v[0] is not None], [v[1] for v in ends if v[1] is not None]
        if len(low) == len(high) == len(axes):
            ax.plot([_root(np.mean(low)), _root(np.mean(high))], [position, position], color="#222222", linewidth=1.2)


def _root(square_deg2: float | np.floating) -> float:
    return math.copysign(math.sqrt(abs(float(square_deg2))), float(square_deg2)) * 3600
