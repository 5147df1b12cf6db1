"""Integer reference of the front end's stamps: which candidates count, and the image that the stars share.

See `front_end`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.core import BoolArray, IntArray
from startracker.flight.front_components import Objects, major_variance
from startracker.flight.front_rows import Candidates
from startracker.flight.front_tables import HALF, LEAST_IMAGE, MOST_IMAGE, SHAPE_VARIANCE_PX2, FrontTables

_RECENTRINGS = 3
_FARTHEST = 40
"""From the middle of a stamp, 1/16 px."""
_LARGEST_MEAN, _LARGEST_MOMENT = 1 << 15, 1 << 28
"""Of stamps whose light cancels."""
_NEAREST, _HALO, _HALO_RATIO = 4, 64, 20
"""Squared distances, px²: nearer than the one there is one star, nearer than the other a halo is 20 times fainter."""
_MARGIN = 3
"""Of boxes, px."""
_SHAPE_STARS, _FEWEST = 15, 3
_WIDE = round(256 * SHAPE_VARIANCE_PX2)
_WIDEST = _WIDE * 29 // 32
_TRAILED = 90
"""Difference of the principal variances, 8 fraction bits, from which an image is moved along a line, of 2 px."""
_LONG_LINE = 555
"""Variance along a line of 8 px under the weight, 8 fraction bits; that of the widest round image is 475."""
_LINE = 2169
"""As a line is shorter than a Gaussian of its variance, the weight cuts less from it: a difference d is 1/(1 + d/8.5)
times as large in px², to 3 % of the length for lines of 2 to 6 px (`tests/statistical/test_flight_front.py`)."""
_PIXEL = (1 << 24) // 12
"""Variance of a pixel, 24 fraction bits."""
_ERROR = 1774
"""Standard error of a variance, 8 fraction bits, for a noise over signal of 1: √(π w s), w = 3, s = 5.1 px⁴."""


class Shapes(NamedTuple):
    """Weighted moments of stamps."""

    x: IntArray
    y: IntArray
    """First moments from the middle pixel, 16 fraction bits."""
    xx: IntArray
    yy: IntArray
    xy: IntArray
    """Second moments under the weight, 8 fraction bits."""
    valid: BoolArray
    sharp: BoolArray
    """Whether narrower than any star."""


class StarImage(NamedTuple):
    """The image that the stars of a frame share: a Gaussian, or one moved along a line.

    Parameters
    ----------
    trail_x, trail_y : int
        Distance of its eight nodes, 16 fraction bits; (0, 0): it is not moved.
    inverse_x, inverse_y : int
        1/σ along both axes, 12 fraction bits.
    half : int
        Half side of the window of a fit.
    variance : int
        Mean of both axes, pixel included, square pixels, 8 fraction bits.
    """

    trail_x: int
    trail_y: int
    inverse_x: int
    inverse_y: int
    half: int
    variance: int

    @property
    def moved(self) -> bool:
        """Whether it is moved along a line."""
        return (self.trail_x, self.trail_y) != (0, 0)


def inside_frame(found: Candidates, tables: FrontTables) -> BoolArray:
    """Which pixels of the stamps (N, 11, 11) are on the frame."""
    away = np.arange(-HALF, HALF + 1)
    rows, columns = found.y[:, None, None] + away[:, None], found.x[:, None, None] + away
    return np.asarray((rows >= 0) & (rows < tables.height) & (columns >= 0) & (columns < tables.width))


def select_candidates(found: Candidates, objects: Objects, full: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Candidates that are neither in the box of an object nor beside a higher one; and (N, K) of which saturated stars
    (`full`) each is the image: those in whose boxes it is the highest."""
    dx, dy = found.x[:, None] - found.x, found.y[:, None] - found.y
    square = dx * dx + dy * dy
    higher = np.tri(len(found.x), k=-1, dtype=np.bool_)
    beside = (square <= _NEAREST) | ((square <= _HALO) & (_HALO_RATIO * found.height[:, None] < found.height))
    x, y, box = found.x[:, None], found.y[:, None], objects.box
    boxed = (
        (x >= box[:, 0] - _MARGIN)
        & (x <= box[:, 1] + _MARGIN)
        & (y >= box[:, 2] - _MARGIN)
        & (y <= box[:, 3] + _MARGIN)
    )
    first = boxed & full & (np.cumsum(boxed, axis=0) == 1)
    other = (boxed & ~first).any(axis=1)
    return np.asarray(~(higher & beside).any(axis=1) & ~other), np.asarray(first & ~other[:, None])


def measure_shapes(found: Candidates, tables: FrontTables) -> Shapes:
    """Moments of stamps under a Gaussian weight that follows them."""
    signal = np.where(inside_frame(found, tables), (found.stamp << 8) - found.level[:, None, None], 0)
    away = 16 * np.arange(-HALF, HALF + 1)
    centre = np.zeros((2, len(found.x)), np.int64)
    for attempt in range(_RECENTRINGS):
        u, v = away - centre[0][:, None], away - centre[1][:, None]
        last = len(tables.shape_weight) - 1
        along = tables.shape_weight[np.minimum(np.abs(u), last)]
        weight = (along[:, None, :] * tables.shape_weight[np.minimum(np.abs(v), last)][:, :, None]) >> 12
        light = weight * signal
        total = light.sum(axis=(1, 2))
        s = np.maximum(total, 1)
        column, row = light.sum(axis=1), light.sum(axis=2)
        mean = np.array([(column * u).sum(axis=1) * 16 // s, (row * v).sum(axis=1) * 16 // s])
        if attempt < _RECENTRINGS - 1:
            moved = np.clip(centre + ((mean + 8) >> 4), -_FARTHEST, _FARTHEST)
            centre = np.where(total > 0, moved, centre)
    mean = np.clip(mean, -_LARGEST_MEAN, _LARGEST_MEAN)
    xx = (column * u * u).sum(axis=1) // s - ((mean[0] * mean[0]) >> 8)
    yy = (row * v * v).sum(axis=1) // s - ((mean[1] * mean[1]) >> 8)
    xy = (light * u[:, None, :] * v[:, :, None]).sum(axis=(1, 2)) // s - ((mean[0] * mean[1]) >> 8)
    xx, yy, xy = np.clip([xx, yy, xy], -_LARGEST_MOMENT, _LARGEST_MOMENT)
    x, y = np.clip((centre << 12) + (mean << 8), -_FARTHEST << 12, _FARTHEST << 12)
    error = found.noise * _ERROR // np.maximum(total >> 12, 1)
    sharp = major_variance(xx, yy, xy)[1] + 2 * error < tables.seen_sharp
    return Shapes(x, y, xx, yy, xy, total > 0, sharp)


def frame_image(found: Candidates, shapes: Shapes, good: BoolArray, tables: FrontTables) -> StarImage:
    """The image that the highest candidates share, by the medians of their second moments."""
    whole = inside_frame(found, tables).all(axis=(1, 2)) & (found.stamp.max(axis=(1, 2), initial=0) < tables.saturation)
    used = np.flatnonzero(good & whole & shapes.valid & ~shapes.sharp)[:_SHAPE_STARS]
    if len(used) < _FEWEST:
        return _gaussian(tables.image, tables.image, tables)
    xx, yy, xy = (int(np.sort(column[used])[len(used) // 2]) for column in (shapes.xx, shapes.yy, shapes.xy))
    seen = [int(axis[0]) for axis in major_variance(np.array([xx]), np.array([yy]), np.array([xy]))]
    major, minor = _unweighted(seen[0]), _unweighted(seen[1])
    apart = major - minor
    if apart <= _TRAILED:
        return _gaussian(_unweighted(xx), _unweighted(yy), tables)
    apart = apart * _LINE // (_LINE + apart)
    turned = apart * (xx - yy) // (seen[0] - seen[1])
    along, across = (math.isqrt(max(2 * twice, 0) // 21 << 24) for twice in (apart + turned, apart - turned))
    image = _gaussian(minor, minor, tables)
    variance = minor + (apart >> 1)
    return image._replace(trail_x=along, trail_y=across if xy >= 0 else -across, half=HALF, variance=variance)


def _unweighted(seen: int) -> int:
    """Variance without the weight."""
    value = min(max(seen, 0), _WIDEST)
    return value * _WIDE // (_WIDE - value)


def _gaussian(xx: int, yy: int, tables: FrontTables) -> StarImage:
    """Image of these variances, pixel included, 8 fraction bits."""
    xx, yy = (min(max(value, LEAST_IMAGE), MOST_IMAGE) for value in (xx, yy))
    inverse_x, inverse_y = ((1 << 24) // math.isqrt((value << 16) - _PIXEL) for value in (xx, yy))
    half = tables.fit_half
    while half < HALF and 1024 * half * half < 25 * max(xx, yy):
        half += 1
    return StarImage(0, 0, inverse_x, inverse_y, half, (xx + yy) >> 1)


def look_trailed(found: Candidates, tables: FrontTables) -> bool:
    """Whether most candidates are images of long lines, or pieces of these."""
    shapes = measure_shapes(found, tables)
    major = np.sort(major_variance(shapes.xx, shapes.yy, shapes.xy)[0])
    return bool(major[len(major) // 2] > _LONG_LINE)


def parts_of_trails(found: Candidates, image: StarImage) -> BoolArray:
    """Candidates that lie on the trail of a higher one."""
    tx, ty = image.trail_x >> 8, image.trail_y >> 8
    dx, dy = found.x[:, None] - found.x, found.y[:, None] - found.y
    along, across, square = dx * tx + dy * ty, dx * ty - dy * tx, tx * tx + ty * ty
    higher = np.tri(len(found.x), k=-1, dtype=np.bool_)
    on_trail = (across * across <= 4 * square) & (np.abs(along) << 8 <= 8 * square)
    return np.asarray((higher & on_trail).any(axis=1) & (square > 0))
