"""What each source of a frame is: a star, or why it is none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import IntArray
from startracker.detection.cosmic_rays import sharp_shapes, sharpest_star
from startracker.detection.forms import is_halo, measure_forms
from startracker.detection.shapes import PEAK_SHARE
from startracker.detection.sources import Searched, Sources
from startracker.detection.surroundings import are_clutter
from startracker.detection.thresholds import LOOKED_AT, LOOKED_AT_MORE, ONE_PIXEL_SHARE

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
    """As of `startracker.detection.surroundings.are_clutter`; an isolation of 0: no source is clutter."""
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
    possible = np.flatnonzero(kind == _UNSEEN)
    for looked_at in (LOOKED_AT * criteria.most, LOOKED_AT_MORE * criteria.most):
        which = possible[:looked_at]
        examined = _Examined(table.take(which), saturated[which], searched, criteria)
        kind[which] = found = examined.classify()
        judged = examined.sharpness.limit_px2 > 0.0 or not criteria.reject_hits
        if len(which) < looked_at or (judged and np.count_nonzero(found == STAR) == criteria.most):
            break
    return kind


class _Examined:
    """Sources of sufficient size, brightest first."""

    def __init__(self, table: Sources, saturated: Flags, searched: Searched, criteria: Criteria) -> None:
        self.table, self.saturated, self.searched, self.criteria = table, saturated, searched, criteria
        self.long = measure_forms(table, criteria.max_axis_ratio).long
        self.pixels = np.empty((len(table), 2), np.int64)
        self.pixels[:, 0], self.pixels[:, 1] = table["x_peak"], table["y_peak"]
        judged = criteria.reject_hits & ~(saturated | table["edge"]) & (table["pixels"] >= _SHAPE_PIXELS)
        self.sharpness = sharpest_star(self.pixels, judged, searched)
        # one pixel cut off makes an object look wider, never sharper; several may be a trail of charge, which is narrow
        may_be_sharp = ~table["edge"] & (~saturated | (table["saturated"] == 1))
        self.may_be_sharp = may_be_sharp & (self.sharpness.limit_px2 > 0.0)

    def classify(self) -> IntArray:
        """Class (N,) of each, until there are as many stars as asked for; then of the long ones only."""
        kind, most = np.where(is_halo(self.table), _HALO, _UNSEEN), self.criteria.most
        left, stars = np.flatnonzero(kind == _UNSEEN), 0
        while len(left) and stars < most:
            which = left[: _MORE + (most - stars) * 5 // 4]
            found = self._kinds_of(which)
            is_star = np.flatnonzero(found == STAR)[: most - stars]
            stars += len(is_star)
            done = len(which) if stars < most else is_star[-1] + 1
            kind[which[:done]] = found[:done]
            left = left[done:]
        long = left[self.long[left]]
        if len(long):
            kind[long] = self._kinds_of(long)
        return kind

    def _kinds_of(self, which: IntArray) -> IntArray:
        """Class of each of some sources that are no halos."""
        kind = np.full(len(which), STAR)
        asked = np.flatnonzero(self.may_be_sharp[which])
        if len(asked):
            sharp, shapes = sharp_shapes(self.pixels, which[asked], self.sharpness, self.searched)
            defect = np.where(shapes[:, PEAK_SHARE] > ONE_PIXEL_SHARE, _ONE_PIXEL, _COSMIC_RAY)
            kind[asked] = np.where(sharp, defect, STAR)
        kind[(kind == STAR) & self.long[which]] = _LONG
        asked = np.flatnonzero((kind == STAR) & ~self.saturated[which])
        if self.criteria.isolation > 0.0 and len(asked):
            quiet, isolation, asked_for = self.criteria.quiet, self.criteria.isolation, which[asked]
            radius_px = np.sqrt(self.table["pixels"][asked_for] / np.pi)
            clutter = are_clutter(self.searched, self.pixels[asked_for], radius_px, quiet, isolation)
            kind[asked[clutter]] = _CLUTTER
        return kind
