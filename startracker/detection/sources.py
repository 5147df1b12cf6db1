"""The table of sources: what stands above the threshold, a row each, with the sums over its pixels."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.detection.plane import Plane
from startracker.detection.thresholds import FLAT_TOP_PIXELS
from startracker.detection.values import Image

SOURCE = np.dtype(
    [
        ("pixels", np.int64),  # number of pixels
        ("flux", np.float64),  # sum of their signals, which are values less the background, DN
        ("x_peak", np.int64),  # brightest pixel; of equal ones the first in reading order
        ("y_peak", np.int64),
        ("peak", np.float64),  # its value, DN
        ("peak_residual", np.float64),  # its signal, DN
        ("at_peak", np.int64),  # pixels of that value
        ("saturated", np.int64),  # pixels at saturation
        ("edge", np.bool_),  # whether a pixel is on the border of the image
        ("sum_x", np.float64),  # sums over the pixels, weighted with the signal, DN px and DN px²
        ("sum_y", np.float64),
        ("sum_xx", np.float64),
        ("sum_yy", np.float64),
        ("sum_xy", np.float64),
    ],
    align=True,
)
"""Columns of a table of sources. A structured array keeps a source's row together, so that a kernel takes one argument,
and rows are sorted, selected and joined as one."""
Sources: TypeAlias = NDArray[np.void]
"""Table of `SOURCE` rows, shape (N,)."""


_ROW = np.dtype((np.void, SOURCE.itemsize))


def join_tables(*tables: Sources) -> Sources:
    """Rows of several tables; NumPy copies structured rows column by column, which takes twenty times as long."""
    return np.concatenate([table.view(_ROW) for table in tables]).view(SOURCE)


class Searched(NamedTuple):
    """What sources were found in."""

    image: Image
    level: Plane
    noise: Plane
    half: NDArray[np.float32]
    """The matched filter (`startracker.detection.scan`), or `UNFILTERED`."""


def is_saturated(table: Sources, saturation_known: bool) -> NDArray[np.bool_]:
    """Sources with a saturated pixel; the level not known: those of the highest value, if one has a flat top."""
    if saturation_known or not len(table):
        return np.asarray(table["saturated"] > 0)
    highest = table["peak"] == table["peak"].max()
    flat = highest & bool(np.any(highest & (table["at_peak"] >= FLAT_TOP_PIXELS)))
    return np.asarray(flat)


@kernel
def add_pixel(row: np.void, x: int, y: int, value: float, level: float, saturation: float) -> None:
    """Add a pixel to an object's row of the table; of equal peaks the first in reading order stays."""
    signal = np.float64(value) - np.float64(level)
    if row["pixels"] == 0:
        row["peak"] = -np.inf
    row["pixels"] += 1
    row["flux"] += signal
    row["sum_x"] += signal * x
    row["sum_y"] += signal * y
    row["sum_xx"] += signal * x * x
    row["sum_yy"] += signal * y * y
    row["sum_xy"] += signal * x * y
    if value >= saturation:
        row["saturated"] += 1
    if value > row["peak"]:
        row["peak"], row["at_peak"] = value, 1
        row["peak_residual"] = signal
        row["x_peak"], row["y_peak"] = x, y
    elif value == row["peak"]:
        row["at_peak"] += 1
        if y < row["y_peak"] or (y == row["y_peak"] and x < row["x_peak"]):
            row["x_peak"], row["y_peak"] = x, y
            row["peak_residual"] = signal
