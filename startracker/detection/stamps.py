"""The filtered image about single pixels; the filter is that of `startracker.detection.scan`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.detection.plane import Plane
from startracker.detection.values import Image, is_value, is_whole

FloatImage = NDArray[np.float32]


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
    side, pitch = 2 * radius + 1, 2 * (radius + len(half)) - 1
    left, top = x0 - radius - reach, y0 - radius - reach
    first, last, square = max(left, 0), min(left + pitch, width), pitch * pitch
    if left < 0 or left + pitch > width or top < 0 or top + pitch > height:
        for i in range(square):
            work[i] = 0.0
    for y in range(max(top, 0), min(top + pitch, height)):
        share, cell, lines = level.share[y], np.uint64(level.cell[y]), level.lines
        below, row = min(cell + np.uint64(1), np.uint64(len(lines) - 1)), np.uint64(y)
        to = np.uint64((y - top) * pitch - left)
        for x in range(np.uint64(first), np.uint64(last)):
            signal = np.float32(image[row, x]) - (lines[cell, x] + share * (lines[below, x] - lines[cell, x]))
            work[to + x] = signal if is_value(image[row, x]) else np.float32(0.0)
    start, step = np.int64(0), np.int64(1)
    _correlate(work, start, half, pitch, work, square, side * pitch)
    _correlate(work, square, half, step, out, start, side * pitch - 2 * reach)
    inside = x0 >= radius and y0 >= radius and x0 + radius < width and y0 + radius < height
    if not (is_whole(image) and inside):
        for j in range(side):
            for i in range(side):
                y, x = y0 - radius + j, x0 - radius + i
                if not (0 <= y < height and 0 <= x < width and is_value(image[y, x])):
                    out[j * pitch + i] = np.nan


@kernel
def _correlate(
    values: FloatImage, start: int, half: FloatImage, step: int, out: FloatImage, to: int, count: int
) -> None:
    """Sums of 2 reach + 1 numbers that are `step` apart, the first of them at the position of the sum."""
    reach, weight = len(half) - 1, half[0]
    for k in range(1, reach, 2):
        near, far = half[k], half[k + 1]
        inner, outer, middle = np.uint64(k * step), np.uint64((k + 1) * step), np.uint64(start + reach * step)
        for i in range(np.uint64(count)):
            at, sums = middle + i, np.uint64(to) + i
            before = weight * values[at] if k == 1 else out[sums]
            beside = near * (values[at - inner] + values[at + inner])
            out[sums] = before + beside + far * (values[at - outer] + values[at + outer])


@kernel_part
def filtered_pixel(image: Image, level: Plane, half: FloatImage, x0: int, y0: int) -> tuple[float, float]:
    """Filtered signal of a single pixel, and its own; the first is NaN where the image is not finite."""
    height, width = image.shape
    reach, total = len(half) - 1, np.float32(0.0)
    for y in range(max(y0 - reach, 0), min(y0 + reach + 1, height)):
        line = np.float32(0.0)
        for x in range(max(x0 - reach, 0), min(x0 + reach + 1, width)):
            if is_value(image[y, x]):
                line += half[abs(x - x0)] * (np.float32(image[y, x]) - level[y, x])
        total += half[abs(y - y0)] * line
    filtered = np.float64(total) if is_value(image[y0, x0]) else np.nan
    return filtered, np.float64(np.float32(image[y0, x0]) - level[y0, x0])
