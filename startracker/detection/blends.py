"""Separation of stars whose images touch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.detection.sources import SOURCE, Sources, add_pixel, join_tables
from startracker.detection.thresholds import (
    BLEND_LEAST_PX2,
    BLEND_PIXELS,
    FEWEST_RINGS,
    RING_MAJORITY,
    RING_SHARE,
    RING_STARS,
    RING_TOLERANCE,
    VALLEY_SHARE,
    VALLEY_SIGMA,
)
from startracker.detection.tiles import Plane
from startracker.detection.values import Image

_FAR_PX2 = 1 << 62


@kernel_part
def _is_peak(image: Image, x: np.uint64, y: np.uint64) -> bool:
    """Whether no neighbour is brighter; of equal neighbours the first in reading order is the peak."""
    height, width = np.uint64(image.shape[0]), np.uint64(image.shape[1])
    value, one = image[y, x], np.uint64(1)
    before, after, above, below = x > 0, x + one < width, y > 0, y + one < height
    left, right = x - np.uint64(before), x + np.uint64(after)
    up, down = y - np.uint64(above), y + np.uint64(below)
    # Without branches, which would often be mispredicted, because one pixel in a few is a peak. At the border the pixel
    # itself replaces the missing neighbours.
    higher = (image[y, right] > value) | (image[down, left] > value) | (image[down, x] > value)
    higher |= (image[down, right] > value) | (image[up, left] > value) | (image[up, x] > value)
    higher |= (image[up, right] > value) | (image[y, left] > value)
    same = above & (
        (image[up, x] == value) | (before & (image[up, left] == value)) | (after & (image[up, right] == value))
    )
    return not (higher | same | (before & (image[y, left] == value)))


@kernel
def _valley(image: Image, level: Plane, x0: int, y0: int, x1: int, y1: int) -> float:
    """Least signal on the straight line from one pixel to another.

    Between pixels of equal value, as on a saturated top, the line may step aside by one pixel: its stair-shaped border
    is not a valley.
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


class _Peaks(NamedTuple):
    """Local maxima of the objects that have several."""

    position: IntArray
    """x, y and object (N, 3)."""
    height: FloatArray
    """Signal (N,), DN."""


def part_blends(
    runs: IntArray, number: IntArray, table: Sources, most_pixels: int, image: Image, level: Plane, noise: Plane,
    saturation: float,
) -> tuple[Sources, int]:  # fmt: skip
    """Table of objects in which those with several peaks are replaced by one object per peak, and how many were.

    A peak counts as a star if it has more than 0.05 of the height of every brighter peak of its object, and if the
    signal on the straight line to that peak falls below 0.8 of it and by more than 4 times the noise. Each pixel is
    assigned to the nearest peak. Objects with fewer than six or more than `most_pixels` pixels are not split, nor are
    objects no larger than the star image of the frame if this has several peaks itself (`_of_common_image`).
    """
    most = int(table["pixels"].sum()) + 1
    room = _Peaks(np.empty((most, 3), np.int64), np.empty(most))
    count = _find_peaks(runs, number, table, most_pixels, image, level, np.zeros(len(table), np.int64), room)
    if not count:
        return table, 0
    peaks = _Peaks(room.position[:count], room.height[:count])
    # Object by object, and by falling height within an object, so that a peak is compared only with brighter ones.
    order = np.lexsort((-peaks.height, peaks.position[:, 2]))
    # accepted peaks of an object form a chain: head[object] → following[peak] → …
    head, following = np.full(len(table), -1), np.full(count, -1)
    parted = _chain_peaks(peaks, order, image, level, noise, head, following)
    if not parted:
        return table, 0
    head[_of_common_image(table, head >= 0, most_pixels)] = -1
    parted = int(np.count_nonzero(head >= 0))
    if not parted:
        return table, 0
    parts = np.zeros(count, SOURCE)
    _share_pixels(runs, number, (head, following), peaks.position, image, level, np.float32(saturation), parts)
    # The brightest pixel of a part is its peak, unless the slope of a neighbour extends into its cell.
    kept = (parts["pixels"] > 0) & (parts["peak_residual"] <= peaks.height)
    return join_tables(table.take((head < 0).nonzero()[0]), parts.take(kept.nonzero()[0])), parted


def _of_common_image(table: Sources, parted: BoolArray, most_pixels: int) -> BoolArray:
    """Objects (N,) of several peaks, `parted`, that are star images of the frame: a defocused star is a ring.

    The star image has several peaks if most of the brightest objects do and these agree in size; blends differ in size.
    """
    fit = (table["pixels"] >= BLEND_PIXELS) & (table["pixels"] <= most_pixels) & ~table["edge"]
    fit &= table["saturated"] == 0
    bright = np.flatnonzero(fit)
    bright = bright[np.argsort(-table["flux"][bright], kind="stable")][:RING_STARS]
    rings = bright[parted[bright]]
    if len(rings) < max(FEWEST_RINGS, RING_MAJORITY * len(bright)):
        return np.zeros(len(table), np.bool_)
    # Second moment xx + yy about the centre of light, px²: a measure of size that does not depend on the brightness.
    flux = np.maximum(table["flux"], 1e-30)
    x, y = table["sum_x"] / flux, table["sum_y"] / flux
    size = (table["sum_xx"] + table["sum_yy"]) / flux - x * x - y * y
    usual = float(np.median(size[rings]))
    alike = np.abs(size[rings] - usual) < RING_TOLERANCE * usual
    if np.count_nonzero(alike) < RING_MAJORITY * len(rings):
        return np.zeros(len(table), np.bool_)
    return np.asarray(parted & (size < (1.0 + RING_TOLERANCE) * usual))


@kernel
def _find_peaks(
    runs: IntArray, number: IntArray, table: Sources, most_pixels: int, image: Image, level: Plane, count: IntArray,
    peaks: _Peaks,
) -> int:  # fmt: skip
    """Fill `peaks` with those of objects within the limits of size that have several; returns their number.

    `count` (N,) receives the number of peaks of each object. `peaks` has room for all pixels.
    """
    position, height, last, kept = peaks.position, peaks.height, np.uint64(0), 0
    for index in range(len(runs)):
        of, y = number[index], np.uint64(runs[index, 0])
        if not BLEND_PIXELS <= table[of]["pixels"] <= most_pixels:
            continue
        for x in range(np.uint64(runs[index, 1]), np.uint64(runs[index, 2])):
            # Every pixel is written and the index advances only at a peak: this costs less than a branch that is
            # mispredicted.
            position[last, 0], position[last, 1], position[last, 2] = x, y, of
            is_peak = np.uint64(_is_peak(image, x, y))
            last += is_peak
            count[of] += np.int64(is_peak)
    for peak in range(last):
        x, y, of = position[peak, 0], position[peak, 1], position[peak, 2]
        if count[of] > 1:
            position[kept, 0], position[kept, 1], position[kept, 2] = x, y, of
            height[kept] = np.float64(image[y, x]) - np.float64(level[y, x])
            kept += 1
    return kept


@kernel
def _chain_peaks(
    peaks: _Peaks, order: IntArray, image: Image, level: Plane, noise: Plane, head: IntArray, following: IntArray
) -> int:
    """Chain the peaks of each object that valleys separate from brighter ones; return how many have several.

    `order` lists the peaks object by object, by falling height. An object with one accepted peak gets no chain.
    """
    position, height, parted = peaks.position, peaks.height, 0
    for peak in order:
        x, y, of = position[peak, 0], position[peak, 1], position[peak, 2]
        other, here, depth = head[of], height[peak], VALLEY_SIGMA * noise[y, x]
        separate = True
        while other >= 0 and separate:
            dx, dy = x - position[other, 0], y - position[other, 1]
            least = _valley(image, level, x, y, position[other, 0], position[other, 1])
            separate = (
                dx * dx + dy * dy >= BLEND_LEAST_PX2
                and here > RING_SHARE * height[other]
                and least < VALLEY_SHARE * here
                and here - least > depth
            )
            other = following[other]
        if separate:
            following[peak] = head[of]
            head[of] = peak
    for of in range(len(head)):
        if head[of] >= 0 and following[head[of]] >= 0:
            parted += 1
        else:
            head[of] = -1
    return parted


@kernel
def _share_pixels(
    runs: IntArray, number: IntArray, chains: tuple[IntArray, IntArray], position: IntArray, image: Image, level: Plane,
    saturation: float, parts: Sources,
) -> None:  # fmt: skip
    """Assign each pixel of the objects with a chain of peaks (heads, and next of each) to its nearest peak."""
    (head, following), (height, width) = chains, image.shape
    for index in range(len(runs)):
        y, first = runs[index, 0], head[number[index]]
        if first < 0:
            continue
        for x in range(runs[index, 1], runs[index, 2]):
            nearest, best, other = -1, _FAR_PX2, first
            while other >= 0:
                dx, dy = x - position[other, 0], y - position[other, 1]
                # At equal distances the pixel is assigned to the brighter peak, which is later in the chain.
                if dx * dx + dy * dy <= best:
                    nearest, best = other, dx * dx + dy * dy
                other = following[other]
            part = parts[nearest]
            add_pixel(part, x, y, image[y, x], level[y, x], saturation)
            if x == 0 or y == 0 or x == width - 1 or y == height - 1:
                part["edge"] = True
