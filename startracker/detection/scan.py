"""Kernels that filter an image and search it in one pass, without a filtered image ever being stored.

The filter is separable and symmetric; `half` is its middle and upper half. A row is filtered along x as it comes and
waits in a ring until the rows that its column needs are there: everything happens in the processor's nearest cache.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.objects import row_edges, row_marks
from startracker.detection.plane import Plane
from startracker.detection.values import Image, is_value

__all__ = ["UNFILTERED", "kernel_half", "scan_rows"]

_LINE = 16
"""Numbers in a line of the cache; a vector that lies across two of them takes twice as long to load."""
_PADDING = 17 * _LINE
"""Between the rows of a ring, so that they do not all fall on the same lines of the cache."""

FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]


def kernel_half(kernel: NDArray[np.float64]) -> FloatImage:
    """Middle and upper half of a symmetric kernel, with zeros to an even number, at least two, after the middle."""
    half = kernel[len(kernel) // 2 :].astype(np.float32)
    return np.append(half, np.zeros(max(2 - (len(half) - 1), (len(half) - 1) % 2), np.float32))


UNFILTERED = kernel_half(np.ones(1))
"""The filter that changes nothing."""


@njit(cache=True, error_model="numpy")
def _residual_row(image: Image, level: Plane, y: int, out: FloatImage) -> None:
    """Image minus level; zero where the image is not finite."""
    width = len(out)
    share, cell = level.share[y], level.cell[y]
    row, upper, lower = image[y], level.lines[cell], level.lines[min(cell + 1, len(level.lines) - 1)]
    zero = np.float32(0.0)
    for x in range(width):
        signal = np.float32(row[x]) - (upper[x] + share * (lower[x] - upper[x]))
        out[x] = signal if is_value(row[x]) else zero


@njit(cache=True, error_model="numpy")
def _filter_row(padded: FloatImage, half: FloatImage, line: FloatImage) -> None:
    """Correlation along x of a row that is padded by the filter's reach on both sides."""
    width, reach = len(line), len(half) - 1
    middle = padded[reach : reach + width]
    for k in range(1, reach, 2):
        weight, near, far = half[0], half[k], half[k + 1]
        a, b = padded[reach - k : reach - k + width], padded[reach + k : reach + k + width]
        c, d = padded[reach - k - 1 : reach - k - 1 + width], padded[reach + k + 1 : reach + k + 1 + width]
        if k == 1:
            for x in range(width):
                line[x] = weight * middle[x] + near * (a[x] + b[x]) + far * (c[x] + d[x])
        else:
            for x in range(width):
                line[x] += near * (a[x] + b[x]) + far * (c[x] + d[x])


@njit(cache=True, error_model="numpy")
def _least_limits(noise: Plane, y: int, threshold: float, out: FloatImage) -> None:
    """At most threshold × noise of each column, in all rows between the lines about a row, or in it alone beyond."""
    share, cell = noise.share[y], noise.cell[y]
    upper, lower = noise.lines[cell], noise.lines[min(cell + 1, len(noise.lines) - 1)]
    less = np.float32(1.0 - 1e-6)  # for the rounding of the interpolation
    for x in range(len(out)):
        value = min(upper[x], lower[x]) if 0.0 <= share <= 1.0 else upper[x] + share * (lower[x] - upper[x])
        out[x] = threshold * value * less


@njit(cache=True, error_model="numpy")
def scan_rows(
    image: Image, level: Plane, noise: Plane, half: FloatImage, threshold: float, stride: int
) -> tuple[IntArray, FloatImage, FloatImage]:
    """Runs of pixels whose filtered signal is above threshold × noise.

    Parameters
    ----------
    image : array, shape (H, W)
        Pixels that are not finite, and those beyond the border, count as background, and are not above.
    level, noise : Plane
        Background.
    half : array
        From `kernel_half`.
    stride : int
        The filtered signal of every `stride`-th pixel is sampled.

    Returns
    -------
    runs : int array, shape (R, 3)
        Row, first column, last column + 1, in reading order.
    signal : float32 array
        Filtered signal of the pixels of the runs.
    sample : float32 array
        Filtered signal over the noise.
    """
    height, width = image.shape
    reach = len(half) - 1
    size = 2 * reach + 1
    pitch = (width + 2 * reach + _LINE - 1) // _LINE * _LINE + _PADDING
    work = np.zeros((size + 3) * pitch + _LINE, np.float32)
    ring = work[(-work.ctypes.data // work.itemsize) % _LINE :]
    total, least, padded = ring[size * pitch :][:width], ring[(size + 1) * pitch :][:width], ring[(size + 2) * pitch :]
    padded = padded[: width + 2 * reach]
    above, cell = row_marks(width), -1
    edges = np.empty(width + 2, np.int64)
    runs, signal, count, values = np.empty((1024, 3), np.int64), np.empty(8192, np.float32), 0, 0
    sample, samples, place = np.empty(height * width // stride + 1, np.float32), 0, 0
    for y in range(height + reach):
        line = ring[(y % size) * pitch :][:width]
        if y < height:
            _residual_row(image, level, y, padded[reach : reach + width])
            _filter_row(padded, half, line)
        else:
            line[:] = 0.0
        centre = y - reach
        if centre < 0:
            continue
        _filter_column(ring, pitch, half, centre, total)
        row = image[centre]
        # first what is above the lower of the two lines' limits, which is quickly told, then what is above its own
        if noise.cell[centre] != cell or noise.share[centre] > 1.0 or noise.share[centre] < 0.0:
            _least_limits(noise, centre, threshold, least)
            cell = noise.cell[centre] if 0.0 <= noise.share[centre] <= 1.0 else -1
        for x in range(width):
            above[x] = total[x] > least[x]
        changes = row_edges(above, width, edges)
        if values + width > len(signal):
            signal = np.concatenate((signal, np.empty(len(signal) + width, np.float32)))
        if count + width > len(runs):
            runs = np.concatenate((runs, np.empty((len(runs) + width, 3), np.int64)))
        for k in range(0, changes, 2):
            start = -1
            for x in range(edges[k], edges[k + 1]):
                if total[x] > threshold * noise[centre, x] and is_value(row[x]):
                    start = x if start < 0 else start
                    signal[values] = total[x]
                    values += 1
                elif start >= 0:
                    runs[count, 0], runs[count, 1], runs[count, 2] = centre, start, x
                    count += 1
                    start = -1
            if start >= 0:
                runs[count, 0], runs[count, 1], runs[count, 2] = centre, start, edges[k + 1]
                count += 1
        while place < (centre + 1) * width:
            x = place - centre * width
            sample[samples] = total[x] / noise[centre, x]
            samples += is_value(row[x])
            place += stride
    return runs[:count].copy(), signal[:values].copy(), sample[:samples].copy()


@njit(cache=True, error_model="numpy")
def _filter_column(rows: FloatImage, pitch: int, half: FloatImage, centre: int, out: FloatImage) -> None:
    """Correlation along y about a row of a ring, whose rows begin `pitch` apart."""
    width, reach = len(out), len(half) - 1
    size = 2 * reach + 1
    here = centre % size
    middle = rows[here * pitch :][:width]
    for k in range(1, reach, 2):
        weight, near, far = half[0], half[k], half[k + 1]
        # remainders without a division
        a, b = here - k + (size if here < k else 0), here + k - (size if here + k >= size else 0)
        c, d = a - 1 + (size if a == 0 else 0), b + 1 - (size if b + 1 == size else 0)
        above, below = rows[a * pitch :][:width], rows[b * pitch :][:width]
        higher, lower = rows[c * pitch :][:width], rows[d * pitch :][:width]
        if k == 1:
            for x in range(width):
                out[x] = weight * middle[x] + near * (above[x] + below[x]) + far * (higher[x] + lower[x])
        else:
            for x in range(width):
                out[x] += near * (above[x] + below[x]) + far * (higher[x] + lower[x])
