"""What each object of a frame is: a star, or why it is none."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.detection.cosmic_rays import is_cosmic_ray, sharpest_share, sharpest_star
from startracker.detection.plane import Plane
from startracker.detection.shapes import PEAK_SHARE, measure_shapes
from startracker.detection.sources import Sources
from startracker.detection.surroundings import is_clutter, ring_space
from startracker.detection.thresholds import ONE_PIXEL_SHARE
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = ["REASONS", "STAR", "classify_sources"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
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


@kernel
def classify_sources(
    table: Sources,
    saturated: Flags,
    halo: Flags,
    long: Flags,
    image: Image,
    level: Plane,
    noise: Plane,
    half: FloatImage,
    reject_hits: bool,
    offsets: IntArray,
    ends: IntArray,
    quiet: float,
    isolation: float,
    most: int,
) -> tuple[NDArray[np.int64], bool]:
    """Class (N,) of each source, the brightest first, and whether cosmic rays could be distinguished from stars.

    Objects are looked at until `most` of them are found to be stars; of the others only the long ones, as their number
    tells of smear.

    Parameters
    ----------
    saturated, halo, long : bool array, shape (N,)
        Objects with a saturated pixel; pieces of a halo; objects too long for a star.
    half : array
        The matched filter, see `startracker.detection.scan`.
    reject_hits : bool
        Whether to look for cosmic rays and hot pixels (`startracker.detection.cosmic_rays`).
    offsets, ends, quiet, isolation
        As of `startracker.detection.surroundings.is_clutter`; an isolation of 0: no object is clutter.
    """
    count = len(table)
    kind = np.full(count, _UNSEEN)
    inside = ~table["edge"]
    whole = ~saturated & inside
    limit, weight, share, shapes = 0.0, 0.0, 0.0, np.empty((0, 0))
    if reject_hits:
        limit, weight, shapes = sharpest_star(table, whole, image, level, noise)
        share = sharpest_share(limit, half)
    # one pixel cut off makes an object look wider, never sharper; several may be a trail of charge, which is narrow
    whole |= (table["saturated"] == 1) & inside
    space = ring_space(half, offsets)
    place, stars = np.empty((2, 1), np.int64), 0
    for n in range(count):
        if halo[n]:
            kind[n] = _HALO
            continue
        if stars >= most and not long[n]:
            continue
        x, y = int(table["x_peak"][n]), int(table["y_peak"][n])
        if limit > 0.0 and whole[n]:
            if math.isnan(shapes[n, 0]):
                place[0, 0], place[1, 0] = x, y
                shapes[n] = measure_shapes(image, level, noise, place[0], place[1], weight)[0]
            if is_cosmic_ray(shapes[n], limit, share, x, y, image, level, noise, half):
                kind[n] = _ONE_PIXEL if shapes[n, PEAK_SHARE] > ONE_PIXEL_SHARE else _COSMIC_RAY
                continue
        if long[n]:
            kind[n] = _LONG
            continue
        if isolation > 0.0 and not saturated[n]:
            radius = math.sqrt(table["pixels"][n] / math.pi)
            if is_clutter(image, level, half, x, y, radius, offsets, ends, quiet, isolation, space):
                kind[n] = _CLUTTER
                continue
        kind[n] = STAR
        stars += 1
    return kind, limit > 0.0
