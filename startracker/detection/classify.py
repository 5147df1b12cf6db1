"""What each source of a frame is: a star, or why not. Size, shape, sharpness, and what surrounds it."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.detection.artefacts import Sharpness, is_sharp, measure_more, sharpest_star
from startracker.detection.background import Background
from startracker.detection.forms import centres, is_halo, measure_forms
from startracker.detection.matched import filter_stamp, quantiles, stamp_pitch
from startracker.detection.scan import UNFILTERED
from startracker.detection.shapes import PEAK_SHARE
from startracker.detection.sources import Searched, Sources, is_saturated
from startracker.detection.spots import Spots
from startracker.detection.thresholds import LOOKED_AT, LOOKED_AT_MORE, ONE_PIXEL_SHARE, QUIET_QUANTILE
from startracker.detection.tiles import sample_plane
from startracker.detection.values import Image
from startracker.kernels import kernel_part, pixel_kernel
from startracker.settings import DetectionSettings
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


__all__ = ["FAINTER", "select_spots"]

_QUIET_STEP_PX = 16


def select_spots(
    table: Sources,
    settings: DetectionSettings,
    saturation_known: bool,
    image: Image,
    background: Background,
    half: NDArray[np.float32] | None = None,
    excess: float = 1.0,
) -> Spots:
    """Candidates out of a table of objects: those that a star can be, the brightest first.

    Parameters
    ----------
    table : array, shape (N,)
        Of `startracker.detection.sources`, brightest first (`startracker.detection.forms.brightest_first`).
    settings : DetectionSettings
        Limits.
    saturation_known : bool
        Where it is not, a flat top at the highest value of all objects is taken for saturation.
    image, background
        What the objects were found in.
    half, excess : array and float, optional
        The matched filter (`startracker.detection.scan`), where one was used, and how far the noise after it exceeds
        the background's.

    Returns
    -------
    Spots
        With the number of objects left out by reason; those that were not examined (`classify_sources`) count as
        "fainter than the brightest".
    """
    if not len(table):
        return Spots.none()
    searched = Searched(image, background.level_plane, background.noise_plane, UNFILTERED if half is None else half)
    quiet = 0.0
    if settings.isolation > 0.0:
        # where there are branches, the noise of the tiles is theirs
        noise = sample_plane(background.noise_plane, _QUIET_STEP_PX, _QUIET_STEP_PX)
        quiet = excess * settings.threshold_sigma * quantiles(noise, (QUIET_QUANTILE,))[0]
    criteria = Criteria(
        settings.min_pixels if half is None else 1,
        settings.max_pixels,
        float(settings.max_axis_ratio),
        settings.reject_hits,
        quiet,
        float(settings.isolation),
        max(settings.max_stars, 0),
    )
    saturated = is_saturated(table, saturation_known)
    kind = classify_sources(table, saturated, searched, criteria)
    counts = np.bincount(kind, minlength=len(REASONS) + 1)[1:].tolist()
    rejected = {reason: count for reason, count in zip(REASONS, counts, strict=True) if count}
    chosen = (kind == STAR).nonzero()[0]
    stars = table.take(chosen)
    return Spots(
        stars["x_peak"].copy(),
        stars["y_peak"].copy(),
        stars["flux"].copy(),
        stars["pixels"].copy(),
        saturated[chosen],
        stars["edge"].copy(),
        centres(stars),
        np.zeros((len(stars), 2)),
        rejected,
    )


Flags = NDArray[np.bool_]

STAR, _SMALL, _LARGE, _DARK, _HALO, _ONE_PIXEL, _COSMIC_RAY, _LONG, _CLUTTER, _UNSEEN = range(10)
FAINTER = "fainter than the brightest"
REASONS = (
    "too small",
    "too large",
    "without signal",
    "halo of a brighter star",
    "hot pixel",
    "cosmic ray",
    "streak",
    "clutter",
    FAINTER,
)
"""The other classes in words, in their order."""
_SHAPE_PIXELS = 3
"""Pixels from which a source has a shape."""
_MORE = 8
"""Sources examined at once beyond those that would be enough if four of five are stars."""


class Criteria(NamedTuple):
    """What is asked of the sources."""

    min_pixels: int
    max_pixels: int
    max_axis_ratio: float
    reject_hits: bool
    """Whether to look for cosmic rays and hot pixels (`startracker.detection.artefacts`)."""
    quiet: float
    isolation: float
    """As of `startracker.detection.classify.is_clutter`; an isolation of 0: no source is clutter."""
    most: int
    """Stars after which only the long sources are examined, as their number shows smear."""


def classify_sources(table: Sources, saturated: Flags, searched: Searched, criteria: Criteria) -> IntArray:
    """Class (N,) of each source.

    Only the brightest sources, six for each star asked for, are examined, 36 where these are too few stars or all as
    sharp as hot pixels.

    Parameters
    ----------
    table : array, shape (N,)
        Sources, brightest first.
    saturated : bool array, shape (N,)
        Sources with a saturated pixel.
    """
    kind = np.where(table["flux"] > 0.0, _UNSEEN, _DARK)
    kind[table["pixels"] > criteria.max_pixels] = _LARGE
    kind[table["pixels"] < criteria.min_pixels] = _SMALL
    possible = (kind == _UNSEEN).nonzero()[0]
    for looked_at in (LOOKED_AT * criteria.most, LOOKED_AT_MORE * criteria.most):
        which = possible[:looked_at]
        examined = _Examined(table.take(which), saturated[which], searched, criteria)
        kind[which] = found = examined.classify()
        judged = examined.sharpness.limit_px2 > 0.0 or not criteria.reject_hits
        if len(which) < looked_at or (judged and np.count_nonzero(found == STAR) == criteria.most):
            break
    return kind


def _enough_for(stars: int) -> int:
    return _MORE + stars * 5 // 4


class _Marks(NamedTuple):
    """What is known of sources before they are judged, each (N,)."""

    may_be_sharp: Flags
    long: Flags
    saturated: Flags


class _Examined:
    """Sources of sufficient size, brightest first."""

    def __init__(self, table: Sources, saturated: Flags, searched: Searched, criteria: Criteria) -> None:
        self.table, self.searched, self.criteria = table, searched, criteria
        self.stamp = new_stamp(len(searched.half))
        long = measure_forms(table, criteria.max_axis_ratio).long
        self.pixels = np.empty((len(table), 2), np.int64)
        self.pixels[:, 0], self.pixels[:, 1] = table["x_peak"], table["y_peak"]
        judged = criteria.reject_hits & ~(saturated | table["edge"]) & (table["pixels"] >= _SHAPE_PIXELS)
        ahead = _enough_for(criteria.most) if criteria.reject_hits else 0
        self.sharpness = sharpest_star(self.pixels, judged, searched, ahead)
        # one pixel cut off makes an object look wider, never sharper; several may be a trail of charge, which is narrow
        may_be_sharp = ~table["edge"] & (~saturated | (table["saturated"] == 1))
        self.marks = _Marks(may_be_sharp & (self.sharpness.limit_px2 > 0.0), long, saturated)

    def classify(self) -> IntArray:
        """Class (N,) of each, until there are as many stars as asked for; then of the long ones only."""
        kind, most = np.where(is_halo(self.table), _HALO, _UNSEEN), self.criteria.most
        left, stars = (kind == _UNSEEN).nonzero()[0], 0
        while len(left) and stars < most:
            which = left[: _enough_for(most - stars)]
            found = self._kinds_of(which)
            is_star = (found == STAR).nonzero()[0][: most - stars]
            stars += len(is_star)
            done = len(which) if stars < most else is_star[-1] + 1
            kind[which[:done]] = found[:done]
            left = left[done:]
        long = left[self.marks.long[left]]
        if len(long):
            kind[long] = self._kinds_of(long)
        return kind

    def _kinds_of(self, which: IntArray) -> IntArray:
        """Class of each of some sources that are no halos."""
        measure_more(self.sharpness, which[self.marks.may_be_sharp[which]], self.pixels, self.searched)
        kind, limits = np.empty(len(which), np.int64), (self.criteria.quiet, self.criteria.isolation)
        _judge(self.searched, self.table, which, self.sharpness, self.marks, limits, self.stamp, kind)
        return kind


@pixel_kernel
def _judge(
    searched: Searched, table: Sources, which: IntArray, sharpness: Sharpness, marks: _Marks,
    limits: tuple[float, float], stamp: Stamp, kind: IntArray,
) -> None:  # fmt: skip
    """Class of sources that are no halos; `limits` are those of `is_clutter`."""
    for n in range(len(which)):
        source = which[n]
        x, y, found = table[source]["x_peak"], table[source]["y_peak"], STAR
        if marks.may_be_sharp[source] and is_sharp(searched, sharpness, source, x, y):
            found = _ONE_PIXEL if sharpness.shapes[source, PEAK_SHARE] > ONE_PIXEL_SHARE else _COSMIC_RAY
        elif marks.long[source]:
            found = _LONG
        elif limits[1] > 0.0 and not marks.saturated[source]:
            radius_px = math.sqrt(table[source]["pixels"] / np.pi)
            found = _CLUTTER if is_clutter(searched, x, y, radius_px, limits[0], limits[1], stamp) else STAR
        kind[n] = found
