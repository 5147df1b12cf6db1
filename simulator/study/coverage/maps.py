"""Plots of sky coverage: map, distribution of the counts, and counts by magnitude limit.

The map is an equal-area Mollweide projection with right ascension increasing to the left. Its colour map is *cividis*
(Nuñez, Anderton & Renslow 2018), which is monotone with colour-blindness and in greyscale print.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from simulator.sky.celestial_frames import ECLIPTIC, GALACTIC, equator_of
from simulator.study.plots import BLUE, GREEN, GREY, ORANGE, VERMILION, picture
from startracker.core import FloatArray
from startracker.geometry.attitude import direction_to_radec, radec_to_direction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from simulator.study.coverage.survey import Coverage

_MAP_COLUMNS, _MAP_ROWS = 720, 360
_MOST_MINIMA_DRAWN = 60
_HIGHEST_SHARE = 99.5
"""The colour scale ends at this percentile of the counts, so that a rich cluster does not compress it."""


def coverage_figures(result: Coverage) -> dict[str, Figure]:
    """All plots by the names of their files."""
    return {"map": coverage_map(result), "counts": count_plot(result), "magnitudes": magnitude_plot(result)}


def coverage_map(result: Coverage) -> Figure:
    """Stars in the field by direction of the boresight, over the whole sky or at the instants of a path.

    For several rolls the minimum is shown.
    """
    looks = result.boresights
    figure, ax = _sky_axes()
    top = max(float(np.percentile(result.counts, _HIGHEST_SHARE)), 1.0)
    scale: dict[str, Any] = {"cmap": "cividis", "vmin": 0, "vmax": top}
    if looks.kind == "sky":
        shown = _filled(ax, result, scale)
        what = "whole sky" + (f", minimum of {looks.rolls} rolls" if looks.rolls > 1 else ", one roll per direction")
    else:
        x, y = _plane(looks.directions)
        allowed = looks.allowed
        if not allowed.all():
            ax.scatter(x[~allowed], y[~allowed], s=5, c="#bbbbbb", linewidths=0, label="excluded")
        order = np.flatnonzero(allowed)[np.argsort(-result.counts[allowed], kind="stable")]  # lowest counts on top
        shown = ax.scatter(x[order], y[order], s=9, c=result.counts[order], linewidths=0, **scale)
        what = "along the mission's path"
    for label, matrix, style, colour in (
        ("galactic plane", GALACTIC, ":", GREEN),
        ("ecliptic", ECLIPTIC, "--", ORANGE),
    ):
        _great_circle(ax, matrix, style, colour, label)
    poorest = result.poorest()
    if len(poorest):
        few = poorest[:: -(-len(poorest) // _MOST_MINIMA_DRAWN)]
        label = f"minimum: {int(result.counts[poorest[0]])} stars at {len(poorest)} of {len(looks)}"
        x, y = _plane(looks.directions[few])
        ax.plot(x, y, "x", color="white", ms=8, mew=3.2, linestyle="none")
        ax.plot(x, y, "x", color=VERMILION, ms=7, mew=1.5, linestyle="none", label=label)
    bar = figure.colorbar(shown, ax=ax, orientation="horizontal", shrink=0.6, pad=0.04, aspect=40, extend="max")
    bar.set_label("stars in the field")
    ax.set_title(f"{result.name}: stars to V = {result.magnitude_limit:.2f}, {what}", fontsize=10, pad=14)
    excluded = "\n".join(result.excluded_texts())
    figure.legend(title=excluded, title_fontsize=8, fontsize=8, loc="outside lower center", ncols=5, frameon=False)
    return figure


def count_plot(result: Coverage) -> Figure:
    """Histogram of the counts, their cumulative distribution, and for a path the counts over time."""
    counts = result.allowed_counts
    path = result.boresights.kind == "path"
    figure, grid = picture(2 if path else 1, 2, (10, 7.0 if path else 3.8))
    left, right = grid[0]
    figure.supxlabel("\n".join(result.excluded_texts()), fontsize=8, color=GREY)
    what = "time" if path else "sky"
    if path:
        for ax in grid[1]:
            ax.remove()
        _against_time(figure.add_subplot(2, 1, 2), result)
    left.set_xlabel("stars in the field")
    left.set_ylabel(f"fraction of the {what} [%]")
    right.set_xlabel("stars in the field, k")
    right.set_ylabel(f"fraction of the {what} with fewer than k [%]")
    if not len(counts):
        for ax in (left, right):
            ax.text(0.5, 0.5, "all excluded", transform=ax.transAxes, ha="center", color=GREY)
        return figure
    number = np.bincount(counts)
    left.bar(np.arange(len(number)), 100.0 * number / len(counts), width=0.9, color=BLUE)
    left.axvline(counts.mean(), color=VERMILION, linestyle="--", label=f"mean {counts.mean():.2f}")
    even = result.summary()["stars_if_spread_evenly"]
    left.axvline(even, color=ORANGE, linestyle=":", label=f"uniform star density: {even:.2f}")
    left.legend(fontsize=8)
    # fraction with fewer than k, for k = 0 … max + 1
    fewer = np.concatenate([[0.0], np.cumsum(number)]) / len(counts)
    k = np.arange(len(fewer))
    seen = fewer > 0
    right.semilogy(k[seen], 100.0 * fewer[seen], "o-", color=BLUE, ms=3.5, lw=1.2)
    right.axhline(0.1, color=GREY, linestyle="--", lw=1.0, label="0.1 % (availability 99.9 %)")
    floor = 100.0 / len(counts)
    right.set_ylim(0.5 * min(floor, 0.1), 150.0)
    right.set_xlim(0, None)
    right.axhspan(0.5 * min(floor, 0.1), floor, color="#eeeeee", label=f"below 1 of {len(counts)}")
    right.legend(fontsize=8, loc="lower right")
    figure.suptitle(
        f"{result.name}: stars to V = {result.magnitude_limit:.2f}"
        + (f", {100 * result.boresights.allowed.mean():.1f} % not excluded" if result.boresights.excluded else ""),
        fontsize=10,
    )
    return figure


def magnitude_plot(result: Coverage) -> Figure:
    """Mean, extremes and low percentiles of the counts by magnitude limit."""
    figure, grid = picture(1, 1, (7.4, 4.4))
    ax = grid[0, 0]
    curve = result.curve[result.boresights.allowed]
    ax.set_xlabel("magnitude limit, V")
    ax.set_ylabel("stars in the field")
    ax.set_yscale("symlog", linthresh=1.0)
    if len(curve):
        low = np.percentile(curve, [0.1, 1.0], axis=0, method="inverted_cdf")
        ax.fill_between(
            result.limits, curve.min(axis=0), curve.max(axis=0), color=BLUE, alpha=0.12, lw=0, label="range"
        )
        ax.plot(result.limits, curve.mean(axis=0), "-", color=BLUE, lw=1.8, label="mean")
        ax.plot(result.limits, low[1], "--", color=GREEN, lw=1.4, label="exceeded in 99 %")
        ax.plot(result.limits, low[0], "-.", color=ORANGE, lw=1.4, label="exceeded in 99.9 %")
        ax.plot(result.limits, curve.min(axis=0), ":", color=VERMILION, lw=1.6, label="fewest")
    ax.axvline(result.magnitude_limit, color=GREY, lw=1.0)
    ax.annotate(
        f"V = {result.magnitude_limit:.2f}", (result.magnitude_limit, 0.98), xycoords=("data", "axes fraction"),
        xytext=(-4, 0), textcoords="offset points", rotation=90, va="top", ha="right", fontsize=8, color=GREY,
    )  # fmt: skip
    for stars in (4, 5):
        ax.axhline(stars, color="#cccccc", lw=0.8)
    ax.set_ylim(0, None)
    ax.set_yticks(
        [0, 1, 2, 5, 10, 20, 50, 100, 200, 500], labels=["0", "1", "2", "5", "10", "20", "50", "100", "200", "500"]
    )
    ax.set_ylim(0, max(float(curve.max()) * 1.2, 10.0) if len(curve) else 10.0)
    ax.set_xlim(result.limits[0], result.limits[-1])
    ax.set_title(f"{result.name}: field of {result.summary()['field_deg2']:.1f} square degrees", fontsize=10)
    if len(curve):
        ax.legend(fontsize=8, loc="upper left")
    return figure


def _against_time(ax: Axes, result: Coverage) -> None:
    """Counts at every instant of a path."""
    looks = result.boresights
    longest = float(np.ptp(looks.t_s))
    unit, seconds = ("days", 86_400.0) if longest > 172_800.0 else ("minutes", 60.0)
    allowed = looks.allowed
    for mask, colour, label in ((allowed, BLUE, "allowed"), (~allowed, "#bbbbbb", "excluded")):
        if mask.any():
            ax.plot(looks.t_s[mask] / seconds, result.counts[mask], ".", color=colour, ms=2.5, label=label)
    ax.grid(visible=True, color="#dddddd", lw=0.6)
    ax.set_axisbelow(True)
    ax.set_xlabel(f"{unit} since the epoch")
    ax.set_ylabel("stars in the field")
    ax.set_ylim(0, None)
    if not allowed.all():
        ax.legend(fontsize=8)


# ---------------------------------------------------------------------- the sky
def _plane(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Longitude and latitude for Mollweide axes, right ascension increasing to the left, 180° at the centre."""
    ra, dec = direction_to_radec(directions)
    return -((ra % (2.0 * np.pi)) - np.pi), dec


def _sky_axes() -> tuple[Figure, Axes]:
    from matplotlib.patheffects import withStroke

    figure, grid = picture(1, 1, (10, 6.2), subplot_kw={"projection": "mollweide"})
    ax = grid[0, 0]
    ax.grid(visible=True, color="#999999", lw=0.4)
    hours = np.arange(-150, 151, 30)
    ax.set_xticks(np.radians(hours), [f"{180 - h}°" for h in hours], fontsize=7)
    ax.set_yticks(
        np.radians(np.arange(-60, 61, 30)), [f"{d:+d}°" if d else "0°" for d in range(-60, 61, 30)], fontsize=7
    )
    for text in ax.get_xticklabels():
        text.set_path_effects([withStroke(linewidth=2.2, foreground="white")])
    ax.set_xlabel("right ascension and declination (ICRS) of the boresight", fontsize=8)
    ax.set_axisbelow(False)
    return figure, ax


def _filled(ax: Axes, result: Coverage, scale: dict[str, Any]) -> Any:
    """Count at the nearest direction for every cell of the map; excluded cells are grey."""
    looks = result.boresights
    directions = looks.directions[:: looks.rolls]
    fewest = result.counts.reshape(-1, looks.rolls).min(axis=1).astype(float)
    fewest[~looks.allowed[:: looks.rolls]] = np.nan
    x = np.linspace(-np.pi, np.pi, _MAP_COLUMNS + 1)
    y = np.linspace(-np.pi / 2, np.pi / 2, _MAP_ROWS + 1)
    lon, lat = np.meshgrid(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))
    cells = radec_to_direction(np.pi - lon.ravel(), lat.ravel())
    values = fewest[cKDTree(directions).query(cells)[1]].reshape(lon.shape)
    ax.set_facecolor("#bbbbbb")
    return ax.pcolormesh(x, y, np.ma.masked_invalid(values), rasterized=True, **scale)


def _great_circle(ax: Axes, to_frame: FloatArray, style: str, colour: str, label: str) -> None:
    """Equator of a frame (rows of `to_frame`: its axes in ICRS), interrupted at the edge of the map."""
    x, y = _plane(equator_of(to_frame))
    cuts = np.flatnonzero(np.abs(np.diff(x)) > np.pi / 2) + 1
    for width, ink, name in ((2.6, "white", None), (1.4, colour, label)):
        for n, (px, py) in enumerate(zip(np.split(x, cuts), np.split(y, cuts), strict=True)):
            ax.plot(px, py, style, color=ink, lw=width, label=name if n == 0 else None)
