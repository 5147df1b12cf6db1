"""What each source of a frame is: a star, or why it is none."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.detection.cosmic_rays import Sharpness, is_sharp, measure_more, sharpest_star
from startracker.detection.forms import is_halo, measure_forms
from startracker.detection.shapes import PEAK_SHARE
from startracker.detection.sources import Searched, Sources
from startracker.detection.surroundings import Stamp, is_clutter, new_stamp
from startracker.detection.thresholds import LOOKED_AT, LOOKED_AT_MORE, ONE_PIXEL_SHARE
from startracker.kernels import pixel_kernel

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
    """Whether to look for cosmic rays and hot pixels (`startracker.detection.cosmic_rays`)."""
    quiet: float
    isolation: float
    """As of `startracker.detection.surroundings.is_clutter`; an isolation of 0: no source is clutter."""
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
