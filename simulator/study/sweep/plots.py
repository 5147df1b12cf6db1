"""Plots of a sweep: errors and identification rate by swept key, and maps over two keys.

A logarithmic range has a logarithmic axis; names and mixed lists are categories. Grey crosses mark unphysical points.
The colours follow Okabe & Ito (2008); curves also differ in their markers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.study.axes import AXES, AXIS_TITLES
from simulator.study.plots import picture, save_bytes
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION, Panel
from simulator.study.texts import short_name
from startracker.core import ARCSEC_PER_DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_CURVES = 6
"""Maximum number of curves in a panel; above it points and their pooled rms are drawn."""

_LOOKS = (
    ("blue", BLUE, "o", "●"),
    ("vermilion", VERMILION, "s", "■"),
    ("green", GREEN, "D", "◆"),
    ("orange", ORANGE, "^", "▲"),
    ("soft", SOFT, "v", "▼"),
    ("text", INK, "P", "✚"),
)
"""Of each curve: name of its colour in `simulator.study.style.COLOURS`, colour, marker, and marker in a legend."""

Point = dict[str, Any]


@dataclass(frozen=True)
class SweepFigure:
    """A figure of the page: stem of its file, heading, caption, its eight panels and its legend."""

    name: str
    title: str
    note: str
    panels: list[Panel]
    legend: list[tuple[str, str, str]] = field(default_factory=list)
    """Colour, marker and text of each curve."""

    def png(self) -> bytes:
        """The panels in one picture, as the bytes of a PNG file."""
        figure, axes = picture(3, 3, (12.5, 0.3 + 3.0 * self.panels[0].height_in))
        axes[-1, -1].remove()
        for ax, panel in zip(axes.ravel(), self.panels, strict=False):
            panel.draw(ax)
            ax.set_title("\n".join(filter(None, (panel.title, panel.note))), fontsize=8)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        if self.legend:
            figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=4, frameon=False)
        return save_bytes(figure)


class _Quantity(NamedTuple):
    """Quantity of a panel: name, column of the statistics, and factor to its unit in the panel."""

    name: str
    column: str
    scale: float

    @property
    def is_error(self) -> bool:
        return self.name in AXES


_QUANTITIES = (
    *(_Quantity(axis, f"{axis}_rms_deg", ARCSEC_PER_DEG) for axis in AXES),
    _Quantity("identification_rate", "identification_rate", 100.0),
    _Quantity("stars_matched_mean", "stars_matched_mean", 1.0),
)
_TITLES = {axis: title for axis, (title, _) in AXIS_TITLES.items()}
_TITLES |= {"identification_rate": "identified", "stars_matched_mean": "stars matched, mean"}
_Y_LABELS = {"identification_rate": "identified [%]", "stars_matched_mean": "stars matched, mean"}


def sweep_figures(table: dict[str, Any]) -> list[SweepFigure]:
    """All figures of a sweep.

    Parameters
    ----------
    table : dict
        As in ``sweep.json``.
    """
    figures = [against(table, axis["path"]) for axis in table["swept"]]
    if len(table["swept"]) == 2 and table["kind"] == "grid":
        figures.append(error_maps(table))
    return figures


class _Curves(NamedTuple):
    """Points of a sweep by one key."""

    axis: dict[str, Any]
    done: list[Point]
    families: dict[str, list[Point]] | None
    """Points of each combination of the other keys, by label; None: too many for curves."""
    pooled: bool
    refused: list[float]
    position: Callable[[Any], float]


def against(table: dict[str, Any], path: str) -> SweepFigure:
    """Rms error about each axis, identification rate and matched stars by one key."""
    axis = next(a for a in table["swept"] if a["path"] == path)
    others = [a["path"] for a in table["swept"] if a["path"] != path]
    done = [p for p in table["points"] if "statistics" in p]
    position = _position_along(axis, table["points"])
    families: dict[str, list[Point]] = {}
    for point in done:
        label = ", ".join(f"{short_name(other)} {_text(point['values'][other])}" for other in others)
        families.setdefault(label, []).append(point)
    is_grid = table["kind"] == "grid"
    shown = families if is_grid and len(families) <= MAX_CURVES else None
    curves = _Curves(axis, done, shown, is_grid, _refused_everywhere(table["points"], path, position), position)
    if shown is not None:
        legend = [(look[0], look[3], label) for look, label in zip(_LOOKS, shown, strict=False) if label]
    else:
        legend = [("blue", "●", "single point"), *([("vermilion", "■", "all points")] if is_grid else [])]
    panels = []
    for quantity in _QUANTITIES:
        limit_deg = table["specification_deg"].get(quantity.name)
        limit = limit_deg and limit_deg * ARCSEC_PER_DEG
        note = "" if limit is None else f"specified {limit:.4g}″"
        draw = functools.partial(_draw_against, curves, quantity, limit)
        panels.append(Panel(_TITLES[quantity.name], note, draw))
    return SweepFigure(
        f"errors_against_{path.replace('.', '_')}",
        f"By {key_label(axis)}",
        "Rms error (left scale) and three times the rms (right scale); dashed: the specified limit, judged by the "
        "percentile of the errors and not by three times their rms. "
        "Bars: 95 % intervals, by bootstrap, and Wilson's for the identification rate. "
        + ("" if shown is not None else "The other keys vary between points. ")
        + ("Grey crosses: unphysical points. " if curves.refused else "")
        + "All points share the same attitudes and random numbers, so differences are more accurate than the "
        "bars suggest.",
        panels,
        legend,
    )


def _draw_against(curves: _Curves, quantity: _Quantity, limit: float | None, ax: Axes) -> None:
    """One quantity by one key; `limit` is the specified one, arcseconds."""
    path = curves.axis["path"]
    if curves.families is not None:
        for (_, colour, marker, _), (label, points) in zip(_LOOKS, curves.families.items(), strict=False):
            x, y, low, high = _series(points, path, curves.position, quantity)
            ax.plot(x, y, f"{marker}-", color=colour, markersize=4, linewidth=1.2, label=label or "rms")
            ax.errorbar(x, y, _bars(y, low, high), fmt="none", ecolor=colour, elinewidth=1, capsize=2.5)
    else:
        x, y, low, high = _series(curves.done, path, curves.position, quantity)
        bars = _bars(y, low, high)
        ax.errorbar(x, y, bars, fmt="o", color=BLUE, markersize=3, elinewidth=0.6, alpha=0.45, label="single point")
        if curves.pooled:
            pooled = _pooled(x, y, squares=quantity.is_error)
            ax.plot(*pooled, "s-", color=VERMILION, markersize=4, label="all points")
    if curves.refused:
        heights = [0.03] * len(curves.refused)
        ax.plot(curves.refused, heights, "x", color=SOFT, transform=ax.get_xaxis_transform(), clip_on=False)
    _dress_x(ax, curves.axis)
    found = [p["statistics"][quantity.column] for p in curves.done]
    _dress_y(ax, quantity, np.array([v * quantity.scale for v in found if v is not None]), limit)


def error_maps(table: dict[str, Any]) -> SweepFigure:
    """Maps of the rms error about each axis and of the identification rate over two swept keys."""
    down, across = table["swept"]
    height_in = 1.0 + max(2.0, 0.3 * len(down["values"]))
    panels = []
    for quantity in _QUANTITIES:
        title = _TITLES[quantity.name]
        unit = "rms [arcsec]" if quantity.is_error else "[%]" if quantity.name == "identification_rate" else ""
        draw = functools.partial(_draw_map, table, quantity)
        panels.append(Panel(f"{title} {unit}".strip(), "", draw, height_in))
    return SweepFigure(
        "map",
        f"{key_label(down)} and {key_label(across)}",
        "Values are rms errors in arcseconds, or identification rates in per cent; darker is worse. ×: unphysical.",
        panels,
    )


def _draw_map(table: dict[str, Any], quantity: _Quantity, ax: Axes) -> None:
    down, across = table["swept"]
    rows, columns = down["values"], across["values"]
    at = {(p["values"][down["path"]], p["values"][across["path"]]): p for p in table["points"]}
    grid = np.full((len(rows), len(columns)), np.nan)
    for i, r in enumerate(rows):
        for j, c in enumerate(columns):
            statistics = at[r, c].get("statistics")
            value = statistics and statistics[quantity.column]
            if value is not None:
                grid[i, j] = value * quantity.scale
            if at[r, c]["status"] == "refused":
                ax.text(j, i, "×", ha="center", va="center", color=SOFT)
    shade = np.log(np.maximum(grid, 1e-12)) if quantity.is_error else -grid
    ax.imshow(shade, cmap="Blues", aspect="auto", origin="lower", interpolation="nearest")
    if grid.size <= 150:
        finite = shade[np.isfinite(shade)]
        middle = 0.5 * (finite.min() + finite.max()) if len(finite) else 0.0
        for i, j in np.argwhere(np.isfinite(grid)):
            dark = shade[i, j] > middle and finite.max() > finite.min()
            # nearly white and black, as pure ones follow the theme of the page
            ax.text(
                j, i, f"{grid[i, j]:.3g}", ha="center", va="center", fontsize=7, color="#fefefe" if dark else "#010101"
            )
    ax.set_xticks(range(len(columns)), [_text(v) for v in columns], rotation=0 if len(columns) < 6 else 60)
    ax.set_yticks(range(len(rows)), [_text(v) for v in rows])
    ax.set_xlabel(key_label(across), fontsize=8)
    ax.set_ylabel(key_label(down), fontsize=8)
    ax.grid(visible=False)


def key_label(axis: dict[str, Any]) -> str:
    """Path of a swept key, with its unit."""
    return f"{axis['path']} [{axis['unit']}]" if axis["unit"] else str(axis["path"])


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _position_along(axis: dict[str, Any], points: list[Point]) -> Any:
    """Function from a value to its position on the axis: the value, or the index of a name."""
    if axis["numeric"]:
        return float
    names = list(dict.fromkeys(axis["values"] or [p["values"][axis["path"]] for p in points]))
    return lambda value: float(names.index(value))


def _series(
    points: list[Point], path: str, position: Callable[[Any], float], quantity: _Quantity
) -> tuple[NDArray[np.float64], ...]:
    """Position, value and interval of every point with the statistic, by position; NaN without an interval."""
    stem, unit = (f"{quantity.name}_rms", "_deg") if quantity.is_error else (quantity.name, "")
    rows = []
    for point in points:
        s = point["statistics"]
        if s[quantity.column] is not None:
            ends = [np.nan if s.get(key) is None else s[key] for key in (f"{stem}_low{unit}", f"{stem}_high{unit}")]
            rows.append([position(point["values"][path]), *(quantity.scale * v for v in (s[quantity.column], *ends))])
    data = np.array(sorted(rows), dtype=float).reshape(-1, 4)
    return tuple(data.T)


def _bars(y: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the bars below and above; zero without an interval."""
    return np.nan_to_num(np.maximum(np.stack([y - low, high - y]), 0.0))


def _refused_everywhere(points: list[Point], path: str, position: Any) -> list[float]:
    """Positions at which all points are unphysical."""
    possible = {position(p["values"][path]) for p in points if p["status"] != "refused"}
    return sorted({position(p["values"][path]) for p in points} - possible)


def _pooled(
    x: NDArray[np.float64], y: NDArray[np.float64], squares: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean, or root mean square, of all points at each position."""
    values = np.unique(x)
    power = 2.0 if squares else 1.0
    return values, np.array([np.mean(y[x == value] ** power) ** (1.0 / power) for value in values])


def _dress_x(ax: Axes, axis: dict[str, Any]) -> None:
    """Scale, ticks and label of a swept key."""
    if axis["log"]:
        ax.set_xscale("log")
        _decades(ax.xaxis)
    elif not axis["numeric"]:
        names = [_text(v) for v in axis["values"]]
        turn = 0 if sum(map(len, names)) < 24 else 20
        ax.set_xticks(range(len(names)), names, rotation=turn, ha="right" if turn else "center")
        ax.margins(x=0.15)
    elif 1 < len(axis["values"]) <= 5:
        ax.set_xticks(axis["values"], [_text(v) for v in axis["values"]])
    ax.set_xlabel(key_label(axis), fontsize=8)


def _dress_y(ax: Axes, quantity: _Quantity, values: NDArray[np.float64], limit: float | None) -> None:
    """Scale and label of a quantity; for an error three times the rms on the right, and the limit if in range.

    Parameters
    ----------
    ax : Axes
        The panel.
    quantity : _Quantity
        The quantity.
    values : array
        Values of the panel.
    limit : float, optional
        Specified limit, arcseconds.
    """
    values = values[values > 0]
    if quantity.name == "identification_rate":
        ax.set_ylim(min(ax.get_ylim()[0], 90.0), 101.0)
    elif not quantity.is_error:
        ax.set_ylim(bottom=0)
    elif len(values):
        if limit is not None and limit / 3 <= 3 * values.max():
            ax.axhline(limit / 3, color=VERMILION, linestyle="--", linewidth=1)
        wide = values.max() > 4 * values.min()
        if wide:
            ax.set_yscale("log")
            _decades(ax.yaxis)
        else:
            ax.set_ylim(bottom=0)
        # created after the scale is set: a secondary axis loses its ticks if its parent's scale changes
        right = ax.secondary_yaxis("right", functions=(_three_sigma, _rms))
        right.set_ylabel("3 × rms [arcsec]", fontsize=8)
        if wide:
            _decades(right.yaxis)
    ax.set_ylabel(_Y_LABELS.get(quantity.name, "rms error [arcsec]"))


def _three_sigma(rms: Any) -> Any:
    return 3.0 * rms


def _rms(three_sigma: Any) -> Any:
    return three_sigma / 3.0


def _decades(axis: Any) -> None:
    """Plain numbers at 1, 2 and 5 of every decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
