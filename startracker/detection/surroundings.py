"""What surrounds a candidate: a star stands out of it, a leaf among leaves does not."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.stamps import filter_stamp, stamp_pitch
from startracker.detection.tiles import select_kth
from startracker.detection.values import Image

__all__ = ["is_clutter", "ring_pixels", "ring_space"]

_RING_PX = 8
_LARGEST_RADIUS_PX = 12

FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]


@cache
def ring_pixels() -> tuple[IntArray, IntArray]:
    """Offsets (ring, n, 2) along y and x of the pixels of rings, sector by sector, and where sectors end (ring, 8).

    The first ring lies outside radius 2 px, every further one a pixel further out.
    """
    outermost = _LARGEST_RADIUS_PX + 2 + _RING_PX
    j, i = np.mgrid[-outermost : outermost + 1, -outermost : outermost + 1].reshape(2, -1)
    sector = np.where(i > 0, 4, 0) + np.where(j > 0, 2, 0) + np.where(abs(i) > abs(j), 1, 0)
    order = np.argsort(sector, kind="stable")
    i, j, sector = i[order], j[order], sector[order]
    rings = [
        np.flatnonzero((i * i + j * j > inner**2) & (i * i + j * j <= (inner + _RING_PX) ** 2))
        for inner in range(2, _LARGEST_RADIUS_PX + 3)
    ]
    offsets = np.zeros((len(rings), max(map(len, rings)), 2), np.int64)
    for ring, inside in enumerate(rings):
        offsets[ring, : len(inside)] = np.column_stack([j, i])[inside]
    ends = [np.searchsorted(sector[inside], range(8), "right") for inside in rings]
    return offsets, np.array(ends, np.int64)


@njit(cache=True, error_model="numpy")
def ring_space(half: FloatImage, offsets: IntArray) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Working space of `is_clutter`."""
    pixels = stamp_pitch(half, _LARGEST_RADIUS_PX + 2 + _RING_PX) ** 2
    return np.empty(pixels, np.float32), np.empty(2 * pixels, np.float32), np.empty(offsets.shape[1] + 1, np.float32)


@njit(cache=True, error_model="numpy")
def is_clutter(
    image: Image,
    level: Plane,
    half: FloatImage,
    x: int,
    y: int,
    radius: float,
    offsets: IntArray,
    ends: IntArray,
    quiet: float,
    isolation: float,
    space: tuple[FloatImage, FloatImage, FloatImage],
) -> bool:
    """Whether a candidate fails to stand out of the ring around it.

    The ring begins 2 px beyond the candidate's radius, is 8 px wide and has eight sectors, whose maxima count. One
    neighbour fills two of them, three with its wings; branches and leaves fill most. The candidate must be `isolation`
    times as high as the fourth highest where that exceeds `quiet`, both above the ring's median.

    All this is asked of the image after the filter `half`, see `startracker.detection.scan`; `offsets` and `ends` are
    the `ring_pixels`.
    """
    stamp, work, sample = space
    ring = min(math.ceil(radius), _LARGEST_RADIUS_PX)
    outer = ring + 2 + _RING_PX
    pitch = stamp_pitch(half, outer)
    filter_stamp(image, level, half, x, y, outer, work, stamp)
    middle = outer * pitch + outer
    # numbers without a sign as indices: one that may be negative costs a comparison each time
    places, n, count = offsets[ring], np.uint64(0), np.uint64(0)
    highest = np.zeros(8, np.float32)
    for sector in range(8):
        top, end = np.float32(0.0), np.uint64(ends[ring, sector])
        while n < end:
            value = stamp[np.uint64(middle + places[n, 0] * pitch + places[n, 1])]
            sample[count] = value
            finite = abs(value) < np.inf
            count += np.uint64(finite)
            top = value if finite and value > top else top
            n += np.uint64(1)
        # from the lowest to the highest
        k = sector
        while k > 0 and highest[k - 1] > top:
            highest[k] = highest[k - 1]
            k -= 1
        highest[k] = top
    fourth, taken = np.float64(highest[4]), int(count)
    # the median is below a value when more than half of the sample is
    below, limit = 0, fourth - quiet
    for value in sample[:taken]:
        below += value < limit
    if below <= taken // 2:
        return False
    median = select_kth(sample, 0, taken, taken // 2)
    return bool(np.float64(stamp[middle]) - median < isolation * (fourth - median))
