"""Kernels on objects: runs of pixels above the threshold, their joining, and the sums over their pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.sources import SOURCE, Sources, add_pixel
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = [
    "cut_runs",
    "find_runs",
    "join_runs",
    "measure_objects",
    "row_edges",
    "row_marks",
]

_GROUP = 8
_BYTE = np.uint64(8)
IntArray = NDArray[np.int64]
FloatImage = NDArray[np.float32]


@kernel
def find_runs(image: Image, level: NDArray[np.float32], noise: NDArray[np.float32], threshold: np.float32) -> IntArray:
    """Runs (row, first column, last column + 1), shape (R, 3), of pixels above level + threshold × noise.

    In reading order. Pixels that are not finite are not above.
    """
    height, width = image.shape
    above = row_marks(width)
    edges = np.empty(width + 2, np.int64)
    runs, count = np.empty((1024, 3), np.int64), 0
    for y in range(height):
        row, sky, sigma = image[y], level[y], noise[y]
        # without a branch the comparison is vectorised (0.1 ns a pixel instead of 1.2)
        for x in range(width):
            above[x] = (row[x] > sky[x] + threshold * sigma[x]) & (row[x] < np.inf)
        changes = row_edges(above, width, edges)
        if count + changes // 2 > len(runs):
            runs = np.concatenate((runs, np.empty((len(runs) + width, 3), np.int64)))
        for k in range(0, changes, 2):
            runs[count, 0], runs[count, 1], runs[count, 2] = y, edges[k], edges[k + 1]
            count += 1
    return runs[:count].copy()


@kernel
def row_marks(width: int) -> NDArray[np.uint8]:
    """Bytes for the pixels of a row, to a whole number of blocks of 64; those beyond the row stay zero."""
    block = _GROUP * _GROUP
    return np.zeros((width + block - 1) // block * block, np.uint8)


@kernel
def row_edges(marks: NDArray[np.uint8], width: int, edges: IntArray) -> int:
    """Number of places, written to `edges`, where a run of marked pixels begins or ends, in turn.

    Nearly every block of 64 pixels is sky, and looked at as eight numbers at once; so is every group of eight.
    """
    words = marks.view(np.uint64)
    count, before = 0, np.uint64(0)
    for block in range(0, len(words), _GROUP):
        seen = before
        for group in range(block, block + _GROUP):
            seen |= words[group]
        if seen == 0:
            continue
        for group in range(block, block + _GROUP):
            word = words[group]
            if word == 0 and before == 0:
                continue
            changes = word ^ ((word << _BYTE) | before)
            before = word >> (_BYTE * np.uint64(_GROUP - 1))
            for i in range(_GROUP):
                edges[count] = group * _GROUP + i
                count += int((changes >> (_BYTE * np.uint64(i))) & np.uint64(1))
    if before:
        edges[count] = width
        count += 1
    return count


@kernel
def cut_runs(
    runs: IntArray, signal: FloatImage, keep: NDArray[np.bool_], noise: Plane, threshold: np.float32
) -> tuple[IntArray, FloatImage]:
    """What of the kept runs is above a higher threshold × noise, as runs in reading order, and its signal.

    `signal` holds the values of the runs' pixels, one run after the other.
    """
    out, values = np.empty((len(signal), 3), np.int64), np.empty_like(signal)
    count, used, place = 0, 0, 0
    for index in range(len(runs)):
        y, start = runs[index, 0], -1
        for x in range(runs[index, 1], runs[index, 2]):
            if keep[index] and signal[place] > threshold * noise[y, x]:
                values[used] = signal[place]
                used += 1
                start = x if start < 0 else start
            elif start >= 0:
                out[count, 0], out[count, 1], out[count, 2] = y, start, x
                count += 1
                start = -1
            place += 1
        if start >= 0:
            out[count, 0], out[count, 1], out[count, 2] = y, start, runs[index, 2]
            count += 1
    return out[:count].copy(), values[:used].copy()


@kernel
def _root(parent: IntArray, index: int) -> int:
    while parent[index] != index:
        parent[index] = parent[parent[index]]
        index = parent[index]
    return index


@kernel
def join_runs(runs: IntArray) -> tuple[IntArray, int]:
    """Object number of each run, and the number of objects: runs of neighbouring rows that touch, corners included.

    Union–find over runs in reading order, numbered by first appearance (He, Chao & Suzuki 2008).
    """
    total = len(runs)
    parent = np.arange(total)
    above, here = 0, 0  # first run of the row above, first run of this row
    for index in range(total):
        if index > 0 and runs[index, 0] != runs[index - 1, 0]:
            above = here if runs[index, 0] == runs[index - 1, 0] + 1 else index
            here = index
        if index == 0:
            continue
        other = above
        while other < here and runs[other, 1] <= runs[index, 2]:
            if runs[other, 2] >= runs[index, 1]:
                a, b = _root(parent, index), _root(parent, other)
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
            other += 1
        # runs of the row above that end left of this one cannot touch a later one
        while above < here and runs[above, 2] < runs[index, 1]:
            above += 1
    number = np.empty(total, np.int64)
    count = 0
    for index in range(total):
        root = _root(parent, index)
        if root == index:
            number[index] = count
            count += 1
        else:
            number[index] = number[root]
    return number, count


@kernel
def measure_objects(
    runs: IntArray,
    number: IntArray,
    count: int,
    image: Image,
    level: NDArray[np.float32],
    saturation: float,
) -> Sources:
    """Table (count, 14) of objects given by numbered runs; see `startracker.detection.spots.select_spots`."""
    height, width = image.shape
    table = np.zeros(count, SOURCE)
    for index in range(len(runs)):
        row = table[number[index]]
        y, x0, x1 = runs[index]
        if y == 0 or y == height - 1 or x0 == 0 or x1 == width:
            row["edge"] = True
        for x in range(x0, x1):
            add_pixel(row, x, y, image[y, x], level[y, x], saturation)
    return table
