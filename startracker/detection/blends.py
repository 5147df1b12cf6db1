"""Kernel that parts stars whose images touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.sources import SOURCE, Sources, add_pixel
from startracker.detection.thresholds import RING_SHARE, VALLEY_SHARE, VALLEY_SIGMA
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = ["part_blends"]

_FEWEST_PIXELS = 6
_SMALLEST_DISTANCE_PX2 = 4

FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]


@kernel
def _is_peak(image: Image, x: np.uint64, y: np.uint64) -> bool:
    """Whether no neighbour is brighter; of equal neighbours the first in reading order is the peak."""
    height, width = np.uint64(image.shape[0]), np.uint64(image.shape[1])
    value, one = image[y, x], np.uint64(1)
    before, after, above, below = x > 0, x + one < width, y > 0, y + one < height
    left, right = x - np.uint64(before), x + np.uint64(after)
    up, down = y - np.uint64(above), y + np.uint64(below)
    # without a branch, as one in a few pixels is a peak; beyond the border the pixel itself stands for the missing one
    higher = (image[y, right] > value) | (image[down, left] > value) | (image[down, x] > value)
    higher |= (image[down, right] > value) | (image[up, left] > value) | (image[up, x] > value)
    higher |= (image[up, right] > value) | (image[y, left] > value)
    same = above & (
        (image[up, x] == value) | (before & (image[up, left] == value)) | (after & (image[up, right] == value))
    )
    return not (higher | same | (before & (image[y, left] == value)))


@kernel
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


@kernel
def part_blends(
    runs: IntArray,
    number: IntArray,
    table: Sources,
    most_pixels: int,
    image: Image,
    level: FloatImage,
    noise: FloatImage,
    saturation: float,
) -> tuple[Sources, int]:
    """Table of objects in which those with several peaks are replaced by one object a peak, and how many were.

    A peak counts when it has more than 0.05 of every brighter one of its object and the signal on the straight way
    there falls below 0.8 of it and by more than 4 times the noise. Pixels go to the nearest peak. Objects of fewer
    than six or more than `most_pixels` pixels stay whole.
    """
    height, width = image.shape
    count = len(table)
    pixels = 0
    for index in range(len(runs)):
        pixels += runs[index, 2] - runs[index, 1]
    peak_x, peak_y = np.empty(pixels + 1, np.int64), np.empty(pixels + 1, np.int64)
    peak_object, signal = np.empty(pixels + 1, np.int64), np.empty(pixels + 1)
    last = np.uint64(0)
    for index in range(len(runs)):
        size = table["pixels"][number[index]]
        if size < _FEWEST_PIXELS or size > most_pixels:
            continue
        y = np.uint64(runs[index, 0])
        for x in range(np.uint64(runs[index, 1]), np.uint64(runs[index, 2])):
            # written for every pixel, kept for peaks
            peak_x[last], peak_y[last], peak_object[last] = x, y, number[index]
            last += np.uint64(_is_peak(image, x, y))
    # a peak that is its object's only one parts nothing
    of_object = np.zeros(count, np.int64)
    found, peaks = int(last), 0
    for peak in range(found):
        of_object[peak_object[peak]] += 1
        signal[peak] = np.float64(image[peak_y[peak], peak_x[peak]]) - np.float64(level[peak_y[peak], peak_x[peak]])
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
                and signal[candidate] > RING_SHARE * signal[other]
                and least < VALLEY_SHARE * signal[candidate]
                and depth > VALLEY_SIGMA * noise[y, x]
            )
            other = following[other]
        if separate:
            several[peak_object[candidate]] = head[peak_object[candidate]] >= 0
            following[candidate] = head[peak_object[candidate]]
            head[peak_object[candidate]] = candidate
    if not several.any():
        return table, 0
    parts = np.zeros(peaks, SOURCE)
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
                parts["edge"][nearest] = True
    # a part's highest pixel is its peak by construction, unless a neighbour's slope reaches into its cell
    for peak in range(peaks):
        if parts["pixels"][peak] > 0 and parts["peak_residual"][peak] > signal[peak]:
            parts["pixels"][peak] = 0.0
    return np.concatenate((table[~several], parts[parts["pixels"] > 0])), int(np.sum(several))
