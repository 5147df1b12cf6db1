"""What each source of a frame is: a star, or why it is none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.detection.cosmic_rays import Sharpness, are_cosmic_rays, sharpest_star
from startracker.detection.shapes import PEAK_SHARE, measure_shapes
from startracker.detection.sources import Searched, Sources, peak_pixels
from startracker.detection.surroundings import find_clutter
from startracker.detection.thresholds import ONE_PIXEL_SHARE

__all__ = ["REASONS", "STAR", "Marks", "Questions", "classify_sources"]

IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

STAR, _HALO, _ONE_PIXEL, _COSMIC_RAY, _LONG, _CLUTTER, _UNSEEN = range(7)
REASONS = (
    "halo of a brighter star",
    "hot pixel",
    "cosmic ray",
    "streak",
    "clutter",
    "fainter than the brightest",
)
"""The other classes in words, in their order, which is that of the questions."""
_MORE = 4


class Marks(NamedTuple):
    """What the sums over a source's pixels say: bool arrays (N,)."""

    saturated: Flags
    halo: Flags
    """Pieces of a brighter star's halo."""
    long: Flags
    """Too long for a star."""


class Questions(NamedTuple):
    """What is asked of the sources."""

    reject_hits: bool
    """Whether to look for cosmic rays and hot pixels (`startracker.detection.cosmic_rays`)."""
    quiet: float
    isolation: float
    """As of `startracker.detection.surroundings.find_clutter`; an isolation of 0: no source is clutter."""
    most: int
    """Stars after which only the long sources are looked at, as their number shows smear."""


def classify_sources(table: Sources, marks: Marks, searched: Searched, asked: Questions) -> tuple[IntArray, bool]:
    """Class (N,) of each source, the brightest first, and whether cosmic rays could be distinguished from stars."""
    frame = _Frame.of(table, marks, searched, asked)
    kind = np.where(marks.halo, _HALO, _UNSEEN)
    left, room = np.flatnonzero(~marks.halo), asked.most
    while room > 0 and len(left):
        size = room + room // _MORE + _MORE  # a few more, as some are no stars
        block, left = left[:size], left[size:]
        found = frame.classes(block)
        beyond = np.cumsum(found == STAR) - (found == STAR) >= room
        found[beyond & ~marks.long[block]] = _UNSEEN
        kind[block] = found
        room -= int(np.count_nonzero(found == STAR))
    long = left[marks.long[left]]
    if len(long):
        kind[long] = frame.classes(long)
    return kind, frame.sharpness.limit_px2 > 0.0


class _Frame(NamedTuple):
    """The sources of a frame, and what is known of all of them."""

    x: IntArray
    y: IntArray
    radius_px: NDArray[np.float64]
    marks: Marks
    judged: Flags
    """Sources that can be cosmic rays."""
    sharpness: Sharpness
    searched: Searched
    asked: Questions

    @classmethod
    def of(cls, table: Sources, marks: Marks, searched: Searched, asked: Questions) -> _Frame:
        x, y = peak_pixels(table)
        inside = ~table["edge"]
        sharpness = Sharpness(0.0, 0.0, np.empty((len(table), 0)))
        if asked.reject_hits:
            sharpness = sharpest_star(table, ~marks.saturated & inside, searched)
        # one pixel cut off makes an object look wider, never sharper; several may be a trail of charge, which is narrow
        judged = (~marks.saturated | (table["saturated"] == 1)) & inside
        return cls(x, y, np.sqrt(table["pixels"] / np.pi), marks, judged, sharpness, searched, asked)

    def classes(self, which: IntArray) -> IntArray:
        """Classes of some sources, none of them a piece of a halo."""
        kind = np.full(len(which), STAR)
        if self.sharpness.limit_px2 > 0.0:
            self._find_cosmic_rays(which, kind)
        kind[self.marks.long[which] & (kind == STAR)] = _LONG
        if self.asked.isolation > 0.0:
            asked = np.flatnonzero((kind == STAR) & ~self.marks.saturated[which])
            of = which[asked]
            clutter = find_clutter(
                self.searched.image, self.searched.level, self.searched.half, self.x[of], self.y[of],
                self.radius_px[of], self.asked.quiet, self.asked.isolation,
            )  # fmt: skip
            kind[asked[clutter]] = _CLUTTER
        return kind

    def _find_cosmic_rays(self, which: IntArray, kind: IntArray) -> None:
        asked = np.flatnonzero(self.judged[which])
        of, (limit, weight, shapes), (image, level, noise, _) = which[asked], self.sharpness, self.searched
        new = of[np.isnan(shapes[of, 0])]
        if len(new):
            shapes[new] = measure_shapes(image, level, noise, self.x[new], self.y[new], weight)
        sharp = are_cosmic_rays(shapes[of], limit, self.x[of], self.y[of], self.searched)
        one_pixel = shapes[of, PEAK_SHARE] > ONE_PIXEL_SHARE
        kind[asked[sharp]] = np.where(one_pixel, _ONE_PIXEL, _COSMIC_RAY)[sharp]
