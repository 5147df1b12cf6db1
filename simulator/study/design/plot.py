"""Plot of a design trade-off: accuracy, stars and availability by parameter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.study.design.search import PARAMETERS, Design
from simulator.study.plots import BLUE, GREEN, GREY, ORANGE, VERMILION, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["design_plot"]

_LINES = {"roll": (BLUE, "o", "-"), "pitch": (ORANGE, "s", "--"), "yaw": (GREEN, "^", ":")}


def design_plot(result: Design) -> Figure:
    """Predicted 3σ with the specification, stars in the field, and fraction of the attitudes with too few stars."""
    figure, grid = picture(1, 3, (12, 4.6))
    possible = [point for point in result.points if not point.impossible]
    value = np.array([point.value for point in possible])
    for ax in grid[0]:
        _parameter_axis(ax, result)
    _accuracy(grid[0, 0], result, possible, value)
    stars = grid[0, 1]
    stars.plot(value, [point.stars_mean for point in possible], "o-", color=BLUE, ms=3.5, label="mean")
    stars.plot(value, [point.stars_min for point in possible], "s--", color=VERMILION, ms=3.5, label="fewest")
    stars.axhline(result.least_stars, color=GREY, lw=1.0, label=f"{result.least_stars} required")
    stars.set_ylabel("stars used in the field")
    stars.set_ylim(0, None)
    missing = grid[0, 2]
    share = np.array([100.0 * (1.0 - (point.availability or 0.0)) for point in possible])
    floor = 100.0 / result.attitudes
    missing.semilogy(value, np.maximum(share, 0.5 * floor), "o-", color=BLUE, ms=3.5, label="predicted")
    allowed = 100.0 * (1.0 - result.least_availability)
    if allowed > 0:
        missing.axhline(allowed, color=VERMILION, lw=1.2, label=f"{allowed:.3g} % allowed")
    missing.axhspan(0.4 * floor, floor, color="#eeeeee", label=f"none of {result.attitudes}")
    missing.set_ylim(0.4 * floor, 150.0)
    missing.set_ylabel(f"fraction of the {'time' if result.over == 'path' else 'sky'} with fewer stars [%]")
    for ax in grid[0]:
        ax.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False)
    title, unit, _ = PARAMETERS[result.parameter]
    found = f"no {title} in this range meets the requirements"
    if result.best:
        found = f"the smallest {title} that meets the requirements is {result.best.value:.4g} {unit}"
    figure.suptitle(f"{result.name}: {found}", fontsize=10)
    return figure


def _accuracy(ax: Axes, result: Design, possible: list[Any], value: Any) -> None:
    for axis, (colour, marker, line) in _LINES.items():
        three = [point.three_sigma_deg.get(axis) for point in possible]
        known = np.array([np.nan if v is None else v * 3600.0 for v in three])
        ax.plot(value, known, marker + line, color=colour, ms=3.5, label=f"{axis}, predicted")
    drawn: dict[float, list[str]] = {}
    for axis, limit in result.specification_deg.items():
        drawn.setdefault(limit, []).append(axis)
    for limit, axes in drawn.items():
        colour = _LINES[axes[0]][0] if len(axes) == 1 else VERMILION
        ax.axhline(limit * 3600.0, color=colour, lw=1.2, linestyle=(0, (6, 2)), label=f"{', '.join(axes)} specified")
    ax.set_yscale("log")
    ax.set_ylabel("3σ [arcsec]")


def _parameter_axis(ax: Axes, result: Design) -> None:
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    values = [point.value for point in result.points]
    ax.set_xscale("log")
    ticks = _round_numbers(min(values), max(values))
    ax.set_xticks(ticks)
    ax.xaxis.set_major_formatter(ScalarFormatter())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("{} [{}]".format(*PARAMETERS[result.parameter]))
    if result.best is not None:
        ax.axvline(result.best.value, color=GREY, linestyle="--", lw=1.0, label=f"smallest, {result.best.value:.4g}")


def _round_numbers(low: float, high: float) -> list[float]:
    """1, 2, 5 times powers of ten within the range, and its ends if there are fewer than two."""
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [m * 10.0**d for d in decades for m in (1, 2, 5) if low * 0.999 <= m * 10.0**d <= high * 1.001]
    return ticks if len(ticks) > 1 else [low, high]
