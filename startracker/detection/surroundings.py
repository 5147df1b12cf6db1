"""What surrounds a candidate: a star stands out of it, a leaf among leaves does not."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.stamps import filter_stamp, stamp_pitch
from startracker.detection.tiles import select_kth
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = ["is_clutter", "ring_pixels", "ring_space"]

_RING_PX = 8
_LARGEST_RADIUS_PX = 12
_INFINITE_BITS = np.float32(np.inf).view(np.int32)
_NOT_MADE = 1

FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]
Masks = NDArray[np.int32]
RingSpace = tuple[FloatImage, FloatImage, FloatImage, Masks]


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


@kernel
def ring_space(half: FloatImage, offsets: IntArray) -> RingSpace:
    """Working space of `is_clutter`."""
    pixels = stamp_pitch(half, _LARGEST_RADIUS_PX + 2 + _RING_PX) ** 2
    masks = np.empty((len(offsets), pixels), np.int32)
    masks[:, 0] = _NOT_MADE
    sample = np.empty(offsets.shape[1] + 1, np.float32)
    return np.empty(pixels, np.float32), np.empty(2 * pixels, np.float32), sample, masks


@kernel
def _is_calm(stamp: FloatImage, mask: Masks, quiet: float) -> bool:
    """Whether the median of a ring exceeds its highest value less `quiet`, and all its values are finite.

    Seen at once for all of a stamp, of which `mask` keeps the bits of the ring's pixels. The bits of numbers that are
    not negative are in the order of the numbers, so that integers tell the highest.
    """
    bits, top, pixels, below = stamp.view(np.int32), np.int32(0), np.int32(0), np.int32(0)
    for i in range(len(mask)):
        top = max(top, np.int32(bits[i] & mask[i]))
    if top >= _INFINITE_BITS:
        return False
    bits[0] = top  # the corner belongs to no ring
    limit = np.float32(np.float64(stamp[0]) - quiet)
    for i in range(len(mask)):
        pixels = np.int32(pixels - mask[i])
        below = np.int32(below - (mask[i] if stamp[i] <= limit else np.int32(0)))
    return bool(below <= pixels // 2)


@kernel
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
    space: RingSpace,
) -> bool:
    """Whether a candidate fails to stand out of the ring around it.

    The ring begins 2 px beyond the candidate's radius, is 8 px wide and has eight sectors, whose maxima count. One
    neighbour fills two of them, three with its wings; branches and leaves fill most. The candidate must be `isolation`
    times as high as the fourth highest where that exceeds `quiet`, both above the ring's median.

    All this is asked of the image after the filter `half`, see `startracker.detection.scan`; `offsets` and `ends` are
    the `ring_pixels`.
    """
    stamp, work, sample, masks = space
    ring = min(math.ceil(radius), _LARGEST_RADIUS_PX)
    outer = ring + 2 + _RING_PX
    pitch = stamp_pitch(half, outer)
    filter_stamp(image, level, half, x, y, outer, work, stamp)
    middle = outer * pitch + outer
    places, mask = offsets[ring], masks[ring][: (2 * outer + 1) * pitch]
    if mask[0] == _NOT_MADE:
        mask[:] = 0
        for k in range(ends[ring, 7]):
            mask[middle + places[k, 0] * pitch + places[k, 1]] = -1
    # most rings have nothing in them, which needs no sectors
    if _is_calm(stamp[: len(mask)], mask, quiet):
        return False
    # numbers without a sign as indices: one that may be negative costs a comparison each time
    n, count = np.uint64(0), np.uint64(0)
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
