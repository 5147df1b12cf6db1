"""Figures of a datasheet; each stage of life is a curve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.study.axes import CAMERA_AXES
from simulator.study.datasheet.scan import STEP_PX
from simulator.study.style import BLUE, GREEN, ORANGE, SOFT, VERMILION, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from simulator.study.datasheet.result import Column

LOOKS = ((BLUE, "o", "-"), (ORANGE, "s", "--"))
"""Colour, marker and line of each stage of life."""

SPECTRUM_NOTE = (
    "Against the spatial frequency of the motion. What the passes with other pixels repeat is the FOV spatial error. "
    "What only the same pixels repeat is the pixel spatial error: of uneven pixels, and, at the harmonics of the pixel "
    "period (dotted: the first ones, aliased), of interpolation."
)

Points = Sequence[dict[str, Any]]


def panels(columns: Sequence[Column]) -> list[Panel]:
    """All figures: spectrum, error against conditions, availability."""
    first = columns[0]
    found = [
        Panel(
            f"Spectrum of the errors, {axis.replace('_', ' ')}, {first.life}",
            SPECTRUM_NOTE,
            partial(_draw_spectrum, first, k),
        )
        for k, axis in enumerate(CAMERA_AXES)
        if axis != "cross_y"
    ]
    found += [
        Panel(
            "Error against the angular rate",
            "Rms about the axis of rotation, which is along the motion of the stars; bars: 95 %.",
            partial(_draw, columns, lambda c: c.points["rates"], "along_rms_arcsec", "angular rate [°/s]", RMS),
        ),
        Panel(
            "Availability against the angular rate",
            "Share of correct attitudes from single frames; bars: 95 %.",
            partial(_draw, columns, lambda c: c.points["rates"], "available", "angular rate [°/s]", SHARE),
        ),
        Panel(
            "Error against the number of stars",
            "Rms per axis across the boresight, groups of equal size.",
            partial(_draw, columns, lambda c: c.points["stars"], "cross_rms_arcsec", "stars matched", RMS),
        ),
    ]
    labels = {
        "temperature": ("the detector's temperature", "temperature [°C]"),
        "false_stars": ("false stars", "false stars per frame"),
        "particles": ("charged particles", "flux [cm⁻² s⁻¹]"),
        "hot_pixels": ("hot pixels", "fraction of hot pixels"),
    }
    for k, series in enumerate(first.series):
        title, label = labels[series.name]
        found.append(
            Panel(
                f"Error against {title}",
                "Rms per axis across the boresight; the share of correct attitudes is written where it is below 100 %.",
                partial(_draw_series, columns, k, label),
            )
        )
    for name, label in (("orbit", "argument of latitude [°]"), ("year", "months from the epoch")):
        found.append(
            Panel(
                f"Availability over the {name}",
                "Share of correct attitudes from single frames of the mission; bars: 95 %.",
                partial(_draw, columns, partial(_named_points, name), "available", label, SHARE),
            )
        )
    return found


RMS, SHARE = "rms error [″]", "availability"


def _named_points(name: str, column: Column) -> Points:
    return column.points[name]


def _draw(
    columns: Sequence[Column], points_of: Callable[[Column], Points], key: str, label: str, quantity: str, ax: Axes
) -> None:
    """Points with error bars of every stage of life."""
    for column, look in zip(columns, LOOKS, strict=False):
        _curve(ax, points_of(column), key, column.life, look)
    ax.set_xlabel(label)
    ax.set_ylabel(quantity)
    low, high = ax.get_ylim()
    if quantity == SHARE:
        ax.set_ylim(min(low, 0.9) if low > 0.5 else -0.03, 1.02)
    else:
        ax.set_ylim(0.0, high)
    if len(columns) > 1:
        ax.legend(loc="lower left" if quantity == SHARE else "best")


def _curve(ax: Axes, points: Points, key: str, name: str, look: tuple[str, str, str]) -> None:
    """Known points with their intervals."""
    colour, marker, line = look
    known = [point for point in points if point[key][0] is not None]
    if not known:
        return
    x = np.array([point.get("value", point.get("rate_deg_s")) for point in known], dtype=float)
    value, low, high = np.array([[np.nan if p is None else p for p in point[key]] for point in known]).T
    # an interval of the bootstrap need not contain its value to the last digit
    bars = np.abs(np.stack([np.nan_to_num(value - low), np.nan_to_num(high - value)]))
    ax.errorbar(x, value, bars, color=colour, marker=marker, linestyle=line, markersize=4, capsize=2, label=name)


def _draw_series(columns: Sequence[Column], number: int, label: str, ax: Axes) -> None:
    """Error against a condition; logarithmic beyond two decades."""
    for column, look in zip(columns, LOOKS, strict=False):
        points = column.series[number].points
        _curve(ax, points, "cross_rms_arcsec", column.life, look)
        for point in points if column is columns[0] else ():
            if point["cross_rms_arcsec"][0] is not None and point["available"][0] < 1.0:
                where = (point["value"], point["cross_rms_arcsec"][0])
                share = f"{100 * point['available'][0]:.0f} %"
                ax.annotate(share, where, (0, 7), textcoords="offset points", ha="center", fontsize=7, color=SOFT)
    values = [point["value"] for point in columns[0].series[number].points if point["value"] > 0.0]
    if values and min(values) > 0.0 and max(values) > 50.0 * min(values):
        ax.set_xscale("symlog", linthresh=min(values))
    ax.margins(x=0.1)
    ax.set_xlabel(label)
    ax.set_ylabel(RMS)
    ax.set_ylim(0.0, 1.2 * ax.get_ylim()[1])
    if len(columns) > 1:
        ax.legend()


def _draw_spectrum(column: Column, axis: int, ax: Axes) -> None:
    """Spectral densities; negative values of the cross-spectra are noise, and are left out."""
    spectra = column.accuracy.separated.spectra
    curves = (
        ("total", spectra.total, SOFT, "-"),
        ("noise", spectra.noise, BLUE, "--"),
        ("repeated by the same pixels", spectra.repeated, VERMILION, "-"),
        ("repeated by other pixels", spectra.common, GREEN, ":"),
    )
    floor = 1e-4 * float(np.max(spectra.total[:, axis]))
    for name, density, colour, line in curves:
        values = density[:, axis]
        ax.plot(
            spectra.cycles_per_px, np.where(values > floor, values, np.nan), color=colour, linestyle=line, label=name
        )
    for step in STEP_PX:
        ax.axvline(abs(step - round(step)) / column.accuracy.geometry.step_px, color=SOFT, linestyle=":", linewidth=0.8)
    ax.set_yscale("log")
    ax.set_xlabel("spatial frequency [cycles / pixel]")
    ax.set_ylabel("density [″² px]")
    ax.legend(loc="best")
