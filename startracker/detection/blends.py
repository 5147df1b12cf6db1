"""Stars whose images touch, parted."""

from __future__ import annotations

import numpy as np

from startracker.arrays import FloatArray, IntArray
from startracker.detection.plane import Plane
from startracker.detection.sources import SOURCE, Sources, add_pixel
from startracker.detection.thresholds import BLEND_LEAST_PX2, BLEND_PIXELS, RING_SHARE, VALLEY_SHARE, VALLEY_SIGMA
from startracker.detection.values import Image
from startracker.kernels import kernel, kernel_part

_FAR_PX2 = 1 << 62


@kernel_part
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


@kernel_part
def _valley(image: Image, level: Plane, x0: int, y0: int, x1: int, y1: int) -> float:
    """Least signal on the straight line from one pixel to another.

    Between pixels of equal value, as on a saturated top, the line may step aside by one pixel: its stair-shaped border
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


def part_blends(
    runs: IntArray, number: IntArray, table: Sources, most_pixels: int, image: Image, level: Plane, noise: Plane,
    saturation: float,
) -> tuple[Sources, int]:  # fmt: skip
    """Table of objects in which those with several peaks are replaced by one object per peak, and how many were.

    A peak counts when it has more than 0.05 of every brighter one of its object and the signal on the straight line
    there falls below 0.8 of it and by more than 4 times the noise. Pixels go to the nearest peak. Objects of fewer
    than six or more than `most_pixels` pixels stay whole.
    """
    most = int(np.sum(runs[:, 2] - runs[:, 1])) + 1
    peaks, heights = np.empty((most, 3), np.int64), np.empty(most)
    count = _find_peaks(runs, number, table, most_pixels, image, level, peaks, heights)
    of = peaks[:count, 2]
    several = np.flatnonzero(np.bincount(of, minlength=len(table))[of] > 1)
    if not len(several):
        return table, 0
    order = several[np.lexsort((-heights[several], of[several]))]
    peaks, heights = peaks[order], heights[order]
    # accepted peaks of an object form a chain: head[object] → following[peak] → …
    head, following = np.full(len(table), -1), np.full(len(peaks), -1)
    _chain_peaks(peaks, heights, image, level, noise, head, following)
    parted = (head >= 0) & (following[head] >= 0)
    if not parted.any():
        return table, 0
    head[~parted] = -1
    parts = np.zeros(len(peaks), SOURCE)
    _share_pixels(runs, head[number], following, peaks, image, level, np.float32(saturation), parts)
    # a part's highest pixel is its peak by construction, unless a neighbour's slope reaches into its cell
    kept = (parts["pixels"] > 0) & (parts["peak_residual"] <= heights)
    joined = np.concatenate([table.take(np.flatnonzero(~parted)), parts.take(np.flatnonzero(kept))])
    return joined, int(np.count_nonzero(parted))


@kernel
def _find_peaks(
    runs: IntArray,
    number: IntArray,
    table: Sources,
    most_pixels: int,
    image: Image,
    level: Plane,
    peaks: IntArray,
    heights: FloatArray,
) -> int:
    """Fill x, y, object and signal of the highest pixels of their neighbourhoods in objects of some sizes; how many."""
    last = np.uint64(0)
    for index in range(len(runs)):
        of, y = number[index], np.uint64(runs[index, 0])
        if not BLEND_PIXELS <= table[of]["pixels"] <= most_pixels:
            continue
        for x in range(np.uint64(runs[index, 1]), np.uint64(runs[index, 2])):
            # written for every pixel, kept for peaks
            peaks[last, 0], peaks[last, 1], peaks[last, 2] = x, y, of
            last += np.uint64(_is_peak(image, x, y))
    for peak in range(last):
        x, y = peaks[peak, 0], peaks[peak, 1]
        heights[peak] = np.float64(image[y, x]) - np.float64(level[y, x])
    return int(np.int64(last))


@kernel
def _chain_peaks(
    peaks: IntArray, heights: FloatArray, image: Image, level: Plane, noise: Plane, head: IntArray,
    following: IntArray,
) -> None:  # fmt: skip
    """Chain the peaks of each object, given by falling height, that a valley separates from those before."""
    for peak in range(len(peaks)):
        x, y, of = peaks[peak, 0], peaks[peak, 1], peaks[peak, 2]
        other, height, depth = head[of], heights[peak], VALLEY_SIGMA * noise[y, x]
        separate = True
        while other >= 0 and separate:
            dx, dy = x - peaks[other, 0], y - peaks[other, 1]
            least = _valley(image, level, x, y, peaks[other, 0], peaks[other, 1])
            separate = (
                dx * dx + dy * dy >= BLEND_LEAST_PX2
                and height > RING_SHARE * heights[other]
                and least < VALLEY_SHARE * height
                and height - least > depth
            )
            other = following[other]
        if separate:
            following[peak] = head[of]
            head[of] = peak


@kernel
def _share_pixels(
    runs: IntArray, heads: IntArray, following: IntArray, peaks: IntArray, image: Image, level: Plane,
    saturation: float, parts: Sources,
) -> None:  # fmt: skip
    """Add the pixels of runs, each to the nearest peak of the chain whose head is given; −1: the run is not shared."""
    height, width = image.shape
    for index in range(len(runs)):
        y, first = runs[index, 0], heads[index]
        if first < 0:
            continue
        for x in range(runs[index, 1], runs[index, 2]):
            nearest, best, other = -1, _FAR_PX2, first
            while other >= 0:
                dx, dy = x - peaks[other, 0], y - peaks[other, 1]
                # equal distances go to the brighter, which comes later in the chain
                if dx * dx + dy * dy <= best:
                    nearest, best = other, dx * dx + dy * dy
                other = following[other]
            part = parts[nearest]
            add_pixel(part, x, y, image[y, x], level[y, x], saturation)
            if x == 0 or y == 0 or x == width - 1 or y == height - 1:
                part["edge"] = True
