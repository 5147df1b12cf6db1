"""Tables of a datasheet as text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from simulator.study.axes import CAMERA_AXES
from simulator.study.datasheet.classes import CLASSES
from simulator.study.datasheet.sheet import LEVELS, Estimate, Quantity, select
from simulator.study.datasheet.words import TERMS
from simulator.study.pages.page import Table

if TYPE_CHECKING:
    from simulator.study.datasheet.result import Column

UNITS = {"arcsec": "″", "deg": "°", "deg/s": "°/s", "deg/s2": "°/s²", "s": "s", "Hz": "Hz"}
AXIS_NAMES = {"cross_x": "x", "cross_y": "y", "about_boresight": "about"}
"""Short names of the camera's axes."""

ROWS = (*CLASSES, "temporal_noise_worst_field", "noise_bound", "sum_of_classes", "measurement_error")
"""Rows of the table of the accuracy."""


def number_text(value: float, largest: float | None = None) -> str:
    """A number with three significant digits, or as many decimals as three digits of `largest` have."""
    size = abs(value if largest is None else largest)
    if size == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "–"
    decimals = max(0, 2 - math.floor(math.log10(size)))
    shown = f"{value:.{decimals}f}" if decimals <= 6 else f"{value:.1e}"
    return shown.replace("-", "−")


def estimate_text(size: Estimate, unit: str = "", percent: bool = False) -> str:
    """Value and interval: ``0.126″ (0.108–0.156)``, or ``0.126″ (≥ 0.108)`` without an upper limit. Angles below
    0.001″ are in milliarcseconds."""
    value, low, high = size.plain()
    if value is None:
        return "not determined"
    if unit == "arcsec" and 0.0 < max(abs(part) for part in (value, low, high) if part is not None) < 1e-3:
        return estimate_text(size.times(1000.0), "mas")
    scale, sign = (100.0, " %") if percent else (1.0, UNITS.get(unit, unit))
    gap = " " if sign[:1].isalpha() else ""
    known = [scale * part for part in (value, low, high) if part is not None]
    largest = max(map(abs, known))
    value_text, *ends = (number_text(part, largest) for part in known)
    shown = f"{value_text}{gap}{sign}"
    if low is None and high is None:
        return shown
    if (low, high) == (value, value):
        return f"{shown} (exact)"
    if low is None or high is None:
        return f"{shown} ({'≤' if low is None else '≥'} {ends[0]})"
    return f"{shown} ({' to '.join(ends) if low < 0.0 else '–'.join(ends)})"


def accuracy_table(column: Column) -> Table:
    """Classes by axis: rms or mean, and the levels."""
    values = column.sections["accuracy"] + column.sections["residuals"]
    rows = []
    for name in (*ROWS[:1], "thermo_elastic", "thermo_elastic_mounting", *ROWS[1:5], "aberration_residual", *ROWS[5:]):
        for axis in CAMERA_AXES:
            cells = [_first(values, (f"{name}_mean", f"{name}_rms", name), axis)]
            cells += [select(values, name, axis, level) for level in LEVELS]
            known = [cell for cell in cells if cell is not None]
            if known:
                title = known[0].title.split(", rms")[0].split(", mean")[0] if axis == CAMERA_AXES[0] else ""
                spread = known[-1].interpretation if axis == CAMERA_AXES[0] else ""
                texts = ["" if cell is None else estimate_text(cell.estimate, cell.unit) for cell in cells]
                rows.append((title, AXIS_NAMES[axis], spread, *texts))
    headings = ("class", "axis", "interpretation", "mean or rms", *(f"{level:g} %" for level in LEVELS))
    note = (
        "Camera axes: x and y across the boresight, and about it. Intervals in brackets: 95 % confidence. Bias and "
        "thermo-elastic error: mean; all others: rms."
    )
    return Table(headings, tuple(rows), (0, 1, 2), note)


def _first(values: Sequence[Quantity], names: Sequence[str], axis: str) -> Quantity | None:
    for name in names:
        if (found := select(list(values), name, axis)) is not None:
            return found
    return None


def list_table(columns: Sequence[Column], section: str) -> Table:
    """Values of a section, one row each; a column for every stage of life, and the method."""
    rows = []
    for quantity in columns[0].sections[section]:
        cells = []
        for column in columns:
            own = select(column.sections[section], quantity.name)
            cells.append("–" if own is None else estimate_text(own.estimate, own.unit, percent=not own.unit))
        rows.append((quantity.title, *cells, quantity.method))
    lives = tuple(column.life for column in columns)
    return Table(("quantity", *lives, "method"), tuple(rows), (0, len(lives) + 1))


def rate_table(columns: Sequence[Column]) -> Table:
    """Errors against the angular rate, and the greatest rate."""
    parts = (
        ("along_rms_arcsec", "rms about the axis of rotation"),
        ("along_mean_arcsec", "mean about it"),
        ("across_rms_arcsec", "rms across it"),
        ("about_rms_arcsec", "rms about the boresight"),
    )
    rows = []
    for column in columns:
        for point in column.points["rates"]:
            errors = (estimate_text(Estimate(*point[key]), "arcsec") for key, _ in parts)
            share = estimate_text(Estimate(*point["available"]), percent=True)
            rows.append((column.life, f"{point['rate_deg_s']:g}°/s", share, *errors))
    headings = ("life", "rate", "available", *(title for _, title in parts))
    return Table(headings, tuple(rows), (0, 1), "Single frames at rates about axes across the boresight.")


def conditions_table(columns: Sequence[Column]) -> Table:
    """Errors and availability against temperature, false stars, particles and hot pixels."""
    rows = []
    for column in columns:
        for series in column.series:
            for point in series.points:
                unit = f" {series.unit}" if series.unit else ""
                share = estimate_text(Estimate(*point["available"]), percent=True)
                errors = (
                    estimate_text(Estimate(*point[f"{part}_rms_arcsec"]), "arcsec") for part in ("cross", "about")
                )
                rows.append((column.life, f"{series.title} {point['value']:g}{unit}", share, *errors))
    headings = ("life", "condition", "available", "rms per axis across the boresight", "rms about the boresight")
    return Table(headings, tuple(rows), (0, 1))


def terms_table() -> Table:
    """Classes, their meaning, and where their definition was read."""
    rows = tuple((term.title, term.meaning, term.method, term.source) for term in TERMS.values())
    return Table(("class", "meaning", "measured as", "definition"), rows, (0, 1, 2, 3))
