"""Plots of a sweep: errors and identification rate by swept key, and maps over two keys.

A logarithmic range has a logarithmic axis; names and mixed lists are categories. Grey crosses mark unphysical points.
The colours are those of Okabe & Ito (2008); curves also differ in their markers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.plots import BLUE, GREEN, GREY, ORANGE, TITLES, VERMILION, picture, save_bytes
from simulator.study.statistics import AXES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_CURVES = 6
"""Maximum number of curves in a panel; above it points and their pooled rms are drawn."""

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, "#CC79A7", "#444444")
_MARKERS = "osD^vP"
_ARCSEC = 3600.0
Point = dict[str, Any]


@dataclass(frozen=True)
class SweepFigure:
    """A figure of the page: stem of its file, heading, caption, and the PNG."""

    name: str
    title: str
    note: str
    png: bytes


def sweep_figures(table: dict[str, Any]) -> list[SweepFigure]:
    """All figures of a sweep.

    Parameters
    ----------
    table : dict
        As in ``sweep.json``.
    """
    figures = []
    for axis in table["swept"]:
        figure, note = against(table, axis["path"])
        name = f"errors_against_{axis['path'].replace('.', '_')}"
        figures.append(SweepFigure(name, f"Against {_label(axis)}", note, save_bytes(figure)))
    if len(table["swept"]) == 2 and table["kind"] == "grid":
        down, across = table["swept"]
        note = "Values are rms errors in arcseconds, or identification rates in per cent; darker is worse."
        title = f"{_label(down)} and {_label(across)} together"
        figures.append(SweepFigure("map", title, note, save_bytes(error_maps(table))))
    return figures


def against(table: dict[str, Any], path: str) -> tuple[Figure, str]:
    """Rms error about each axis, identification rate and matched stars by one key, and the caption."""
    axis = next(a for a in table["swept"] if a["path"] == path)
    others = [a["path"] for a in table["swept"] if a["path"] != path]
    done = [p for p in table["points"] if "statistics" in p]
    position = _position_along(axis, table["points"])
    families: dict[tuple[Any, ...], list[Point]] = {}
    for point in done:
        families.setdefault(tuple(point["values"][other] for other in others), []).append(point)
    curves = table["kind"] == "grid" and len(families) <= MAX_CURVES
    figure, panels = figure_of_panels()
    refused = _refused_everywhere(table["points"], path, position)
    for ax, (name, title, scale) in zip(panels.ravel(), _quantities(), strict=True):
        if curves:
            for n, (values, points) in enumerate(families.items()):
                x, y, low, high = _series(points, path, position, name, scale)
                label = ", ".join(f"{o.rpartition('.')[2]} {_text(v)}" for o, v in zip(others, values, strict=True))
                colour, marker = _COLOURS[n % len(_COLOURS)], _MARKERS[n % len(_MARKERS)]
                ax.plot(x, y, f"{marker}-", color=colour, markersize=4, linewidth=1.2, label=label or "rms")
                ax.errorbar(x, y, _bars(y, low, high), fmt="none", ecolor=colour, elinewidth=1, capsize=2.5)
        else:
            x, y, low, high = _series(done, path, position, name, scale)
            ax.errorbar(x, y, _bars(y, low, high), fmt="o", color=BLUE, markersize=3, elinewidth=0.6, alpha=0.45,
                        label="single point")  # fmt: skip
            if table["kind"] == "grid":
                ax.plot(
                    *_pooled(x, y, squares=name in AXES),
                    "s-",
                    color=VERMILION,
                    markersize=4,
                    label="all points",
                )
        if refused:
            ax.plot(refused, [0.03] * len(refused), "x", color=GREY, transform=ax.get_xaxis_transform(),
                    label="unphysical", clip_on=False)  # fmt: skip
        found = [p["statistics"][_column(name)] for p in done]
        limit_deg = table["specification_deg"].get(name)
        _dress_x(ax, axis)
        shown = np.array([v * scale for v in found if v is not None])
        _dress_y(ax, name, title, shown, limit_deg and limit_deg * _ARCSEC)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    if len(labels) > 1 or not curves:
        figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=4, frameon=False)
    return figure, (
        "Rms error (left scale) and 3σ, three times the rms (right scale); dashed: specified 3σ. "
        "Bars: 95 % intervals, by bootstrap, and Wilson's for the identification rate. "
        + ("" if curves else "The other keys vary between points. ")
        + "All points share the same attitudes and random numbers, so differences are more accurate than the "
        "bars suggest."
    )


def error_maps(table: dict[str, Any]) -> Figure:
    """Maps of the rms error about each axis and of the identification rate over two swept keys."""
    down, across = table["swept"]
    rows, columns = down["values"], across["values"]
    at = {(p["values"][down["path"]], p["values"][across["path"]]): p for p in table["points"]}
    figure, panels = figure_of_panels((12.5, 1.8 + 2 * max(2.2, 0.3 * len(rows))))
    for ax, (name, title, scale) in zip(panels.ravel(), _quantities(), strict=True):
        grid = np.full((len(rows), len(columns)), np.nan)
        for i, r in enumerate(rows):
            for j, c in enumerate(columns):
                statistics = at[r, c].get("statistics")
                value = statistics and statistics[_column(name)]
                if value is not None:
                    grid[i, j] = value * scale
                if at[r, c]["status"] == "refused":
                    ax.text(j, i, "×", ha="center", va="center", color=GREY)
        shade = np.log(np.maximum(grid, 1e-12)) if name in AXES else -grid
        ax.imshow(shade, cmap="Blues", aspect="auto", origin="lower", interpolation="nearest")
        if grid.size <= 150:
            finite = shade[np.isfinite(shade)]
            middle = 0.5 * (finite.min() + finite.max()) if len(finite) else 0.0
            for i, j in np.argwhere(np.isfinite(grid)):
                dark = shade[i, j] > middle and finite.max() > finite.min()
                ax.text(j, i, f"{grid[i, j]:.3g}", ha="center", va="center", fontsize=6.5,
                        color="white" if dark else "black")  # fmt: skip
        ax.set_title(f"{title.split(' (')[0]} {'rms [arcsec]' if name in AXES else _Y_LABELS[name]}", fontsize=8)
        ax.set_xticks(range(len(columns)), [_text(v) for v in columns], rotation=0 if len(columns) < 6 else 60)
        ax.set_yticks(range(len(rows)), [_text(v) for v in rows])
        ax.set_xlabel(_label(across), fontsize=8)
        ax.set_ylabel(_label(down), fontsize=8)
        ax.grid(visible=False)
    return figure


_Y_LABELS = {"identification_rate": "identified [%]", "stars_matched_mean": "stars matched, mean"}


def _quantities() -> list[tuple[str, str, float]]:
    """Name, title and scale of the eight panels."""
    rows = [(axis, TITLES[axis], _ARCSEC) for axis in AXES]
    rows.insert(3, ("identification_rate", "", 100.0))
    return [*rows, ("stars_matched_mean", "", 1.0)]


def _column(name: str) -> str:
    return f"{name}_rms_deg" if name in AXES else name


def figure_of_panels(size: tuple[float, float] = (12.5, 6.2), **axes: Any) -> tuple[Figure, NDArray[Any]]:
    """Empty figure of two rows of four panels, sizes in inches; `axes` go to matplotlib's ``subplots``."""
    return picture(2, 4, size, **axes)


def _label(axis: dict[str, Any]) -> str:
    return f"{axis['path']} [{axis['unit']}]" if axis["unit"] else str(axis["path"])


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _position_along(axis: dict[str, Any], points: list[Point]) -> Any:
    """Function from a value to its position on the axis: the value, or the index of a name."""
    if axis["numeric"]:
        return float
    names = list(dict.fromkeys(axis["values"] or [p["values"][axis["path"]] for p in points]))
    return lambda value: float(names.index(value))


def _series(points: list[Point], path: str, position: Any, name: str, scale: float) -> tuple[NDArray[np.float64], ...]:
    """Position, value and interval of every point with the statistic, by position; NaN without an interval."""
    low, high = f"{name}_rms_low_deg", f"{name}_rms_high_deg"
    if name not in AXES:
        low, high = f"{name}_low", f"{name}_high"
    rows = []
    for point in points:
        s = point["statistics"]
        if s[_column(name)] is not None:
            ends = [np.nan if s.get(key) is None else s[key] for key in (low, high)]
            rows.append([position(point["values"][path]), s[_column(name)] * scale, ends[0] * scale, ends[1] * scale])
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
    ax.set_xlabel(_label(axis), fontsize=8)


def _dress_y(ax: Axes, name: str, title: str, values: NDArray[np.float64], limit: float | None) -> None:
    """Scale and label of a statistic; for an error 3σ on the right, and the specification if it is within range.

    Parameters
    ----------
    ax : Axes
        The panel.
    name, title : str
        Name and heading of the statistic.
    values : array
        Values of the panel.
    limit : float, optional
        Specified 3σ, arcseconds.
    """
    values = values[values > 0]
    if name == "identification_rate":
        ax.set_ylim(min(ax.get_ylim()[0], 90.0), 101.0)
    elif name not in AXES:
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
        right.set_ylabel("3σ [arcsec]", fontsize=8)
        if wide:
            _decades(right.yaxis)
    ax.set_ylabel(_Y_LABELS.get(name, "rms error [arcsec]"))
    ax.set_title(title + ("" if limit is None else f"\nspecified 3σ {limit:.4g}″"), fontsize=8)


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
