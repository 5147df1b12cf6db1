"""Kernels that filter an image about single pixels; the filter is that of `startracker.detection.scan`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.values import Image, is_value, is_whole
from startracker.kernels import kernel

__all__ = ["filter_stamp", "filtered_at", "stamp_pitch"]

FloatImage = NDArray[np.float32]


@kernel
def stamp_pitch(half: FloatImage, radius: int) -> int:
    """Numbers from one row of a stamp to the next."""
    return 2 * (radius + len(half)) - 1


@kernel
def filter_stamp(
    image: Image, level: Plane, half: FloatImage, x0: int, y0: int, radius: int, work: FloatImage, out: FloatImage
) -> None:
    """Filtered signal around a pixel, row by row; not a number where the image is not.

    Parameters
    ----------
    out : float32 array
        Its first (2 radius + 1) × `stamp_pitch` numbers are written, of which the first 2 radius + 1 of each row
        count: rows one behind the other are filtered as if they were one.
    work : float32 array
        Working space for twice the square of the pitch.
    """
    height, width = image.shape
    reach = len(half) - 1
    side, pitch = 2 * radius + 1, stamp_pitch(half, radius)
    left, top = x0 - radius - reach, y0 - radius - reach
    signal = work[: pitch * pitch]
    first, last = max(left, 0), min(left + pitch, width)
    if first > left or last < left + pitch or top < 0 or top + pitch > height:
        signal[:] = 0.0
    for y in range(max(top, 0), min(top + pitch, height)):
        share, cell = level.share[y], level.cell[y]
        row = image[y, first:last]
        upper, lower = level.lines[cell, first:last], level.lines[min(cell + 1, len(level.lines) - 1), first:last]
        line = signal[(y - top) * pitch + first - left :][: last - first]
        for i in range(len(line)):
            value = np.float32(row[i]) - (upper[i] + share * (lower[i] - upper[i]))
            line[i] = value if is_value(row[i]) else np.float32(0.0)
    count, along_y = side * pitch, work[pitch * pitch :]
    _correlate(signal, half, pitch, along_y, count)
    _correlate(along_y, half, 1, out, count - 2 * reach)
    inside = x0 >= radius and y0 >= radius and x0 + radius < width and y0 + radius < height
    if not (is_whole(image) and inside):
        for j in range(side):
            for i in range(side):
                y, x = y0 - radius + j, x0 - radius + i
                if not (0 <= y < height and 0 <= x < width and is_value(image[y, x])):
                    out[j * pitch + i] = np.nan


@kernel
def _correlate(values: FloatImage, half: FloatImage, step: int, out: FloatImage, count: int) -> None:
    """Sums of 2 reach + 1 numbers that are `step` apart, the first of them at the place of the sum."""
    reach = len(half) - 1
    middle = values[reach * step :][:count]
    for k in range(1, reach, 2):
        weight, near, far = half[0], half[k], half[k + 1]
        a, b = values[(reach - k) * step :][:count], values[(reach + k) * step :][:count]
        c, d = values[(reach - k - 1) * step :][:count], values[(reach + k + 1) * step :][:count]
        if k == 1:
            for i in range(count):
                out[i] = weight * middle[i] + near * (a[i] + b[i]) + far * (c[i] + d[i])
        else:
            for i in range(count):
                out[i] += near * (a[i] + b[i]) + far * (c[i] + d[i])


@kernel
def filtered_at(image: Image, level: Plane, half: FloatImage, x0: int, y0: int) -> float:
    """Filtered signal of one pixel; not a number where the image is not finite."""
    height, width = image.shape
    reach = len(half) - 1
    if not is_value(image[y0, x0]):
        return np.nan
    total = np.float32(0.0)
    for y in range(max(y0 - reach, 0), min(y0 + reach + 1, height)):
        line = np.float32(0.0)
        for x in range(max(x0 - reach, 0), min(x0 + reach + 1, width)):
            if is_value(image[y, x]):
                line += half[abs(x - x0)] * (np.float32(image[y, x]) - level[y, x])
        total += half[abs(y - y0)] * line
    return float(total)
