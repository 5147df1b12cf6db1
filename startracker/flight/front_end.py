"""Integer reference of a flight build's front end: from the pixels of a frame to a list of measured stars.

The C source (``c/tracker_rows.c`` and its companions) takes the frame row by row; this one works on whole arrays, with
the same integers as result:

1. `front_background`, `front_rows`: background and noise of tiles of 4 rows, followed along the frame; hot pixels are
   bridged; a separable matched filter; pixels above the threshold; of their local maxima the highest, with a stamp of
   11 × 11 pixels each. Left out are those that no star is as sharp as, and those whose stamp is bright along its
   border.
2. `front_components`: components of the pixels above, of which those are kept that no stamp holds: with saturated
   pixels, longer than a stamp, or larger than any star.
3. `front_stamps`: second moments; the motion that the images of all stars share.
4. `front_fit`: position, flux and variance of each star by maximum likelihood.
5. Saturated stars and trails join the list by their first moments.
6. `front_trails`, `front_trail_fit`, `front_motion`: where the first candidates are long, components above half the
   threshold are fitted as lines, and those of one motion are the stars.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import BoolArray, IntArray
from startracker.errors import InputError
from startracker.flight.front_background import square_root
from startracker.flight.front_components import LONG, Objects, at_border, find_objects, saturated_stars
from startracker.flight.front_fit import Fits, fit_beside, fit_stars, misfit_variance
from startracker.flight.front_motion import agrees, common_motion
from startracker.flight.front_rows import Candidates, Searched, find_candidates, search_rows
from startracker.flight.front_stamps import (
    frame_image,
    look_trailed,
    measure_shapes,
    parts_of_trails,
    select_candidates,
)
from startracker.flight.front_tables import TRAIL_POINTS, FrontTables, front_arrays, front_constants, front_tables
from startracker.flight.front_trail_fit import Trail
from startracker.flight.front_trails import find_trails
from startracker.flight.stars import ELONGATED, MOST_FLUX, MOST_VARIANCE, StarList
from startracker.flight.stars import SATURATED as SATURATED_STAR

__all__ = ["FrontFrame", "FrontTables", "front_arrays", "front_constants", "front_tables", "measure_frame"]

_APART = 2 << 16
"""Fits nearer than this along both axes are of one star."""
_NEAR_PEAK = 3 << 14
"""From its highest pixel the image of a star is no farther along an axis, 3/4 px; its first moment may be, beside
another star."""
_ROUNDS = 3
"""Of fits with the neighbours' light subtracted."""
_FLAT_TOP = 167772
"""0.05² px², as of `startracker.centroid.window`, 26 fraction bits."""
_TRAIL_ENDS = 671089
"""0.1² px²: a faint trail's ends fade in the noise, 26 fraction bits."""
_FEWEST_LONG, _FEWEST_POINTS = 4, 5
"""Trails that make a frame trailed, and points that make it none, as a quarter as many points as trails do."""
_LEAST_MOTION = 7 << 8
"""Pixels, 8 fraction bits, from which trails are stars as `front_trails` finds them."""
_LARGEST_TRACE = 1 << 20


class FrontFrame(NamedTuple):
    """What the front end found in a frame."""

    stars: StarList
    saturated: int
    """Pixels of the frame that are saturated."""
    lowest: int
    highest: int
    """Pixel values."""


def measure_frame(image: ArrayLike, tables: FrontTables) -> FrontFrame:
    """Stars of a frame.

    Parameters
    ----------
    image : uint16 array, shape (H, W)
        DN.
    tables : FrontTables

    Raises
    ------
    InputError
        For an array of another shape or type.
    """
    pixels = np.asarray(image)
    if pixels.shape != (tables.height, tables.width) or pixels.dtype != np.uint16:
        raise InputError(
            f"the flight build of this camera takes {tables.height} rows of {tables.width} uint16 pixels; "
            f"got {pixels.shape} of {pixels.dtype}"
        )
    searched = search_rows(pixels, tables)
    found, trails = _divided(find_candidates(searched, tables), searched, tables)
    objects = find_objects(searched, tables)
    shapes = measure_shapes(found, tables)
    full = saturated_stars(objects, tables)
    good, owned = select_candidates(found, objects, full)
    shared = frame_image(found, shapes, good, tables)
    good &= shapes.valid & ~shapes.sharp & ~parts_of_trails(found, shared)
    near = np.where(owned.any(axis=1) | shared.moved, 1 << 30, _NEAR_PEAK)
    start = np.clip(shapes.x, -near, near), np.clip(shapes.y, -near, near)
    fits = fit_stars(found, start, np.zeros_like(found.stamp), shared, tables)
    fits = fits._replace(star=_alone(found, fits, good & fits.star))
    for _ in range(_ROUNDS):
        fits = fit_beside(found, fits, shared, tables)
    full &= ~owned[fits.star].any(axis=0)
    flags = np.where(owned.any(axis=1), SATURATED_STAR, 0) + (ELONGATED if shared.moved else 0)
    x, y = (found.x << 16) + fits.x, (found.y << 16) + fits.y
    points = StarList(x, y, fits.flux, misfit_variance(fits, tables), flags).take(fits.star)
    saturated = _saturated_stars(objects, full, tables)
    lines = _stars_of_trails(trails, 0 if shared.moved else len(points.x), tables)
    if len(lines.x):
        stars = _brightest((saturated, lines), tables)
    else:
        stars = _listed(points, saturated, objects, shared.moved, tables)
    count = int(np.count_nonzero(pixels >= tables.saturation))
    return FrontFrame(stars, count, int(pixels.min()), int(pixels.max()))


def _divided(found: Candidates, searched: Searched, tables: FrontTables) -> tuple[Candidates, list[Trail]]:
    """The highest candidates, and trails: the first candidates decide which of them has most of the memory."""
    few = min(TRAIL_POINTS, tables.pool)
    first = np.lexsort((found.x, found.y))[:few]
    if few < tables.pool and len(found.x) > few and not look_trailed(found.take(first), tables):
        return found.take(np.arange(len(found.x))[: tables.pool]), []
    return found.take(np.arange(len(found.x))[:few]), find_trails(searched, tables)


def _alone(found: Candidates, fits: Fits, star: BoolArray) -> BoolArray:
    """Stars but for those whose fits ended on a higher one."""
    x, y = (found.x << 16) + fits.x, (found.y << 16) + fits.y
    star = star.copy()
    for n in np.flatnonzero(star):
        near = (np.abs(x[:n] - x[n]) < _APART) & (np.abs(y[:n] - y[n]) < _APART)
        star[n] = not (near & star[:n]).any()
    return star


def _listed(points: StarList, full: StarList, objects: Objects, moved: bool, tables: FrontTables) -> StarList:
    """List of the stars, the brightest first: without points where trails are the stars, unless both are."""
    trails = _trailed_stars(objects, 0 if moved else len(points.x), tables)
    return _brightest((full, trails, points) if moved or not len(trails.x) else (full, trails), tables)


def _brightest(parts: tuple[StarList, ...], tables: FrontTables) -> StarList:
    stars = StarList(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    return stars.take(np.lexsort((stars.x, stars.y, -stars.flux))[: tables.max_stars])


def _saturated_stars(objects: Objects, star: BoolArray, tables: FrontTables) -> StarList:
    """Saturated stars that no fit measures, by their first moments."""
    widths = [square_root(np.maximum(variance, 0) << 8) for variance in (objects.xx, objects.yy)]
    bloomed = (widths[0] - widths[1]) >> 2
    variance = np.minimum((bloomed * bloomed << 10) + _FLAT_TOP + tables.floor, MOST_VARIANCE)
    return _stars_of(objects, variance, SATURATED_STAR).take(star)


def _stars_of_trails(trails: list[Trail], points: int, tables: FrontTables) -> StarList:
    """Trails that share the frame's motion, where this is long and they are the stars; else none."""
    motion = common_motion(trails, tables)
    if motion is None or motion.along_x**2 + motion.along_y**2 < _LEAST_MOTION**2:
        trails, motion = [], None
    ours = [trail for trail in trails if motion is not None and agrees(trail, motion)]
    if points >= max(_FEWEST_POINTS, len(ours) // 4):
        ours = []
    flux, y, x, variance = np.array([trail[:4] for trail in ours], np.int64).reshape(-1, 4).T
    return StarList(x, y, flux, np.minimum(variance + tables.floor, MOST_VARIANCE), np.full(len(x), ELONGATED))


def _trailed_stars(objects: Objects, points: int, tables: FrontTables) -> StarList:
    """Trails of one motion, where they are so many that they are the stars; else none."""
    long = (objects.kind == LONG) & ~at_border(objects, tables)
    count = int(np.count_nonzero(long))
    trace, s = np.minimum(objects.xx + objects.yy, _LARGEST_TRACE), np.maximum(objects.light, 1)
    ratio = np.minimum((objects.noise << 12) // s, 1 << 14)
    noisy = (objects.pixels * ratio * ratio * 2 * trace >> 24) + (trace * (tables.gain >> 20) >> 7) // s
    variance = np.minimum(noisy + _TRAIL_ENDS + tables.floor, MOST_VARIANCE)
    if count < _FEWEST_LONG or points >= max(_FEWEST_POINTS, count // 4):
        return _stars_of(objects, variance, ELONGATED).take(long & False)
    moments = (objects.xx, objects.yy, objects.xy)
    middle = [int(np.sort(column[long])[count // 2]) for column in moments]
    off = np.abs([column - value for column, value in zip(moments, middle, strict=True)]).max(axis=0)
    return _stars_of(objects, variance, ELONGATED).take(long & (5 * off <= middle[0] + middle[1]))


def _stars_of(objects: Objects, variance: IntArray, flag: int) -> StarList:
    flux = np.minimum(objects.light << 4, MOST_FLUX)
    return StarList(objects.x, objects.y, flux, variance, np.full(len(flux), flag))
