"""Parts that the plots of a sequence share: the axis of time, and the number of defective pixels over it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.study.style import BLUE
from startracker.arrays import Columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def step_s(columns: Columns) -> float:
    """Time between two frames, seconds; 1 for a single frame."""
    t = columns["elapsed_s"]
    return float(t[1] - t[0]) if len(t) > 1 else 1.0


def time_axis(ax: Axes, columns: Columns) -> None:
    """Limits and label of the axis of time."""
    t, step = columns["elapsed_s"], step_s(columns)
    ax.set_xlim(float(t[0]) - step / 2.0, float(t[-1]) + step / 2.0)
    ax.set_xlabel("time [s]")


def draw_defects(ax: Axes, columns: Columns, name: str) -> None:
    """Number of pixels in a map of defects, from the column `name`."""
    count = columns[name]
    ax.step(columns["elapsed_s"], count, where="mid", color=BLUE, linewidth=1.2)
    ax.set_ylim(bottom=0, top=1.2 * max(1, int(count.max())))
    ax.set_ylabel("pixels")
    time_axis(ax, columns)
