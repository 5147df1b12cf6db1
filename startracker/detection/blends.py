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


@kernel
def part_blends(
    runs: IntArray, number: IntArray, table: Sources, most_pixels: int, image: Image, level: Plane, noise: Plane,
    saturation: float,
) -> tuple[Sources, int]:  # fmt: skip
    """Table of objects in which those with several peaks are replaced by one object per peak, and how many were.

    A peak counts when it has more than 0.05 of every brighter one of its object and the signal on the straight line
    there falls below 0.8 of it and by more than 4 times the noise. Pixels go to the nearest peak. Objects of fewer
    than six or more than `most_pixels` pixels stay whole.
    """
    peaks = _find_peaks(runs, number, table, most_pixels, image)
    if not len(peaks):
        return table, 0
    heights = np.empty(len(peaks))
    for peak in range(len(peaks)):
        x, y = peaks[peak, 0], peaks[peak, 1]
        heights[peak] = np.float64(image[y, x]) - np.float64(level[y, x])
    # accepted peaks of an object form a chain: head[object] → following[peak] → …
    head, following = np.full(len(table), -1), np.full(len(peaks), -1)
    parted = _chain_peaks(peaks, heights, image, level, noise, head, following)
    if not parted:
        return table, 0
    parts = _share_pixels(runs, number, head, following, peaks, image, level, np.float32(saturation))
    out, count = np.empty(len(table) + len(parts), SOURCE), 0
    for n in range(len(table)):
        if not _has_several(head[n], following):
            out[count] = table[n]
            count += 1
    for n in range(len(parts)):
        # a part's highest pixel is its peak by construction, unless a neighbour's slope reaches into its cell
        if parts[n]["pixels"] > 0 and parts[n]["peak_residual"] <= heights[n]:
            out[count] = parts[n]
            count += 1
    return out[:count], parted


@kernel_part
def _has_several(head: int, following: IntArray) -> bool:
    """Whether a chain has more than one peak."""
    return head >= 0 and following[head] >= 0


@kernel_part
def _find_peaks(runs: IntArray, number: IntArray, table: Sources, most_pixels: int, image: Image) -> IntArray:
    """x, y and object (P, 3) of the highest pixels of their neighbourhoods in objects that have several."""
    pixels = 1
    for index in range(len(runs)):
        pixels += runs[index, 2] - runs[index, 1]
    peaks, last, seen = np.empty((pixels, 3), np.int64), np.uint64(0), np.zeros(len(table), np.int64)
    for index in range(len(runs)):
        of, y = number[index], np.uint64(runs[index, 0])
        if not BLEND_PIXELS <= table[of]["pixels"] <= most_pixels:
            continue
        for x in range(np.uint64(runs[index, 1]), np.uint64(runs[index, 2])):
            # written for every pixel, kept for peaks
            peak = _is_peak(image, x, y)
            peaks[last, 0], peaks[last, 1], peaks[last, 2] = x, y, of
            last += np.uint64(peak)
            seen[of] += np.int64(peak)
    kept = 0
    for peak in range(np.int64(last)):
        if seen[peaks[peak, 2]] > 1:
            peaks[kept, 0], peaks[kept, 1], peaks[kept, 2] = peaks[peak, 0], peaks[peak, 1], peaks[peak, 2]
            kept += 1
    return peaks[:kept]


@kernel_part
def _chain_peaks(
    peaks: IntArray, heights: FloatArray, image: Image, level: Plane, noise: Plane, head: IntArray,
    following: IntArray,
) -> int:  # fmt: skip
    """Chain the peaks of each object, by falling height, that a valley separates from those before; the number of
    objects that have several."""
    first, after, parted = np.full(len(head), -1), np.full(len(peaks), -1), 0
    for peak in range(len(peaks)):
        of = peaks[peak, 2]
        before, other = -1, first[of]
        while other >= 0 and heights[other] >= heights[peak]:
            before, other = other, after[other]
        after[peak] = other
        if before < 0:
            first[of] = peak
        else:
            after[before] = peak
    for of in range(len(first)):
        candidate = first[of]
        while candidate >= 0:
            x, y = peaks[candidate, 0], peaks[candidate, 1]
            separate, other, height, depth = True, head[of], heights[candidate], VALLEY_SIGMA * noise[y, x]
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
                following[candidate], head[of] = head[of], candidate
            candidate = after[candidate]
        parted += _has_several(head[of], following)
    return parted


@kernel_part
def _share_pixels(
    runs: IntArray, number: IntArray, head: IntArray, following: IntArray, peaks: IntArray, image: Image, level: Plane,
    saturation: float,
) -> Sources:  # fmt: skip
    """Table of the peaks: the pixels of the objects that have several, each given to the nearest peak of its chain."""
    parts, (height, width) = np.zeros(len(peaks), SOURCE), image.shape
    for index in range(len(runs)):
        y, first = runs[index, 0], head[number[index]]
        if not _has_several(first, following):
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
    return parts
