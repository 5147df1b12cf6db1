"""Integer reference of the front end's components: saturated stars, trails and what is too large. See `front_end`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from startracker.core import BoolArray, IntArray
from startracker.flight.front_background import at_columns, square_root
from startracker.flight.front_rows import Searched
from startracker.flight.front_tables import OBJECTS, FrontTables

LARGEST_FACTOR = 5
LONG_SIDE = 9
"""Components without a saturated pixel and of no larger box fit in a stamp."""
LONG_VARIANCE = 6 << 8
"""Variance along the major axis, square pixels, 8 fraction bits, above which an image does not fit in a stamp."""
SATURATED, LONG, LARGE = 1, 2, 3
"""Kinds."""


class Objects(NamedTuple):
    """Components that no stamp holds, those with the most light first; one row each.

    Parameters
    ----------
    kind : int array, shape (N,)
        `SATURATED`, `LONG` or `LARGE`.
    light : int array, shape (N,)
        Sum of the pixels above the background, DN; of a large one 2^40 + its pixels.
    x, y : int array, shape (N,)
        First moments, 16 fraction bits; 0 for large ones, as the next three.
    xx, yy, xy : int array, shape (N,)
        Second moments, square pixels, 8 fraction bits.
    pixels : int array, shape (N,)
    noise : int array, shape (N,)
        At their first pixels, 8 fraction bits.
    box : int array, shape (N, 4)
        First and last column, first and last row.
    """

    kind: IntArray
    light: IntArray
    x: IntArray
    y: IntArray
    xx: IntArray
    yy: IntArray
    xy: IntArray
    pixels: IntArray
    noise: IntArray
    box: IntArray


def major_variance(xx: IntArray, yy: IntArray, xy: IntArray) -> tuple[IntArray, IntArray]:
    """Principal variances, the larger first, 8 fraction bits."""
    half = (xx - yy) >> 1
    apart, middle = square_root(half * half + xy * xy), (xx + yy) >> 1
    return middle + apart, middle - apart


def find_objects(searched: Searched, tables: FrontTables) -> Objects:
    """Components with a saturated pixel, or larger than a stamp: at most `OBJECTS`."""
    image = searched.pixels
    number, count = ndimage.label(searched.above, np.ones((3, 3)))
    y, x = np.nonzero(number)
    which = number[y, x] - 1
    level = at_columns(searched.lines.level, tables, y, x)
    light = np.maximum(image[y, x] - ((level + 128) >> 8), 0)

    def total(values: IntArray) -> IntArray:
        out = np.zeros(count, np.int64)
        np.add.at(out, which, values)
        return out

    pixels, full = total(np.ones_like(x)), total((image[y, x] >= tables.saturation).astype(np.int64))
    boxes = [(s[1].start, s[1].stop - 1, s[0].start, s[0].stop - 1) for s in ndimage.find_objects(number)]
    box = np.array(boxes, np.int64).reshape(-1, 4)
    large = pixels > LARGEST_FACTOR * tables.max_pixels
    wide = np.maximum(box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]) >= LONG_SIDE
    s = total(light)
    positive = np.where(large | (s == 0), 1, s)
    moments = np.zeros((5, count), np.int64)
    centre = [total(light * x) // positive, total(light * y) // positive]
    dx, dy = x - centre[0][which], y - centre[1][which]
    mx, my = (total(light * dx) << 8) // positive, (total(light * dy) << 8) // positive
    moments[0] = (centre[0] << 16) + (total(light * dx) << 16) // positive
    moments[1] = (centre[1] << 16) + (total(light * dy) << 16) // positive
    moments[2] = (total(light * dx * dx) << 8) // positive - ((mx * mx) >> 8)
    moments[3] = (total(light * dy * dy) << 8) // positive - ((my * my) >> 8)
    moments[4] = (total(light * dx * dy) << 8) // positive - ((mx * my) >> 8)
    moments[:, large | (s == 0)] = 0
    major = major_variance(*moments[2:])[0]
    long = wide & (major > LONG_VARIANCE)
    kind = np.where(large, LARGE, np.where(full > 0, SATURATED, np.where(long, LONG, 0)))
    key = np.where(large, (1 << 40) + pixels, s)
    first = np.full(count, len(x))
    np.minimum.at(first, which, np.arange(len(x)))
    kept = np.flatnonzero(kind)
    kept = kept[np.lexsort((first[kept], -key[kept]))][:OBJECTS]
    noise = at_columns(searched.lines.noise, tables, y[first[kept]], x[first[kept]])
    x16, y16, xx, yy, xy = moments[:, kept]
    return Objects(kind[kept], key[kept], x16, y16, xx, yy, xy, pixels[kept], noise, box[kept])


def saturated_stars(objects: Objects, tables: FrontTables) -> BoolArray:
    """Which objects with saturated pixels have a star's size and shape."""
    major, minor = major_variance(objects.xx, objects.yy, objects.xy)
    star = (objects.kind == SATURATED) & (objects.pixels <= tables.max_pixels) & (objects.light > 0)
    star &= (minor >= tables.sharp) & (major << 8 <= tables.axis_ratio * minor) & ~at_border(objects, tables)
    return np.asarray(star)


def at_border(objects: Objects, tables: FrontTables) -> BoolArray:
    """Which objects reach the border of the searched part of the frame."""
    reach, (left, right, top, bottom) = len(tables.tap) - 1, objects.box.T
    return np.asarray(
        (left <= reach) | (top <= reach) | (right >= tables.width - reach - 1) | (bottom >= tables.height - reach - 1)
    )
