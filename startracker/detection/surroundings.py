"""What surrounds a candidate: whether it stands out of its surroundings."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.detection.sources import Searched
from startracker.detection.stamps import filter_stamp, stamp_pitch
from startracker.kernels import kernel_part
from startracker.sorting import ranked

_RING_PX = 8
_GAP_PX = 2
_LARGEST_RADIUS_PX = 12
_OUTERMOST_PX = _LARGEST_RADIUS_PX + _GAP_PX + _RING_PX
_INFINITE_BITS = np.float32(np.inf).view(np.int32)

FloatImage = NDArray[np.float32]

Masks = NDArray[np.int32]


class Rings(NamedTuple):
    """Pixels of the ring about a candidate of each radius, in a stamp of its own width."""

    positions: IntArray
    """Indices (ring, n) into the flat stamp, sector by sector."""
    ends: IntArray
    """Where the sectors end (ring, 8)."""
    masks: Masks
    """All bits of the ring's pixels in a flat stamp (ring, pixels), none of the others."""


@lru_cache(maxsize=4)
def rings_of(taps: int) -> Rings:
    """Rings for a filter of so many `taps`; the first lies outside radius 2 px, every further one a pixel further."""
    j, i = np.mgrid[-_OUTERMOST_PX : _OUTERMOST_PX + 1, -_OUTERMOST_PX : _OUTERMOST_PX + 1].reshape(2, -1)
    sector = np.where(i > 0, 4, 0) + np.where(j > 0, 2, 0) + np.where(abs(i) > abs(j), 1, 0)
    order = np.argsort(sector, kind="stable")
    i, j, sector = i[order], j[order], sector[order]
    count, half = _LARGEST_RADIUS_PX + 1, np.empty(taps, np.float32)
    masks = np.zeros((count, stamp_pitch(half, _OUTERMOST_PX) ** 2), np.int32)
    positions, ends = np.zeros((count, len(i)), np.int64), np.zeros((count, 8), np.int64)
    for ring in range(count):
        inner, outer = ring + _GAP_PX, ring + _GAP_PX + _RING_PX
        pitch = stamp_pitch(half, outer)
        inside = (i * i + j * j > inner**2) & (i * i + j * j <= outer**2)
        found = (outer + j[inside]) * pitch + outer + i[inside]
        positions[ring, : len(found)] = found
        ends[ring] = np.searchsorted(sector[inside], range(8), "right")
        masks[ring, found] = -1
    return Rings(positions, ends, masks)


class Stamp(NamedTuple):
    """Working space for the filtered image about a candidate."""

    rings: Rings
    filtered: FloatImage
    bits: Masks
    """The same memory as integers."""
    work: FloatImage
    sample: FloatImage


def new_stamp(taps: int) -> Stamp:
    """Working space for a filter of so many `taps`."""
    rings = rings_of(taps)
    pixels = rings.masks.shape[1]
    filtered, sample = np.empty(pixels, np.float32), np.empty(rings.positions.shape[1] + 1, np.float32)
    return Stamp(rings, filtered, filtered.view(np.int32), np.empty(2 * pixels, np.float32), sample)


@kernel_part
def is_clutter(
    searched: Searched, x: int, y: int, radius_px: float, quiet: float, isolation: float, stamp: Stamp
) -> bool:
    """Whether a candidate, given by its brightest pixel, fails to stand out of the ring around it.

    The ring begins 2 px beyond the candidate's radius, is 8 px wide and has eight sectors, whose maxima count. One
    neighbour fills two of them, three with its wings; branches and leaves fill most. The candidate must be `isolation`
    times as high as the fourth highest where that exceeds `quiet`, both above the ring's median.

    All this is asked of the image after the filter, see `startracker.detection.scan`.
    """
    half, filtered, rings = searched.half, stamp.filtered, stamp.rings
    ring = min(math.ceil(radius_px), _LARGEST_RADIUS_PX)
    outer = ring + _GAP_PX + _RING_PX
    pitch = 2 * (outer + len(half)) - 1
    filter_stamp(searched.image, searched.level, half, x, y, outer, stamp.work, filtered)
    # most rings have nothing in them, which needs no sectors
    if _is_calm(filtered, stamp.bits, rings.masks[ring], (2 * outer + 1) * pitch, quiet):
        return False
    height = np.float64(filtered[outer * pitch + outer])
    return bool(_is_exceeded(filtered, stamp.sample, rings.positions[ring], rings.ends[ring], height, quiet, isolation))


@kernel_part
def _is_calm(stamp: FloatImage, bits: Masks, mask: Masks, count: int, quiet: float) -> bool:
    """Whether the median of a ring exceeds its highest value less `quiet`, and all its values are finite.

    Seen at once for all of a stamp, of which `mask` keeps the bits of the ring's pixels. The bits of numbers that are
    not negative are in the order of the numbers, so that the highest is found among integers.
    """
    top, pixels, below = np.int32(0), np.int32(0), np.int32(0)
    for i in range(np.uint64(count)):
        top = max(top, np.int32(bits[i] & mask[i]))
    if top >= _INFINITE_BITS:
        return False
    bits[0] = top  # the corner belongs to no ring
    limit = np.float32(np.float64(stamp[0]) - quiet)
    for i in range(np.uint64(count)):
        pixels = np.int32(pixels - mask[i])
        below = np.int32(below - (mask[i] if stamp[i] <= limit else np.int32(0)))
    return bool(below <= pixels // 2)


@kernel_part
def _is_exceeded(
    stamp: FloatImage, sample: FloatImage, positions: IntArray, ends: IntArray, height: float, quiet: float,
    isolation: float,
) -> bool:  # fmt: skip
    """Whether a candidate of a `height` fails to stand out of the maxima of its ring's sectors: see `is_clutter`."""
    # numbers without a sign as indices: one that may be negative costs a comparison each time
    n, count, zero = np.uint64(0), np.uint64(0), np.float32(0.0)
    first = second = third = fourth = zero
    for sector in range(8):
        top, end = zero, np.uint64(ends[sector])
        while n < end:
            value = stamp[np.uint64(positions[n])]
            sample[count] = value
            finite = abs(value) < np.inf
            count += np.uint64(finite)
            top = value if finite and value > top else top
            n += np.uint64(1)
        fourth = max(fourth, min(third, top))
        third = max(third, min(second, top))
        second = max(second, min(first, top))
        first = max(first, top)
    taken = np.int64(count)
    # the median is below a value when more than half of the sample is
    below, limit = 0, np.float64(fourth) - quiet
    for k in range(taken):
        below += sample[k] < limit
    if below <= taken // 2:
        return False
    median = ranked(sample[:taken], taken // 2)[0]
    return bool(np.float64(height) - median < isolation * (np.float64(fourth) - median))
