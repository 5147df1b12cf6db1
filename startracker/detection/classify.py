"""What each source of a frame is: a star, or why it is none."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import IntArray
from startracker.detection.cosmic_rays import Sharpness, is_sharp, sharpest_star
from startracker.detection.forms import form_of, is_halo
from startracker.detection.shapes import PEAK_SHARE, measure_shape
from startracker.detection.sources import Searched, Sources
from startracker.detection.surroundings import Rings, is_clutter, stamp_of
from startracker.detection.thresholds import LOOKED_AT, LOOKED_AT_MORE, ONE_PIXEL_SHARE
from startracker.kernels import kernel, kernel_part

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


@kernel
def classify_sources(
    table: Sources, saturated: Flags, searched: Searched, criteria: Criteria, rings: Rings
) -> IntArray:
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
    kind, possible, count = np.full(len(table), _UNSEEN), np.empty(len(table), np.int64), 0
    for n in range(len(table)):
        if table[n]["pixels"] < criteria.min_pixels:
            kind[n] = _SMALL
        elif table[n]["pixels"] > criteria.max_pixels:
            kind[n] = _LARGE
        elif not table[n]["flux"] > 0.0:
            kind[n] = _DARK
        else:
            possible[count] = n
            count += 1
    for looked_at in (LOOKED_AT * criteria.most, LOOKED_AT_MORE * criteria.most):
        size, stars = min(count, looked_at), 0
        sources, flags = np.empty_like(table[:size]), np.empty(size, np.bool_)
        for n in range(size):
            sources[n], flags[n] = table[possible[n]], saturated[possible[n]]
        found, judged = _classify_examined(sources, flags, searched, criteria, rings)
        for n in range(size):
            kind[possible[n]] = found[n]
            stars += found[n] == STAR
        if size < looked_at or ((judged or not criteria.reject_hits) and stars == criteria.most):
            break
    return kind


@kernel_part
def _classify_examined(
    table: Sources, saturated: Flags, searched: Searched, criteria: Criteria, rings: Rings
) -> tuple[IntArray, bool]:
    """Class (N,) of each source of sufficient size, and whether cosmic rays could be distinguished from stars."""
    kind, stars, stamp = np.full(len(table), _UNSEEN), 0, stamp_of(rings)
    halo, judged = is_halo(table), np.empty(len(table), np.bool_)
    for n in range(len(table)):
        judged[n] = criteria.reject_hits and not (saturated[n] or table[n]["edge"])
    sharpness = sharpest_star(table, judged, searched)
    for n in range(len(table)):
        if halo[n]:
            kind[n] = _HALO
            continue
        long = form_of(table[n], criteria.max_axis_ratio)[5]
        if stars == criteria.most and not long:
            continue
        # one pixel cut off makes an object look wider, never sharper; several may be a trail of charge, which is narrow
        if sharpness.limit_px2 > 0.0 and not table[n]["edge"] and (not saturated[n] or table[n]["saturated"] == 1):
            kind[n] = _sharp_kind(table, n, searched, sharpness)
        else:
            kind[n] = STAR
        if kind[n] == STAR and long:
            kind[n] = _LONG
        elif kind[n] == STAR and criteria.isolation > 0.0 and not saturated[n]:
            radius = np.sqrt(table[n]["pixels"] / np.pi)
            x, y, height = table[n]["x_peak"], table[n]["y_peak"], (criteria.quiet, criteria.isolation)
            if is_clutter(searched, x, y, radius, height, rings, stamp):
                kind[n] = _CLUTTER
        stars += kind[n] == STAR
    return kind, sharpness.limit_px2 > 0.0


@kernel_part
def _sharp_kind(table: Sources, n: int, searched: Searched, sharpness: Sharpness) -> int:
    """Hot pixel or cosmic ray, where a source is one of them; its shape is measured where it was not yet."""
    x, y, shape = table[n]["x_peak"], table[n]["y_peak"], sharpness.shapes[n]
    if np.isnan(shape[0]):
        measure_shape(searched.image, searched.level, searched.noise, x, y, sharpness.weight, shape)
    if not is_sharp(shape, sharpness, x, y, searched):
        return STAR
    return _ONE_PIXEL if shape[PEAK_SHARE] > ONE_PIXEL_SHARE else _COSMIC_RAY
