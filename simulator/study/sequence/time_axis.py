"""Parts that the plots of a sequence share: the axis of time, strips and bands over it, and limits of errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.study.style import BLUE
from startracker.core import BoolArray, Columns, FloatArray

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


def draw_strip(ax: Axes, columns: Columns, row: int, frames: BoolArray, **look: Any) -> None:
    """One row of a strip chart: bars for the frames marked."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], frames, [False]]).astype(np.int8)))
    t, step = columns["elapsed_s"], step_s(columns)
    bars = [(float(t[a]) - step / 2.0, (b - a) * step) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    ax.broken_barh(bars, (row - 0.38, 0.76), linewidth=0, **look)


def nearly_all(*values: FloatArray) -> float:
    """Reach of nearly all finite values, for the limits of an axis: acquisition or an outage may widen a band a
    thousandfold."""
    finite = [np.abs(each[np.isfinite(each)]) for each in values]
    return max((float(np.percentile(each, 97.0)) for each in finite if len(each)), default=1.0)
