"""Kernels that filter and search an image in one pass, without storing the filtered image.

The filter is separable and symmetric; `half` is its middle and upper half. Each row is filtered along x when it is
read, and is held in a ring buffer until the rows that its columns need are there, so that all work stays in the
processor's nearest cache.

All rows are parts of one array and are given by the index of their first value, because numba counts references to
slices, which takes as long as a hundred pixels. Indices are unsigned, because a signed one is first compared with zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import IntArray
from startracker.detection.tiles import Plane
from startracker.detection.values import Image, is_value

_LINE = 16
"""Numbers of float32 in a line of the cache; a vector load across two lines takes twice as long."""
_PADDING = 17 * _LINE
"""Padding between the rows of the ring buffer, so that they do not all map to the same lines of the cache."""
_WORD = 8
"""Pixels whose marks are read as one 64-bit number, and number of such words that are tested together."""
_WORKING_ROWS = 4
"""Rows in addition to the ring buffer: two filtered ones, the limits, and the row being read."""

FloatImage = NDArray[np.float32]

Places = NDArray[np.uint64]


def kernel_half(kernel: NDArray[np.float64]) -> FloatImage:
    """Middle and upper half of a symmetric kernel, padded with zeros to an even number, at least two, after the
    middle."""
    half = kernel[len(kernel) // 2 :].astype(np.float32)
    return np.append(half, np.zeros(max(2 - (len(half) - 1), (len(half) - 1) % 2), np.float32))


UNFILTERED = kernel_half(np.ones(1))
"""Filter that leaves the image unchanged."""


@kernel_part
def _residual_row(image: Image, level: Plane, y: int, work: FloatImage, out: np.uint64) -> None:
    """Image minus level; zero where the image is not finite."""
    share, lines, row = level.share[y], level.lines, np.uint64(y)
    cell = np.uint64(level.cell[y])
    below, zero = min(cell + np.uint64(1), np.uint64(len(lines) - 1)), np.float32(0.0)
    for x in range(np.uint64(image.shape[1])):
        signal = np.float32(image[row, x]) - (lines[cell, x] + share * (lines[below, x] - lines[cell, x]))
        work[out + x] = signal if is_value(image[row, x]) else zero


@kernel_part
def _filter_row(work: FloatImage, row: np.uint64, half: FloatImage, out: np.uint64, width: int) -> None:
    """Correlation along x of a row that has zeros on both sides."""
    before, weight = row, half[0]
    for n in range(1, len(half) - 1, 2):
        near, far, k = half[n], half[n + 1], np.uint64(n)
        a, b, c = row - k, row + k, row - k - np.uint64(1)
        d = row + k + np.uint64(1)
        for x in range(np.uint64(width)):
            value = weight * work[before + x] + near * (work[a + x] + work[b + x]) + far * (work[c + x] + work[d + x])
            work[out + x] = value
        before, weight = out, np.float32(1.0)


@kernel
def _filter_columns(
    work: FloatImage, rows: Places, half: FloatImage, out: Places, least: np.uint64, marks: NDArray[np.uint8],
    width: int,
) -> None:  # fmt: skip
    """Correlation along y of two adjacent rows, and marks of the pixels that exceed the limits.

    `rows` holds the indices at which the rows of the ring buffer begin; the results are those about the two middle
    ones. Two rows are computed at a time, because they share four of the five rows that a narrow filter reads.
    """
    middle = len(half) - 1
    first, second, wide = out[0], out[1], np.uint64(len(marks) // 2)
    a, b, c, d = rows[middle - 2], rows[middle - 1], rows[middle], rows[middle + 1]
    e, f = rows[middle + 2], rows[middle + 3]
    weight, near, far = half[0], half[1], half[2]
    for x in range(np.uint64(width)):
        one, two, three, four = work[b + x], work[c + x], work[d + x], work[e + x]
        value = weight * two + near * (one + three) + far * (work[a + x] + four)
        other = weight * three + near * (two + four) + far * (one + work[f + x])
        limit = work[least + x]
        work[first + x] = value
        work[second + x] = other
        marks[x] = value > limit
        marks[wide + x] = other > limit
    for k in range(3, middle, 2):
        near, far = half[k], half[k + 1]
        for row in range(2):
            centre, total, beside = middle + row, out[row], wide * np.uint64(row)
            a, b, c = rows[centre - k], rows[centre + k], rows[centre - k - 1]
            d = rows[centre + k + 1]
            for x in range(np.uint64(width)):
                value = work[total + x] + near * (work[a + x] + work[b + x]) + far * (work[c + x] + work[d + x])
                work[total + x] = value
                marks[beside + x] = value > work[least + x]


@kernel_part
def _lower_limits(work: FloatImage, noise: Plane, y: int, threshold: float, out: np.uint64) -> None:
    """Lower each column's limit to at most threshold × noise.

    It is valid for all rows between the two lines of the noise map around row y; beyond the outermost line, for y only.
    """
    share, lines, cell = noise.share[y], noise.lines, np.uint64(noise.cell[y])
    below = min(cell + np.uint64(1), np.uint64(len(lines) - 1))
    less = np.float32(1.0 - 1e-6)  # for the rounding of the interpolation
    for x in range(np.uint64(lines.shape[1])):
        upper, lower = lines[cell, x], lines[below, x]
        value = min(upper, lower) if 0.0 <= share <= 1.0 else upper + share * (lower - upper)
        work[out + x] = min(threshold * value * less, work[out + x])


@kernel_part
def _sample_row(
    work: FloatImage, total: np.uint64, noise: Plane, image: Image, y: int, columns: tuple[int, int],
    sample: FloatImage, count: int,
) -> int:  # fmt: skip
    """Append filtered signal / noise of every `columns[1]`-th pixel of a row, from `columns[0]` on, to the sample.

    Returns the length of the sample.
    """
    share, lines, row = noise.share[y], noise.lines, np.uint64(y)
    cell = np.uint64(noise.cell[y])
    below, index = min(cell + np.uint64(1), np.uint64(len(lines) - 1)), np.uint64(count)
    for x in range(np.uint64(columns[0]), np.uint64(image.shape[1]), np.uint64(columns[1])):
        sample[index] = work[total + x] / (lines[cell, x] + share * (lines[below, x] - lines[cell, x]))
        index += np.uint64(is_value(image[row, x]))
    return int(np.int64(index))  # signed, for the arithmetic of the callers


def search_rows(
    image: Image, level: Plane, noise: Plane, half: FloatImage, threshold: float, stride: int
) -> tuple[Places, FloatImage, FloatImage]:
    """Groups of pixels of which some may exceed threshold × noise, for `runs_above`, and a sample of the noise.

    Parameters
    ----------
    image : array, shape (H, W)
        Pixels that are not finite, and those beyond the border, count as background.
    level, noise : Plane
        Background.
    half : array
        From `kernel_half`.
    threshold : float
        Positive.
    stride : int
        The filtered signal of every `stride`-th pixel is sampled.

    Returns
    -------
    groups : uint64 array, shape (N, 2)
        Row and first column of each group of eight, in reading order; the last of a row may reach beyond it.
    found : float32 array, shape (N, 8)
        Filtered signal of their pixels.
    sample : float32 array
        Filtered signal over the noise, of finite pixels.
    """
    height, width = image.shape
    reach = len(half) - 1
    rows = 2 * reach + 2 + _WORKING_ROWS
    pitch = (width + 2 * reach + _LINE - 1) // _LINE * _LINE + _PADDING
    work = np.zeros(rows * pitch + _LINE, np.float32)
    # Rows start at a multiple of the cache line in memory.
    first = (-work.__array_interface__["data"][0] // work.itemsize) % _LINE
    starts = np.arange(first, first + rows * pitch, pitch, dtype=np.uint64)
    marks = np.zeros(2 * ((width + 63) // 64 * 64), np.uint8)
    most = height * (len(marks) // 2 // _WORD)  # room for all: memory that is never written costs nothing
    groups, found = np.empty((most, 2), np.uint64), np.empty((most, _WORD), np.float32)
    sample = np.empty(height * width // stride + 1, np.float32)
    space = _Space(work, starts, marks, marks.view(np.uint64))
    rows_found, sampled = _search(
        image, level, noise, half, np.float32(threshold), stride, space, _Found(groups, found, sample)
    )
    return groups[:rows_found], found[:rows_found], sample[:sampled]


class _Space(NamedTuple):
    """Working space of `_search`."""

    work: FloatImage
    starts: Places
    """Indices at which the rows of `work` begin."""
    marks: NDArray[np.uint8]
    """Marks of two rows."""
    words: Places
    """The memory of `marks`, viewed as 64-bit words."""


class _Found(NamedTuple):
    """Arrays for the results of `search_rows`."""

    groups: Places
    found: FloatImage
    sample: FloatImage


@kernel
def _search(
    image: Image, level: Plane, noise: Plane, half: FloatImage, threshold: float, stride: int, space: _Space,
    out: _Found,
) -> tuple[int, int]:  # fmt: skip
    """Fill the arrays of `search_rows`; returns the number of groups and of samples."""
    (work, starts, marks, words), (groups, found, sample) = space, out
    height, width = image.shape
    reach = len(half) - 1
    size = 2 * reach + 2
    rows, totals, least, residual = starts[:size], starts[size : size + 2], starts[size + 2], starts[size + 3]
    cell, count, samples, index = -1, 0, 0, 0
    for y in range(0, height + reach + 2, 2):
        oldest, next_oldest = rows[0], rows[1]
        for k in range(size - 2):
            rows[k] = rows[k + 2]
        rows[size - 2], rows[size - 1] = oldest, next_oldest
        # Two rows enter the ring buffer at a time; rows below the image are zeros, as the background is.
        for row in range(y, y + 2):
            newest = rows[size - 2 + row - y]
            if row < height:
                _residual_row(image, level, row, work, residual)
                _filter_row(work, residual, half, newest, width)
            else:
                for x in range(np.uint64(width)):
                    work[newest + x] = 0.0
        # Rows are searched one step later, because reading values that were just written stalls the processor.
        for row in range(max(y - reach - 2, 0), min(y - reach, height)):
            total, first = totals[row & 1], np.uint64((row & 1) * len(words) // 2)
            count = _collect_marked(words, first, work, total, row, groups, found, count)
            samples = _sample_row(work, total, noise, image, row, (index, stride), sample, samples)
            # Continue the sampling stride across rows, as if the image were one line.
            index += (width - index + stride - 1) // stride * stride - width if index < width else -width
        centre = y - reach
        if not 0 <= centre < height:
            continue
        # The lower limit of the two lines of the noise map is used here, which costs little; `runs_above` applies the
        # actual one.
        for row in range(centre, min(centre + 2, height)):
            between = 0.0 <= noise.share[row] <= 1.0
            if noise.cell[row] != cell or not between:
                for x in range(np.uint64(width if row == centre else 0)):
                    work[least + x] = np.inf
                _lower_limits(work, noise, row, threshold, least)
                cell = noise.cell[row] if between and row == centre else -1
        _filter_columns(work, rows, half, totals, least, marks, width)
    return count, samples


@kernel
def _collect_marked(
    words: Places, first: np.uint64, work: FloatImage, total: np.uint64, row: int, groups: Places, found: FloatImage,
    count: int,
) -> int:  # fmt: skip
    """Copy the groups of a row in which a pixel is marked; blocks of 64 pixels without a mark are skipped at once."""
    size = np.uint64(_WORD)
    for block in range(first, first + np.uint64(len(words)) // np.uint64(2), size):
        seen = np.uint64(0)
        for word in range(block, block + size):
            seen |= words[word]
        if seen == 0:
            continue
        for word in range(block, block + size):
            if words[word] == 0:
                continue
            column = size * (word - first)
            groups[count, 0], groups[count, 1] = row, column
            for i in range(size):
                found[count, i] = work[total + column + i]
            count += 1
    return count


def runs_above(
    groups: Places, found: FloatImage, image: Image, noise: Plane, threshold: float
) -> tuple[IntArray, FloatImage]:
    """Runs of pixels whose filtered signal is above threshold × noise.

    Parameters
    ----------
    groups, found : arrays
        From `search_rows`, for at most this threshold.
    image, noise : array and Plane
        As there; pixels that are not finite are not above.

    Returns
    -------
    runs : int array, shape (R, 3)
        Row, first column, last column + 1, in reading order.
    signal : float32 array
        Filtered signal of the pixels of the runs.
    """
    runs, signal = np.empty(3 * (found.size // 2 + 2), np.int64), np.empty(found.size + 1, np.float32)
    count, values = _cut_groups(groups, found, image, noise, np.float32(threshold), runs, signal)
    return runs[: 3 * count].copy().reshape(-1, 3), signal[:values].copy()


@kernel
def _cut_groups(
    groups: Places, found: FloatImage, image: Image, noise: Plane, threshold: float, runs: IntArray, signal: FloatImage
) -> tuple[int, int]:
    """Fill `runs` (flat) and `signal` of `runs_above`; returns the numbers of runs and of values."""
    size, width, one = np.uint64(found.shape[1]), np.uint64(image.shape[1]), np.uint64(1)
    three = np.uint64(3)
    # Row, first column and last column + 1 of each run are written at every pixel; the index advances only where a run
    # begins or ends, which avoids branches.
    edges, values, row = np.uint64(0), np.uint64(0), np.uint64(0)
    stop, lines = np.uint64(0), noise.lines
    inside = False
    for n in range(np.uint64(len(groups))):
        if inside and (groups[n, 0] != row or groups[n, 1] != stop):
            runs[three * (edges >> one) + np.uint64(2)] = stop
            edges, inside = edges + one, False
        row, first = groups[n, 0], groups[n, 1]
        stop, share, cell = min(first + size, width), noise.share[row], np.uint64(noise.cell[row])
        below = min(cell + one, np.uint64(len(lines)) - one)
        for x in range(first, stop):
            value, upper = found[n, x - first], lines[cell, x]
            limit = threshold * (upper + share * (lines[below, x] - upper))
            above = (value > limit) & is_value(image[row, x])
            index = three * (edges >> one)
            runs[index] = row
            runs[index + one + (edges & one)] = x
            edges += np.uint64(above != inside)
            signal[values] = value
            values += np.uint64(above)
            inside = above
    if inside:
        runs[three * (edges >> one) + np.uint64(2)] = stop
        edges += one
    return int(np.int64(edges // np.uint64(2))), int(np.int64(values))
