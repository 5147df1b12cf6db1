"""Figures of the report: each function draws one panel from the columns of the trials into the given axes."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.sky.celestial_frames import ECLIPTIC, GALACTIC, equator_of
from simulator.study.axes import AXES, AXIS_TITLES, BODY_AXES, CAMERA_AXES, axis_heading
from simulator.study.specification.outcome import outcome_flags
from simulator.study.specification.requirements import Specification
from simulator.study.statistics import Binned, error_against
from simulator.study.style import BLUE, GREEN, INK, LINE, ORANGE, SOFT, VERMILION, Panel
from startracker.geometry.attitude import direction_to_radec

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from startracker.catalog.stars import StarCatalog

Columns = Mapping[str, NDArray[Any]]

MARKS = ((BLUE, "o", "-"), (ORANGE, "s", "--"), (GREEN, "^", ":"))
VARIABLES = {
    "stars_matched": ("Number of stars", "stars matched"),
    "orbit_argument_deg": ("Position in the orbit", "argument of latitude [°]"),
    "galactic_latitude_deg": ("Galactic latitude", "galactic latitude of the boresight [°]"),
    "rate_deg_s": ("Angular rate", "angular rate [°/s]"),
    "temperature_c": ("Temperature", "detector temperature [°C]"),
    "limit_mag": ("Limiting magnitude", "faintest star matched [V]"),
}
"""Columns against which errors are plotted if they vary: title, axis label."""
BINS = 10
LEAST_TRIALS = 20
"""Minimum number of solved trials for a trend."""
MANY_POINTS = 1500
"""Above this number points are rasterised, to limit the size of the page."""
_SKY_LIMIT_MAG = 4.5


@dataclass(frozen=True)
class Panels:
    """Figures of the statistics: errors about each axis, dependence on other quantities, and full-width figures."""

    errors: list[Panel]
    trends: list[Panel]
    wide: list[Panel]


def panels(columns: Columns, specification: Specification, catalog: StarCatalog) -> Panels:
    """All panels for the columns; columns missing in older runs are skipped."""
    limits = {each.axis: each.limit for each in reversed(specification.errors)}
    solved = np.asarray(columns["status"]) == "solved"
    errors = [
        Panel(*axis_heading(axis), functools.partial(draw_histogram, columns, axis, limits.get(axis))) for axis in AXES
    ]
    found = []
    note = "Root mean square of the solved trials in each bin, with its 95 % interval."
    for name, (title, label) in VARIABLES.items():
        if solved.sum() >= LEAST_TRIALS and _varies(columns, name, solved):
            found.append(
                Panel(f"Error against {title.lower()}", note, functools.partial(draw_against, columns, name, label))
            )
    if solved.sum() >= LEAST_TRIALS and all(f"bound_{axis}_deg" in columns for axis in CAMERA_AXES):
        found.append(
            Panel(
                "Error against the Cramér–Rao bound",
                "Trials binned by the bound of their stars; the line is error = bound.",
                functools.partial(draw_against_bound, columns),
            )
        )
    if "nees" in columns and np.isfinite(np.asarray(columns["nees"], dtype=float)[solved]).sum() >= LEAST_TRIALS:
        found.append(
            Panel(
                "Consistency of the covariance",
                "Fraction of trials whose error squared, normalised by the stated covariance (NEES), exceeds a "
                "value; the curve is chi-square with three degrees of freedom, the band the 95 % band for a consistent "
                "covariance.",
                functools.partial(draw_nees, columns),
            )
        )
    wide = [
        Panel(
            "Error over time",
            "Largest error relative to its specification (1: at the limit).",
            functools.partial(draw_time_line, columns, specification),
            height_in=2.6,
            wide=True,
        ),
        Panel(
            "Boresights",
            "Boresights of the trials, Sanson–Flamsteed projection, ICRS.",
            functools.partial(draw_sky, columns, catalog.brighter_than(_SKY_LIMIT_MAG)),
            height_in=4.3,
            wide=True,
        ),
    ]
    return Panels(errors, found, wide)


def _varies(columns: Columns, name: str, solved: NDArray[np.bool_]) -> bool:
    if name not in columns:
        return False
    values = np.asarray(columns[name], dtype=float)[solved]
    values = values[np.isfinite(values)]
    return len(values) >= LEAST_TRIALS and bool(np.ptp(values) > 1e-6 * max(1.0, float(np.abs(values).max())))


def draw_histogram(columns: Columns, axis: str, specified_deg: float | None, ax: Axes) -> None:
    """Histogram of the errors about an axis with the normal distribution of the same mean and standard deviation, ±3σ
    and the specification."""
    solved = np.asarray(columns["status"]) == "solved"
    errors = np.asarray(columns[f"error_{axis}_deg"], dtype=float)[solved] * 3600.0
    ax.set_xlabel("error [arcsec]")
    ax.set_ylabel("trials")
    if not len(errors):
        _say(ax, "no solved trials")
        return
    three_sigma = 3 * float(np.sqrt(np.mean(errors**2)))
    limit = specified_deg * 3600.0 if specified_deg else None
    shown = limit is not None and limit < 2.0 * three_sigma
    reach = max(float(np.percentile(np.abs(errors), 99.7)) * 1.2, 1.1 * three_sigma, 1.1 * (limit or 0) * shown, 1e-9)
    bins = np.linspace(-reach, reach, int(np.clip(2 * math.sqrt(len(errors)), 11, 61)) | 1)
    ax.hist(errors, bins=bins.tolist(), color=BLUE, alpha=0.75, linewidth=0)
    if len(errors) > 2 and (std := float(np.std(errors, ddof=1))) > 0:
        x = np.linspace(-reach, reach, 201)
        curve = np.exp(-0.5 * ((x - errors.mean()) / std) ** 2) / (std * math.sqrt(2 * math.pi))
        ax.plot(x, curve * len(errors) * (bins[1] - bins[0]), color=INK, linewidth=1.2, label="normal")
    for sign in (-1, 1):
        ax.axvline(sign * three_sigma, ymax=0.72, color=ORANGE, linestyle="--", linewidth=1.3,
                   label=f"±3σ = {three_sigma:.3g}″" if sign > 0 else None)  # fmt: skip
        if shown and limit is not None:
            ax.axvline(sign * limit, ymax=0.72, color=VERMILION, linewidth=1.6,
                       label=f"specified {limit:.4g}″" if sign > 0 else None)  # fmt: skip
    if limit is not None and not shown:
        ax.plot([], [], color=VERMILION, linewidth=1.6, label=f"specified {limit:.4g}″ (outside)")
    if outside := int(np.sum(np.abs(errors) > reach)):
        ax.plot([], [], " ", label=f"{outside} outside the plot")
    ax.set_ylim(0, ax.get_ylim()[1] * 1.45)
    ax.legend(loc="upper left", ncols=2, columnspacing=1.0, handlelength=1.5)


def draw_against(columns: Columns, name: str, label: str, ax: Axes) -> None:
    """Root-mean-square error about the body axes in bins of a column, with intervals."""
    for axis, look in zip(BODY_AXES, MARKS, strict=True):
        _binned(ax, error_against(columns, name, BINS, axis=axis), look)
    ax.set_xlabel(label)
    _finish_errors(ax)


def draw_against_bound(columns: Columns, ax: Axes) -> None:
    """Root-mean-square error about the camera axes in bins of the Cramér–Rao bound, with the line of equality."""
    for axis, look in zip(CAMERA_AXES, MARKS, strict=True):
        _binned(ax, error_against(columns, f"bound_{axis}_deg", BINS, axis=axis), look, scale=3600.0)
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.plot([low, high], [low, high], color=SOFT, linewidth=1.0, label="the bound")
    ax.set_xlim(low, high)
    ax.set_xlabel("bound, 1σ [arcsec]")
    _plain(ax, "x")
    _finish_errors(ax)


def _binned(ax: Axes, binned: Binned, look: tuple[str, str, str], scale: float = 1.0) -> None:
    colour, marker, line = look
    rms, low, high = (of * 3600.0 for of in (binned.rms_deg, binned.low_deg, binned.high_deg))
    centre = binned.centre * scale
    keep = np.isfinite(rms) & (rms > 0)
    ax.errorbar(
        centre[keep],
        rms[keep],
        yerr=np.nan_to_num([np.maximum(rms - low, 0)[keep], np.maximum(high - rms, 0)[keep]]),
        color=colour,
        marker=marker,
        linestyle=line,
        markersize=4,
        linewidth=1.2,
        elinewidth=0.9,
        capsize=2,
        label=AXIS_TITLES[binned.axis][0],
    )


def _finish_errors(ax: Axes) -> None:
    ax.set_yscale("log")
    ax.set_ylabel("rms error [arcsec]")
    low, high = ax.get_ylim()
    small = ax.bbox.width / ax.figure.dpi < 2.5  # inches: three per row of the PDF
    ax.set_ylim(low, high * (high / low) ** (0.4 if small else 0.22))  # room for the legend
    _plain(ax, "y")
    ax.legend(loc="upper left", ncols=2 if small else 4, columnspacing=1.0, handlelength=1.6)


def _plain(ax: Axes, which: str) -> None:
    """Plain numbers on a logarithmic axis (0.1, 1, 10), with 2 and 5 in between for a small range."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis = ax.xaxis if which == "x" else ax.yaxis
    low, high = ax.get_xlim() if which == "x" else ax.get_ylim()
    few = math.log10(high / low) < 2.2 if low > 0 else False
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw_nees(columns: Columns, ax: Axes) -> None:
    """Survival function of the normalised estimation error squared and of chi-square with three degrees of freedom."""
    from scipy.special import betaincinv, chdtrc, chdtri

    solved = np.asarray(columns["status"]) == "solved"
    values = np.asarray(columns["nees"], dtype=float)[solved]
    values = np.sort(values[np.isfinite(values)])
    n = len(values)
    rank = np.arange(n, 0, -1) / n
    top = max(float(chdtri(3, 0.3 / n)), min(float(values[-1]), 60.0))
    x = np.linspace(0, top, 300)
    expected = chdtrc(3, x)
    # order statistics of n uniform numbers: the k-th largest is Beta(k, n − k + 1)
    k = np.clip(expected * n, 0.5, n)
    low, high = betaincinv(k, n - k + 1, 0.025), betaincinv(k, n - k + 1, 0.975)
    ax.fill_between(x, np.maximum(low, 1e-9), high, color=LINE, alpha=0.7, linewidth=0, label="95 % band")
    ax.plot(x, expected, color=INK, linewidth=1.1, label="chi-square")
    step = np.unique(np.concatenate([np.linspace(0, n - 1, min(n, 400)).astype(int), np.arange(max(0, n - 100), n)]))
    ax.plot(
        values[step], rank[step], color=BLUE, linewidth=1.4, linestyle="--", label=f"trials (mean {values.mean():.2f})"
    )
    ax.set_yscale("log")
    ax.set_ylim(0.5 / n, 1.3)
    ax.set_xlim(0, top)
    _plain(ax, "y")
    ax.set_xlabel("NEES, three axes (expected mean: 3)")
    ax.set_ylabel("fraction of trials above")
    ax.legend(loc="upper right")


def draw_time_line(columns: Columns, specification: Specification, ax: Axes) -> None:
    """Largest error relative to its specification, over time; unsolved trials along the top."""
    t_s = np.asarray(columns["t_s"], dtype=float)
    span = float(np.ptp(t_s)) if len(t_s) else 0.0
    unit, name = (
        (86400.0, "days") if span > 3 * 86400 else ((3600.0, "hours") if span > 3 * 3600 else (60.0, "minutes"))
    )
    share = specification.worst_share({axis: columns[f"error_{axis}_deg"] for axis in AXES})
    solved = (np.asarray(columns["status"]) == "solved") & np.isfinite(share)
    _, inconsistent, wrong = outcome_flags(columns)
    good = solved & ~wrong & ~inconsistent
    many = bool(good.sum() > MANY_POINTS)
    ax.plot(t_s[good] / unit, np.maximum(share[good], 1e-7), ".", color=BLUE, markersize=2.5 if many else 4,
            alpha=0.4 if many else 0.7, markeredgewidth=0, rasterized=many,
            label=f"solved ({int(good.sum())})")  # fmt: skip
    for mask, marker, name in ((inconsistent & ~wrong, "d", "inconsistent"), (wrong, "*", "wrong")):
        if mask.any():
            size, label = (8 if name == "wrong" else 5), f"{name} ({int(mask.sum())})"
            ax.plot(t_s[mask] / unit, share[mask], marker, color=VERMILION, markersize=size, label=label)
    ax.set_yscale("log")
    if good.any() and share[good].max() > 0.05:
        ax.axhline(1.0, color=VERMILION, linewidth=1.4, label="specification")
    if (failed := ~solved).any():
        ax.plot(t_s[failed] / unit, np.full(failed.sum(), 0.97), "x", color=ORANGE, markersize=5,
                transform=ax.get_xaxis_transform(), label=f"not solved ({int(failed.sum())})")  # fmt: skip
    ax.set_xlabel(f"time since the epoch [{name}]")
    ax.set_ylabel("|error| / specified")
    _plain(ax, "y")
    _legend_below(ax, 0.2, 4)


def draw_sky(columns: Columns, bright: StarCatalog, ax: Axes) -> None:
    """Boresights of all trials among the bright stars, Sanson–Flamsteed projection, right ascension increasing to the
    left."""

    def plane(ra_deg: NDArray[Any], dec_deg: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        offset = np.asarray(ra_deg, dtype=float) % 360.0 - 180.0
        return -offset * np.cos(np.radians(dec_deg)) + 180.0, np.asarray(dec_deg, dtype=float)

    latitude = np.linspace(-90, 90, 91)
    for meridian in range(0, 361, 30):
        ax.plot(180.0 - (meridian - 180.0) * np.cos(np.radians(latitude)), latitude, color=LINE, linewidth=0.5)
    for parallel in range(-60, 61, 30):
        reach = 180.0 * np.cos(np.radians(parallel))
        ax.plot([180 - reach, 180 + reach], [parallel, parallel], color=LINE, linewidth=0.5)
    x, y = plane(np.degrees(bright.ra_rad), np.degrees(bright.dec_rad))
    ax.scatter(x, y, s=10 ** (0.2 * (_SKY_LIMIT_MAG - bright.v_mag)), color=SOFT, linewidths=0, alpha=0.8,
               label=f"stars, V ≤ {_SKY_LIMIT_MAG:g}")  # fmt: skip
    for label, frame, line, colour in (("ecliptic", ECLIPTIC, "--", ORANGE), ("galactic plane", GALACTIC, ":", GREEN)):
        x, y = plane(*np.degrees(direction_to_radec(equator_of(frame))))
        cuts = np.flatnonzero(np.abs(np.diff(x)) > 90) + 1
        for n, (px, py) in enumerate(zip(np.split(x, cuts), np.split(y, cuts), strict=True)):
            ax.plot(px, py, line, color=colour, linewidth=1.2, label=None if n else label)
    solved = np.asarray(columns["status"]) == "solved"
    _, inconsistent, wrong = outcome_flags(columns)
    for mask, colour, marker, size, label in (
        (solved, BLUE, ".", 3, "solved"),
        (~solved, VERMILION, "x", 6, "not solved"),
        (inconsistent & ~wrong, VERMILION, "d", 5, "inconsistent"),
        (wrong, INK, "*", 8, "wrong"),
    ):
        if mask.any():
            x, y = plane(columns["true_ra_deg"][mask], columns["true_dec_deg"][mask])
            ax.plot(x, y, marker, color=colour, markersize=size, rasterized=bool(mask.sum() > MANY_POINTS),
                    label=f"{label} ({int(mask.sum())})")  # fmt: skip
    ax.set_aspect("equal")
    ax.set_xlim(0, 360)
    ax.set_ylim(-90, 90)
    ax.set_xticks(range(0, 361, 60), [f"{360 - ra}°" for ra in range(0, 361, 60)])
    ax.set_yticks(range(-90, 91, 30), [f"{d:+d}°" if d else "0°" for d in range(-90, 91, 30)])
    ax.set_xlabel("right ascension at the equator")
    ax.set_ylabel("declination")
    ax.grid(visible=False)
    _legend_below(ax, 0.14, 6)


def _legend_below(ax: Axes, share: float, columns: int) -> None:
    if ax.figure.bbox.width / ax.figure.dpi < 5.0:  # inches: for a phone
        share, columns = share + 0.1, min(columns, 2)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -share), ncols=columns, columnspacing=1.2, borderaxespad=0.0)


def _say(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color=SOFT)
