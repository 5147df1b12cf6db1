"""What each object of a frame is: a star, or why it is none."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.hits import is_hit, sharpest_share, sharpest_star
from startracker.detection.plane import Plane
from startracker.detection.shapes import PEAK_SHARE, measure_shapes
from startracker.detection.spots import EDGE, PIXELS, SATURATED, X_PEAK, Y_PEAK
from startracker.detection.surroundings import is_clutter, ring_space
from startracker.detection.values import Image

__all__ = ["REASONS", "STAR", "judge_objects"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

STAR, _HALO, _ONE_PIXEL, _HIT, _LONG, _CLUTTER, _UNSEEN = range(7)
REASONS = (
    "halo of a brighter star",
    "hot pixel",
    "cosmic-ray hit",
    "streak",
    "clutter",
    "fainter than the brightest",
)
"""The other verdicts in words, in their order, which is that of the questions."""
_ONE_PIXEL_SHARE = 0.6


@njit(cache=True, error_model="numpy")
def judge_objects(
    table: FloatArray,
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
    """Verdict (N,) on each object of a table that has the brightest first, and whether hits could be told from stars.

    Objects are looked at until `most` of them are found to be stars; of the others only the long ones, as their number
    tells of smear.

    Parameters
    ----------
    saturated, halo, long : bool array, shape (N,)
        Objects with a saturated pixel; pieces of a halo; objects too long for a star.
    half : array
        The matched filter, see `startracker.detection.scan`.
    reject_hits : bool
        Whether to look for hits (`startracker.detection.hits`).
    offsets, ends, quiet, isolation
        As of `startracker.detection.surroundings.is_clutter`; an isolation of 0: no object is clutter.
    """
    count = len(table)
    verdict = np.full(count, _UNSEEN)
    inside = table[:, EDGE] == 0.0
    whole = ~saturated & inside
    limit, weight, share, shapes = 0.0, 0.0, 0.0, np.empty((0, 0))
    if reject_hits:
        limit, weight, shapes = sharpest_star(table, whole, image, level, noise)
        share = sharpest_share(limit, half)
    # one pixel cut off makes an object look wider, never sharper; several may be a trail of charge, which is narrow
    whole |= (table[:, SATURATED] == 1.0) & inside
    space = ring_space(half, offsets)
    place, stars = np.empty((2, 1), np.int64), 0
    for n in range(count):
        if halo[n]:
            verdict[n] = _HALO
            continue
        if stars >= most and not long[n]:
            continue
        x, y = int(table[n, X_PEAK]), int(table[n, Y_PEAK])
        if limit > 0.0 and whole[n]:
            if math.isnan(shapes[n, 0]):
                place[0, 0], place[1, 0] = x, y
                shapes[n] = measure_shapes(image, level, noise, place[0], place[1], weight)[0]
            if is_hit(shapes[n], limit, share, x, y, image, level, noise, half):
                verdict[n] = _ONE_PIXEL if shapes[n, PEAK_SHARE] > _ONE_PIXEL_SHARE else _HIT
                continue
        if long[n]:
            verdict[n] = _LONG
            continue
        if isolation > 0.0 and not saturated[n]:
            radius = math.sqrt(table[n, PIXELS] / math.pi)
            if is_clutter(image, level, half, x, y, radius, offsets, ends, quiet, isolation, space):
                verdict[n] = _CLUTTER
                continue
        verdict[n] = STAR
        stars += 1
    return verdict, limit > 0.0
