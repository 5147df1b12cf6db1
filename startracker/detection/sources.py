"""Table of sources: one row for each object above the threshold, with the sums over its pixels."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import IntArray
from startracker.detection.thresholds import FLAT_TOP_PIXELS
from startracker.detection.tiles import Plane
from startracker.detection.values import Image

FloatImage = NDArray[np.float32]


def find_runs(image: Image, level: FloatImage, noise: FloatImage, threshold: np.float32) -> IntArray:
    """Runs (row, first column, last column + 1), shape (R, 3), of pixels above level + threshold × noise.

    They are in reading order. Pixels that are not finite are not above.
    """
    height, width = image.shape
    above = np.zeros((height, width + 2), np.bool_)  # one column of False on either side
    above[:, 1:-1] = (image > level + threshold * noise) & (image < np.inf)
    edges = np.flatnonzero(above.ravel()[1:] != above.ravel()[:-1]).reshape(-1, 2)  # rises and falls alternate
    row = edges[:, 0] // (width + 2)
    return np.column_stack([row, edges - row[:, None] * (width + 2)])


@kernel
def cut_runs(
    runs: IntArray, signal: FloatImage, keep: NDArray[np.bool_], noise: Plane, threshold: np.float32
) -> tuple[IntArray, FloatImage]:
    """Pixels of the `keep` runs above a higher threshold × noise, as runs in reading order, and their signal.

    `signal` holds the values of the runs' pixels, one run after the other.
    """
    out, values = np.empty((len(signal), 3), np.int64), np.empty_like(signal)
    count, used, pixel = 0, 0, 0
    for index in range(len(runs)):
        y, start = runs[index, 0], -1
        for x in range(runs[index, 1], runs[index, 2]):
            if keep[index] and signal[pixel] > threshold * noise[y, x]:
                values[used] = signal[pixel]
                used += 1
                start = x if start < 0 else start
            elif start >= 0:
                out[count, 0], out[count, 1], out[count, 2] = y, start, x
                count += 1
                start = -1
            pixel += 1
        if start >= 0:
            out[count, 0], out[count, 1], out[count, 2] = y, start, runs[index, 2]
            count += 1
    return out[:count].copy(), values[:used].copy()


def join_runs(runs: IntArray) -> tuple[IntArray, int]:
    """Merge runs of neighbouring rows that touch, corners included, into objects.

    Returns the object number (R,) of each run and the number of objects. Union–find over runs in reading order,
    numbered by first appearance (He, Chao & Suzuki 2008).
    """
    number = np.empty(len(runs), np.int64)
    return number, _join(runs, np.arange(len(runs)), number)


@kernel
def _join(runs: IntArray, parent: IntArray, number: IntArray) -> int:
    above = here = 0  # first run of the row above, first run of this row
    for index in range(1, len(runs)):
        if runs[index, 0] != runs[index - 1, 0]:
            above = here if runs[index, 0] == runs[index - 1, 0] + 1 else index
            here = index
        other = above
        while other < here and runs[other, 1] <= runs[index, 2]:
            if runs[other, 2] >= runs[index, 1]:
                a, b = _root(parent, index), _root(parent, other)
                # The smaller index becomes the root, so that roots come first in reading order.
                parent[max(a, b)] = min(a, b)
            other += 1
        # Runs of the row above that end to the left of this one cannot touch a later one.
        while above < here and runs[above, 2] < runs[index, 1]:
            above += 1
    count = 0
    for index in range(len(runs)):
        root = _root(parent, index)
        if root == index:
            number[index] = count
            count += 1
        else:
            number[index] = number[root]
    return count


@kernel_part
def _root(parent: IntArray, index: int) -> int:
    while parent[index] != index:
        parent[index] = parent[parent[index]]  # halves the path, so that later searches are short
        index = parent[index]
    return index


def measure_objects(
    runs: IntArray, number: IntArray, count: int, image: Image, level: Plane, saturation: float
) -> Sources:
    """Table of `count` objects given by runs and the object number of each run."""
    table = np.zeros(count, SOURCE)
    _add_runs(runs, number, image, level, np.float32(saturation), table)
    return table


@kernel
def _add_runs(runs: IntArray, number: IntArray, image: Image, level: Plane, saturation: float, table: Sources) -> None:
    height, width = image.shape
    for index in range(len(runs)):
        row = table[number[index]]
        y, x0, x1 = runs[index, 0], runs[index, 1], runs[index, 2]
        if y == 0 or y == height - 1 or x0 == 0 or x1 == width:
            row["edge"] = True
        for x in range(x0, x1):
            add_pixel(row, x, y, image[y, x], level[y, x], saturation)


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
"""Columns of a table of sources.

A structured array keeps the row of a source together, so that a kernel takes one argument, and rows are sorted,
selected and joined as a whole.
"""
Sources: TypeAlias = NDArray[np.void]
"""Table of `SOURCE` rows, shape (N,)."""


_ROW = np.dtype((np.void, SOURCE.itemsize))


def join_tables(*tables: Sources) -> Sources:
    """Concatenate tables.

    NumPy copies structured rows column by column, which takes twenty times as long as copying them as raw bytes.
    """
    return np.concatenate([table.view(_ROW) for table in tables]).view(SOURCE)


class Searched(NamedTuple):
    """The image in which sources were found, its background, and the filter."""

    image: Image
    level: Plane
    noise: Plane
    half: NDArray[np.float32]
    """The matched filter (`startracker.detection.scan`), or `UNFILTERED`."""


def is_saturated(table: Sources, saturation_known: bool) -> NDArray[np.bool_]:
    """Mask of the sources with a saturated pixel; if the level is unknown, of those at the highest value with a flat
    top."""
    if saturation_known or not len(table):
        return np.asarray(table["saturated"] > 0)
    # Saturation clips all bright stars at one value, and clips several pixels of the brightest: this distinguishes it
    # from the peak of a star, which no other pixel shares.
    highest = table["peak"] == table["peak"].max()
    flat = highest & bool(np.any(highest & (table["at_peak"] >= FLAT_TOP_PIXELS)))
    return np.asarray(flat)


@kernel
def add_pixel(row: np.void, x: int, y: int, value: float, level: float, saturation: float) -> None:
    """Add a pixel to an object's row of the table; of pixels with equal peaks the first in reading order is the
    peak."""
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
