"""Kernel that parts stars whose images touch."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.objects import add_pixel
from startracker.detection.spots import COLUMNS, EDGE, PEAK_RESIDUAL, PIXELS
from startracker.detection.values import Image

__all__ = ["part_blends"]

_VALLEY = 0.8
"""Two peaks are two stars when the signal between them falls below this share of the lower …"""
_VALLEY_SIGMA = 4.0
"""… and by this many times the noise."""
_RING_SHARE = 0.05
"""Fainter peaks are the brighter star's own: the first ring of an Airy pattern has 0.0175 of its centre."""
_FEWEST_PIXELS = 6
_SMALLEST_DISTANCE_PX2 = 4

FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def _is_peak(image: Image, x: int, y: int) -> bool:
    """Whether no neighbour is brighter; of equal neighbours the first in reading order is the peak."""
    height, width = image.shape
    value = image[y, x]
    for j in range(np.uint64(max(y - 1, 0)), np.uint64(min(y + 2, height))):
        row, later = image[j], int(j) > y
        for i in range(np.uint64(max(x - 1, 0)), np.uint64(min(x + 2, width))):
            before = not later and (int(j) < y or int(i) < x)
            if row[i] > value or (before and row[i] == value):
                return False
    return True


@njit(cache=True, error_model="numpy")
def _valley(image: Image, level: FloatImage, x0: int, y0: int, x1: int, y1: int) -> float:
    """Least signal on the straight way from one pixel to another.

    Between pixels of equal value, as on a saturated top, the way may step aside by one pixel: its stair-shaped border
    is no valley.
    """
    height, width = image.shape
    aside = 1 if image[y0, x0] == image[y1, x1] else 0
    steps = max(abs(x1 - x0), abs(y1 - y0))
    least = np.inf
    for k in range(steps + 1):
        x, y = round(x0 + (x1 - x0) * k / steps), round(y0 + (y1 - y0) * k / steps)
        highest = -np.inf
        for j in range(max(y - aside, 0), min(y + aside + 1, height)):
            for i in range(max(x - aside, 0), min(x + aside + 1, width)):
                highest = max(highest, np.float64(image[j, i]) - np.float64(level[j, i]))
        least = min(least, highest)
    return least


@njit(cache=True, error_model="numpy")
def part_blends(
    runs: IntArray,
    number: IntArray,
    table: NDArray[np.float64],
    most_pixels: int,
    image: Image,
    level: FloatImage,
    noise: FloatImage,
    saturation: float,
) -> tuple[NDArray[np.float64], int]:
    """Table of objects in which those with several peaks are replaced by one object a peak, and how many were.

    A peak counts when it has more than 0.05 of every brighter one of its object and the signal on the straight way
    there falls below 0.8 of it and by more than 4 times the noise. Pixels go to the nearest peak. Objects of fewer
    than six or more than `most_pixels` pixels stay whole.
    """
    height, width = image.shape
    count = len(table)
    capacity = 64
    peak_x, peak_y = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    peak_object, signal = np.empty(capacity, np.int64), np.empty(capacity)
    peaks = 0
    for index in range(len(runs)):
        size = table[number[index], PIXELS]
        if size < _FEWEST_PIXELS or size > most_pixels:
            continue
        y = runs[index, 0]
        for x in range(runs[index, 1], runs[index, 2]):
            if not _is_peak(image, x, y):
                continue
            if peaks == len(signal):
                peak_x, peak_y = np.concatenate((peak_x, peak_x)), np.concatenate((peak_y, peak_y))
                peak_object, signal = np.concatenate((peak_object, peak_object)), np.concatenate((signal, signal))
            peak_x[peaks], peak_y[peaks], peak_object[peaks] = x, y, number[index]
            signal[peaks] = np.float64(image[y, x]) - np.float64(level[y, x])
            peaks += 1
    # a peak that is its object's only one parts nothing
    of_object = np.zeros(count, np.int64)
    for peak in range(peaks):
        of_object[peak_object[peak]] += 1
    found, peaks = peaks, 0
    for peak in range(found):
        if of_object[peak_object[peak]] > 1:
            peak_x[peaks], peak_y[peaks] = peak_x[peak], peak_y[peak]
            peak_object[peaks], signal[peaks] = peak_object[peak], signal[peak]
            peaks += 1
    # accepted peaks of an object form a chain: head[object] → following[peak] → …
    head, following = np.full(count, -1), np.full(peaks, -1)
    several = np.zeros(count, np.bool_)
    order = np.argsort(-signal[:peaks], kind="mergesort")
    for candidate in order:
        x, y = peak_x[candidate], peak_y[candidate]
        separate = True
        other = head[peak_object[candidate]]
        while other >= 0 and separate:
            distance = (x - peak_x[other]) ** 2 + (y - peak_y[other]) ** 2
            least = _valley(image, level, x, y, peak_x[other], peak_y[other])
            depth = signal[candidate] - least
            separate = (
                distance >= _SMALLEST_DISTANCE_PX2
                and signal[candidate] > _RING_SHARE * signal[other]
                and least < _VALLEY * signal[candidate]
                and depth > _VALLEY_SIGMA * noise[y, x]
            )
            other = following[other]
        if separate:
            several[peak_object[candidate]] = head[peak_object[candidate]] >= 0
            following[candidate] = head[peak_object[candidate]]
            head[peak_object[candidate]] = candidate
    if not several.any():
        return table, 0
    parts = np.zeros((peaks, COLUMNS))
    for index in range(len(runs)):
        if not several[number[index]]:
            continue
        y = runs[index, 0]
        for x in range(runs[index, 1], runs[index, 2]):
            nearest, best = -1, np.inf
            other = head[number[index]]
            while other >= 0:
                distance = float((x - peak_x[other]) ** 2 + (y - peak_y[other]) ** 2)
                # equal distances go to the brighter, which comes later in the chain
                if distance <= best:
                    nearest, best = other, distance
                other = following[other]
            add_pixel(parts[nearest], x, y, image[y, x], level[y, x], saturation)
            if x == 0 or y == 0 or x == width - 1 or y == height - 1:
                parts[nearest, EDGE] = 1.0
    # a part's highest pixel is its peak by construction, unless a neighbour's slope reaches into its cell
    for peak in range(peaks):
        if parts[peak, PIXELS] > 0 and parts[peak, PEAK_RESIDUAL] > signal[peak]:
            parts[peak, PIXELS] = 0.0
    return np.concatenate((table[~several], parts[parts[:, PIXELS] > 0])), int(np.sum(several))
