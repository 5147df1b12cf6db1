"""Kernels on objects: runs of pixels above the threshold, their joining, and the sums over their pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.detection.plane import Plane
from startracker.detection.sources import SOURCE, Sources, add_pixel
from startracker.detection.values import Image
from startracker.kernels import kernel, kernel_part

FloatImage = NDArray[np.float32]


def find_runs(image: Image, level: FloatImage, noise: FloatImage, threshold: np.float32) -> IntArray:
    """Runs (row, first column, last column + 1), shape (R, 3), of pixels above level + threshold × noise.

    In reading order. Pixels that are not finite are not above.
    """
    height, width = image.shape
    above = np.zeros((height, width + 2), np.bool_)  # a pixel below on either side of each row
    above[:, 1:-1] = (image > level + threshold * noise) & (image < np.inf)
    edges = np.flatnonzero(above.ravel()[1:] != above.ravel()[:-1]).reshape(-1, 2)
    row = edges[:, 0] // (width + 2)
    return np.column_stack([row, edges - row[:, None] * (width + 2)])


@kernel
def cut_runs(
    runs: IntArray, signal: FloatImage, keep: NDArray[np.bool_], noise: Plane, threshold: np.float32
) -> tuple[IntArray, FloatImage]:
    """What of the kept runs is above a higher threshold × noise, as runs in reading order, and its signal.

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
    """Object number of each run, and the number of objects: runs of neighbouring rows that touch, corners included.

    Union–find over runs in reading order, numbered by first appearance (He, Chao & Suzuki 2008).
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
                parent[max(a, b)] = min(a, b)
            other += 1
        # runs of the row above that end left of this one cannot touch a later one
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
        parent[index] = parent[parent[index]]
        index = parent[index]
    return index


def measure_objects(
    runs: IntArray, number: IntArray, count: int, image: Image, level: Plane, saturation: float
) -> Sources:
    """Table of `count` objects given by numbered runs."""
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
