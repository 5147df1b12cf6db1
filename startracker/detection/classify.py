"""Classification of the sources of a frame as stars or the reason why not: size, shape, sharpness, surroundings."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
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
    """Pixels of the ring around a candidate, for each radius of a candidate, in flat stamps just large enough."""

    positions: IntArray
    """Indices (ring, n) into the flat stamp, sorted by sector."""
    ends: IntArray
    """Index (ring, 8) at which each sector ends."""
    masks: Masks
    """Bit masks (ring, pixels) of the flat stamp: all bits set for pixels of the ring, 0 for the others."""


@lru_cache(maxsize=4)
def rings_of(taps: int) -> Rings:
    """Rings for a filter of `taps` values; ring k begins outside a radius of k + 2 px and is 8 px wide."""
    j, i = np.mgrid[-_OUTERMOST_PX : _OUTERMOST_PX + 1, -_OUTERMOST_PX : _OUTERMOST_PX + 1].reshape(2, -1)
    # Octants: two signs, and which coordinate is larger.
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
    """Working space for the filtered image around a candidate."""

    rings: Rings
    filtered: FloatImage
    bits: Masks
    """The memory of `filtered`, viewed as integers."""
    work: FloatImage
    sample: FloatImage


def new_stamp(taps: int) -> Stamp:
    """Working space for a filter of `taps` values."""
    rings = rings_of(taps)
    pixels = rings.masks.shape[1]
    filtered, sample = np.empty(pixels, np.float32), np.empty(rings.positions.shape[1] + 1, np.float32)
    return Stamp(rings, filtered, filtered.view(np.int32), np.empty(2 * pixels, np.float32), sample)


@kernel_part
def is_clutter(
    searched: Searched, x: int, y: int, radius_px: float, quiet: float, isolation: float, stamp: Stamp
) -> bool:
    """Whether a candidate, given by its brightest pixel, fails to stand out from the ring around it.

    The ring begins 2 px beyond the candidate's radius, is 8 px wide and has eight sectors; the maximum of each sector
    is used. One neighbouring star fills two sectors, or three with its wings; branches and leaves fill most of them. So
    the candidate must be `isolation` times as high as the fourth highest maximum, both measured above the median of the
    ring, unless that maximum is below `quiet`.

    All values are those of the filtered image, see `startracker.detection.scan`.
    """
    half, filtered, rings = searched.half, stamp.filtered, stamp.rings
    ring = min(math.ceil(radius_px), _LARGEST_RADIUS_PX)
    outer = ring + _GAP_PX + _RING_PX
    pitch = 2 * (outer + len(half)) - 1
    filter_stamp(searched.image, searched.level, half, x, y, outer, stamp.work, filtered)
    # Most rings contain only sky, and then the sectors are not needed.
    if _is_calm(filtered, stamp.bits, rings.masks[ring], (2 * outer + 1) * pitch, quiet):
        return False
    height = np.float64(filtered[outer * pitch + outer])
    return bool(_is_exceeded(filtered, stamp.sample, rings.positions[ring], rings.ends[ring], height, quiet, isolation))


@kernel_part
def _is_calm(stamp: FloatImage, bits: Masks, mask: Masks, count: int, quiet: float) -> bool:
    """Whether the median of a ring exceeds its highest value less `quiet`, and all its values are finite.

    The whole stamp is scanned without branches; `mask` selects the bits of the ring's pixels. The bit patterns of
    non-negative floats, read as integers, have the same order as the floats, so that the maximum is found among
    integers.
    """
    top, pixels, below = np.int32(0), np.int32(0), np.int32(0)
    for i in range(np.uint64(count)):
        top = max(top, np.int32(bits[i] & mask[i]))
    if top >= _INFINITE_BITS:
        return False
    bits[0] = top  # the corner belongs to no ring
    limit = np.float32(np.float64(stamp[0]) - quiet)
    for i in range(np.uint64(count)):
        # The mask is −1 for pixels of the ring, so that subtracting it counts them.
        pixels = np.int32(pixels - mask[i])
        below = np.int32(below - (mask[i] if stamp[i] <= limit else np.int32(0)))
    return bool(below <= pixels // 2)


@kernel
def _is_exceeded(
    stamp: FloatImage, sample: FloatImage, positions: IntArray, ends: IntArray, height: float, quiet: float,
    isolation: float,
) -> bool:  # fmt: skip
    """Whether a candidate of this height fails to stand out from the maxima of its ring's sectors, see `is_clutter`."""
    # Unsigned indices, because numba compares signed ones with zero each time.
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
    # The median is below a value if more than half of the sample is, which needs no sorting.
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
    """Select the objects of a table that a star can be, brightest first.

    Parameters
    ----------
    table : array, shape (N,)
        Columns of `startracker.detection.sources`, brightest first (`startracker.detection.forms.brightest_first`).
    settings : DetectionSettings
        Limits.
    saturation_known : bool
        If False, a flat top at the highest value of all objects counts as saturation.
    image, background
        Where the objects were found.
    half, excess : array and float, optional
        The matched filter (`startracker.detection.scan`), if one was used, and the ratio of the noise after it to the
        noise of the background.

    Returns
    -------
    Spots
        With the number of rejected objects by reason; objects that were not examined (`classify_sources`) count as
        "fainter than the brightest".
    """
    if not len(table):
        return Spots.none()
    searched = Searched(image, background.level_plane, background.noise_plane, UNFILTERED if half is None else half)
    quiet = 0.0
    if settings.isolation > 0.0:
        # Among branches the noise of the tiles is their structure; a low quantile of it is still that of the sky.
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
"""Names of the classes other than stars, in their order."""
_SHAPE_PIXELS = 3
"""Least number of pixels of a source whose shape is measured."""
_MORE = 8
"""Sources examined at once in addition to those that would suffice if four of five were stars."""


class Criteria(NamedTuple):
    """Limits that a source must satisfy."""

    min_pixels: int
    max_pixels: int
    max_axis_ratio: float
    reject_hits: bool
    """Whether to look for cosmic rays and hot pixels (`startracker.detection.artefacts`)."""
    quiet: float
    isolation: float
    """Arguments of `is_clutter`; with an isolation of 0 no source is clutter."""
    most: int
    """Number of stars after which only long sources are still examined, because their number reveals smear."""


def classify_sources(table: Sources, saturated: Flags, searched: Searched, criteria: Criteria) -> IntArray:
    """Class (N,) of each source.

    Only the brightest sources are examined: six for each star wanted, or 36 if these give too few stars or are all as
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
    """Properties of sources that are known before they are classified, each (N,)."""

    may_be_sharp: Flags
    long: Flags
    saturated: Flags


class _Examined:
    """Sources of sufficient size, brightest first, while they are classified."""

    def __init__(self, table: Sources, saturated: Flags, searched: Searched, criteria: Criteria) -> None:
        self.table, self.searched, self.criteria = table, searched, criteria
        self.stamp = new_stamp(len(searched.half))
        long = measure_forms(table, criteria.max_axis_ratio).long
        self.pixels = np.empty((len(table), 2), np.int64)
        self.pixels[:, 0], self.pixels[:, 1] = table["x_peak"], table["y_peak"]
        judged = criteria.reject_hits & ~(saturated | table["edge"]) & (table["pixels"] >= _SHAPE_PIXELS)
        ahead = _enough_for(criteria.most) if criteria.reject_hits else 0
        self.sharpness = sharpest_star(self.pixels, judged, searched, ahead)
        # If one pixel is saturated, the clipping makes an object look wider, never sharper. Several saturated pixels
        # may be a charge trail, which is narrow and would pass for a track.
        may_be_sharp = ~table["edge"] & (~saturated | (table["saturated"] == 1))
        self.marks = _Marks(may_be_sharp & (self.sharpness.limit_px2 > 0.0), long, saturated)

    def classify(self) -> IntArray:
        """Class (N,) of each source, until there are as many stars as wanted; after that, of the long sources only."""
        kind, most = np.where(is_halo(self.table), _HALO, _UNSEEN), self.criteria.most
        left, stars = (kind == _UNSEEN).nonzero()[0], 0
        while len(left) and stars < most:
            which = left[: _enough_for(most - stars)]
            found = self._kinds_of(which)
            is_star = (found == STAR).nonzero()[0][: most - stars]
            stars += len(is_star)
            # The class of a source beyond the last star wanted stays open, so that the result does not depend on the
            # batches.
            done = len(which) if stars < most else is_star[-1] + 1
            kind[which[:done]] = found[:done]
            left = left[done:]
        long = left[self.marks.long[left]]
        if len(long):
            kind[long] = self._kinds_of(long)
        return kind

    def _kinds_of(self, which: IntArray) -> IntArray:
        """Class of each source of `which`, none of which is a halo."""
        measure_more(self.sharpness, which[self.marks.may_be_sharp[which]], self.pixels, self.searched)
        kind, limits = np.empty(len(which), np.int64), (self.criteria.quiet, self.criteria.isolation)
        _judge(self.searched, self.table, which, self.sharpness, self.marks, limits, self.stamp, kind)
        return kind


@kernel
def _judge(
    searched: Searched, table: Sources, which: IntArray, sharpness: Sharpness, marks: _Marks,
    limits: tuple[float, float], stamp: Stamp, kind: IntArray,
) -> None:  # fmt: skip
    """Classify sources that are not halos; `limits` are the last two thresholds of `is_clutter`, `quiet` and
    `isolation`."""
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
