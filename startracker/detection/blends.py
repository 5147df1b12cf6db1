"""Stars whose images touch, parted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.sources import SOURCE, Sources, add_pixel
from startracker.detection.thresholds import BLEND_LEAST_PX2, BLEND_PIXELS, RING_SHARE, VALLEY_SHARE, VALLEY_SIGMA
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = ["part_blends"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_FAR_PX2 = 1 << 62


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
def _valley(image: Image, level: Plane, x0: int, y0: int, x1: int, y1: int) -> float:
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


def part_blends(
    runs: IntArray, number: IntArray, table: Sources, most_pixels: int, image: Image, level: Plane, noise: Plane,
    saturation: float,
) -> tuple[Sources, int]:  # fmt: skip
    """Table of objects in which those with several peaks are replaced by one object a peak, and how many were.

    A peak counts when it has more than 0.05 of every brighter one of its object and the signal on the straight way
    there falls below 0.8 of it and by more than 4 times the noise. Pixels go to the nearest peak. Objects of fewer
    than six or more than `most_pixels` pixels stay whole.
    """
    most_peaks = int(np.sum(runs[:, 2] - runs[:, 1])) + 1
    peaks, heights = np.empty((most_peaks, 3), np.int64), np.empty((most_peaks, 2))
    size, seen = np.ascontiguousarray(table["pixels"]), np.full(len(table), -1)
    found = _find_peaks(runs, number, size, most_pixels, image, peaks, seen)
    if not found:
        return table, 0
    peaks, heights = peaks[:found], heights[:found]
    _measure_peaks(peaks, image, level, noise, heights)
    # accepted peaks of an object form a chain: head[object] → following[peak] → …
    head, following = np.full(len(table), -1), np.full(found, -1)
    order = np.argsort(-heights[:, 0], kind="stable")
    if not _chain_peaks(peaks, heights, order, image, level, head, following):
        return table, 0
    several = head >= 0
    several[several] = following[head[several]] >= 0
    parts, shared = np.zeros(found, SOURCE), several[number]
    _share_pixels(runs[shared], head[number[shared]], following, peaks, image, level, np.float32(saturation), parts)
    # a part's highest pixel is its peak by construction, unless a neighbour's slope reaches into its cell
    kept = parts[(parts["pixels"] > 0) & (parts["peak_residual"] <= heights[:, 0])]
    return np.concatenate((table[~several], kept)), int(np.count_nonzero(several))


@kernel
def _find_peaks(
    runs: IntArray, number: IntArray, size: IntArray, most_pixels: int, image: Image, peaks: IntArray, seen: IntArray
) -> int:
    """Fill `peaks` with x, y and object of the highest pixels of their neighbourhoods, and how many these are.

    A peak that is its object's only one parts nothing, and is left out. `seen` (objects,) begins with −1 and counts.
    """
    last = np.uint64(0)
    for index in range(len(runs)):
        of, y = number[index], np.uint64(runs[index, 0])
        if size[of] < BLEND_PIXELS or size[of] > most_pixels:
            continue
        for x in range(np.uint64(runs[index, 1]), np.uint64(runs[index, 2])):
            # written for every pixel, kept for peaks
            peak = _is_peak(image, x, y)
            peaks[last, 0], peaks[last, 1], peaks[last, 2] = x, y, of
            last += np.uint64(peak)
            seen[of] += np.int64(peak)
    kept = 0
    for peak in range(np.int64(last)):
        if seen[peaks[peak, 2]] > 0:
            peaks[kept, 0], peaks[kept, 1], peaks[kept, 2] = peaks[peak, 0], peaks[peak, 1], peaks[peak, 2]
            kept += 1
    return kept


@kernel
def _measure_peaks(peaks: IntArray, image: Image, level: Plane, noise: Plane, heights: FloatArray) -> None:
    """Fill `heights` with the signal of the peaks, and the depth that a valley beside them must have, DN."""
    for peak in range(len(peaks)):
        x, y = peaks[peak, 0], peaks[peak, 1]
        heights[peak, 0] = np.float64(image[y, x]) - np.float64(level[y, x])
        heights[peak, 1] = VALLEY_SIGMA * noise[y, x]


@kernel
def _chain_peaks(
    peaks: IntArray, heights: FloatArray, order: IntArray, image: Image, level: Plane, head: IntArray,
    following: IntArray,
) -> bool:  # fmt: skip
    """Chain the peaks of each object, in `order`, that a valley separates from those before; whether there are any."""
    several = False
    for candidate in order:
        x, y, of = peaks[candidate, 0], peaks[candidate, 1], peaks[candidate, 2]
        separate, other, height = True, head[of], heights[candidate, 0]
        while other >= 0 and separate:
            dx, dy = x - peaks[other, 0], y - peaks[other, 1]
            least = _valley(image, level, x, y, peaks[other, 0], peaks[other, 1])
            separate = (
                dx * dx + dy * dy >= BLEND_LEAST_PX2
                and height > RING_SHARE * heights[other, 0]
                and least < VALLEY_SHARE * height
                and height - least > heights[candidate, 1]
            )
            other = following[other]
        if separate:
            several |= head[of] >= 0
            following[candidate] = head[of]
            head[of] = candidate
    return several


@kernel
def _share_pixels(
    runs: IntArray, heads: IntArray, following: IntArray, peaks: IntArray, image: Image, level: Plane,
    saturation: float, parts: Sources,
) -> None:  # fmt: skip
    """Add each pixel of the runs to the part of the nearest peak in its chain."""
    height, width = image.shape
    for index in range(len(runs)):
        y = runs[index, 0]
        for x in range(runs[index, 1], runs[index, 2]):
            nearest, best, other = -1, _FAR_PX2, heads[index]
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
