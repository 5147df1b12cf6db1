"""Plots of a sequence: each panel shows one quantity over time from the columns of the frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from simulator.study.axes import BODY_AXES, CAMERA_AXES, axis_heading
from simulator.study.sequence.calibration_plots import calibration_panels
from simulator.study.sequence.frames import MODES
from simulator.study.sequence.operation_plots import operation_panels
from simulator.study.sequence.time_axis import draw_strip, nearly_all, time_axis
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION, Panel
from startracker.core import Columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MODE_COLOURS = {"tracking": GREEN, "prior": BLUE, "lost_in_space": ORANGE, "coasting": VERMILION, "none": SOFT}
MODE_TITLES = {
    "tracking": "tracking",
    "prior": "whole frame",
    "lost_in_space": "lost in space",
    "coasting": "coasting",
    "none": "no attitude",
}
_MANY_FRAMES = 1500
"""Above this number points are rasterised, as vector graphics would make the page slow."""


def panels(columns: Columns) -> dict[str, list[Panel]]:
    """All panels of the page by their heading."""
    groups = {
        "Modes and stars": [
            Panel("Mode", "Source of the attitude of each frame.", lambda ax: draw_modes(ax, columns), 2.2),
            Panel("Stars", "Guide stars in the field, searched for, and matched.", lambda ax: _stars(ax, columns), 2.2),
        ],
        "Errors about the body axes": [_error_panel(axis, columns) for axis in BODY_AXES],
        "Errors about the camera axes": [_error_panel(axis, columns) for axis in CAMERA_AXES],
        "Consistency": [
            Panel(
                "NEES",
                "Normalised estimation error squared of the attitude (3 degrees of freedom): for a consistent filter "
                "95 % of the frames are below the line, and the mean is 3.",
                lambda ax: _nees(ax, columns),
            )
        ],
        "Attitude": [
            Panel(f"{name} of the camera", "", _attitude_drawer(key, columns))
            for name, key in (("Right ascension", "ra_deg"), ("Declination", "dec_deg"), ("Roll", "roll_deg"))
        ],
        "Rate": [
            Panel(f"Rate about the camera's {axis}", "", draw_compared(f"rate_{axis}_deg_s", "rate [°/s]", columns))
            for axis in "xyz"
        ],
    }
    if "rule" in columns:
        groups["Rules of operation"] = operation_panels(columns)
    if "lens_updated" in columns:
        groups["Calibration in flight"] = calibration_panels(columns)
    if "true_bias_x_deg_h" in columns:
        whose = "body" if any(name.startswith("head_") for name in columns) else "camera"
        groups["Gyro"] = [
            Panel(f"Bias about the {whose}'s {axis}", "", draw_compared(f"bias_{axis}_deg_h", "bias [°/h]", columns))
            for axis in "xyz"
        ]
    if "true_scale_x_ppm" in columns:
        groups["Gyro"] += [
            Panel(f"Scale factor, {axis}", "", draw_compared(f"scale_{axis}_ppm", "error [ppm]", columns))
            for axis in "xyz"
        ]
    return groups


def draw_modes(ax: Axes, columns: Columns) -> None:
    """Modes as a strip chart: one row per mode, with bars for its frames."""
    shown = [m for m in MODES if np.any(columns["mode"] == m)]
    for row, name in enumerate(shown):
        draw_strip(ax, columns, row, columns["mode"] == name, color=MODE_COLOURS[name])
    ax.set_yticks(range(len(shown)), [MODE_TITLES[m] for m in shown])
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.grid(visible=False, axis="y")
    time_axis(ax, columns)


def draw_error(ax: Axes, columns: Columns, axis: str) -> None:
    """Error of the filter with its ±3σ, and of the frames solved on their own, if any."""
    t = columns["elapsed_s"]
    many = len(t) > _MANY_FRAMES
    error, sigma = columns[f"error_{axis}_deg"] * 3600.0, columns[f"sigma_{axis}_deg"] * 3600.0
    solved = columns["status"] == "solved"
    ax.fill_between(t, -3.0 * sigma, 3.0 * sigma, color=BLUE, alpha=0.15, linewidth=0, label="±3σ", rasterized=many)
    shown = [error, 3.0 * sigma]
    if f"single_error_{axis}_deg" in columns:
        single = columns[f"single_error_{axis}_deg"] * 3600.0
        shown.append(single)
        ax.plot(t, single, ".", color=ORANGE, markersize=2.5, label="single frame", rasterized=many)
    ax.plot(t, error, "-", color=BLUE, linewidth=1.0, label="tracking", rasterized=many)
    if np.any(~solved & np.isfinite(error)):
        ax.plot(t[~solved], error[~solved], "x", color=VERMILION, markersize=3.5, label="not solved", rasterized=many)
    if (reach := nearly_all(*shown)) > 0.0:
        ax.set_ylim(-1.5 * reach, 1.9 * reach)
    ax.set_ylabel("error [″]")
    ax.legend(loc="upper right", ncols=2, framealpha=0.8)
    time_axis(ax, columns)


def _error_panel(axis: str, columns: Columns) -> Panel:
    return Panel(*axis_heading(axis), lambda ax: draw_error(ax, columns, axis))


def _stars(ax: Axes, columns: Columns) -> None:
    t = columns["elapsed_s"]
    many = len(t) > _MANY_FRAMES
    came = columns["status"] != "no_frame"
    ax.plot(
        t[came], columns["stars_in_field"][came], "-", color=SOFT, linewidth=0.8, label="in the field", rasterized=many
    )
    expected = columns["stars_expected"]
    looked = came & (expected > 0)
    ax.plot(t[looked], expected[looked], ".", color=ORANGE, markersize=2.5, label="searched for", rasterized=many)
    ax.plot(
        t, columns["stars_matched"], ".-", color=BLUE, markersize=3, linewidth=0.8, label="matched", rasterized=many
    )
    ax.set_ylim(bottom=0, top=1.45 * max(1, int(columns["stars_in_field"].max()), int(expected.max())))
    ax.legend(loc="upper right", ncols=3)
    time_axis(ax, columns)


def _nees(ax: Axes, columns: Columns) -> None:
    t, nees = columns["elapsed_s"], columns["nees"]
    limit = float(chdtri(3, 0.05))
    ax.plot(t, nees, ".", color=BLUE, markersize=3, label="frame", rasterized=len(t) > _MANY_FRAMES)
    ax.axhline(limit, color=VERMILION, linestyle="--", linewidth=1.0, label="95 %")
    ax.axhline(3.0, color=INK, linewidth=0.8, label="expected mean")
    finite = nees[np.isfinite(nees)]
    ax.set_ylim(0.0, 1.35 * max(limit, float(finite.max(initial=0.0))))
    ax.set_ylabel("NEES")
    ax.legend(loc="upper right", ncols=3)
    time_axis(ax, columns)


def _attitude_drawer(key: str, columns: Columns) -> Callable[[Axes], None]:
    def draw(ax: Axes) -> None:
        t = columns["elapsed_s"]
        many = len(t) > _MANY_FRAMES
        true = columns[f"true_{key}"]
        if key != "dec_deg":
            true = np.degrees(np.unwrap(np.radians(true)))
        off = columns[key] - true
        estimate = true + (off if key == "dec_deg" else (off + 180.0) % 360.0 - 180.0)
        solved = columns["status"] == "solved"
        ax.plot(t, true, "-", color=INK, linewidth=1.0, label="true", rasterized=many)
        ax.plot(t[solved], estimate[solved], ".", color=BLUE, markersize=3, label="solved", rasterized=many)
        if np.any(~solved & np.isfinite(estimate)):
            ax.plot(
                t[~solved], estimate[~solved], "x", color=VERMILION, markersize=3.5, label="predicted", rasterized=many
            )
        ax.set_ylabel("[°]")
        ax.ticklabel_format(useOffset=False)
        ax.margins(y=0.15)
        ax.legend(loc="best")
        time_axis(ax, columns)

    return draw


def draw_compared(key: str, label: str, columns: Columns) -> Callable[[Axes], None]:
    """True and estimated value with ±3σ."""

    def draw(ax: Axes) -> None:
        t = columns["elapsed_s"]
        many = len(t) > _MANY_FRAMES
        true, value, sigma = columns[f"true_{key}"], columns[key], columns[f"sigma_{key}"]
        low, high = value - 3.0 * sigma, value + 3.0 * sigma
        ax.fill_between(t, low, high, color=BLUE, alpha=0.15, linewidth=0, label="±3σ", rasterized=many)
        ax.plot(t, value, ".", color=BLUE, markersize=3, label="estimated", rasterized=many)
        ax.plot(t, true, "-", color=INK, linewidth=1.0, label="true", rasterized=many)
        finite = np.concatenate([true, _most(value)])
        middle = 0.5 * (float(finite.min()) + float(finite.max()))
        known = sigma[np.isfinite(sigma)]
        reach = 0.5 * float(np.ptp(finite)) + 3.0 * (float(np.median(known)) if len(known) else 0.0)
        if reach > 0.0:
            ax.set_ylim(middle - 1.2 * reach, middle + 1.7 * reach)
        ax.set_ylabel(label)
        ax.ticklabel_format(useOffset=False)
        ax.legend(loc="upper right", ncols=3)
        time_axis(ax, columns)

    return draw


def _most(values: NDArray[Any]) -> NDArray[Any]:
    """Finite values without the extreme 3 %, such as those before the second frame."""
    finite = values[np.isfinite(values)]
    return np.asarray(np.percentile(finite, [3.0, 97.0])) if len(finite) else finite
