"""Region growing with the rules of Greyling 1995, section 4.2.1, and no others: size, axis ratio, and eight stars."""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.background import Background, as_image
from startracker.detection.objects import add_pixel
from startracker.detection.selection import is_saturated
from startracker.detection.spots import (
    COLUMNS,
    EDGE,
    FLUX,
    PIXELS,
    SUM_X,
    SUM_XX,
    SUM_Y,
    SUM_YY,
    X_PEAK,
    Y_PEAK,
    Spots,
)
from startracker.detection.values import Image
from startracker.errors import InputError
from startracker.settings import DetectionSettings

__all__ = ["find_first_regions", "find_round_regions"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_KEPT, _SMALL, _LARGE, _NOT_ROUND = range(4)
_REASONS = ("too small", "too large", "axis ratio")


def find_round_regions(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
    *,
    stop: bool = False,
) -> Spots:
    """Star candidates as the thesis accepts them: 7 to 36 pixels, σx²/σy² from 0.7 to 1.3, nothing else asked.

    Regions grow as in `grow_regions`, from every third pixel over the four neighbours above the threshold:
    `threshold_dn` of the raw image, as in the thesis, or, without one, background + `threshold_sigma` × noise. A region
    of `min_pixels` to `max_pixels` whose second moments along x and y (eqs. 4.8, 4.9, weighted with the pixel's excess
    over the threshold's background) satisfy |σx²/σy² − 1| < `max_axis_ratio` − 1 is a star. The `max_stars` brightest
    are kept. No matched filter, no isolation test, no test for hot pixels, no streaks: those settings have no effect.

    Parameters
    ----------
    image : array, shape (H, W)
        DN. Values that are not finite belong to no region.
    background : Background
        Of the same shape.
    settings : DetectionSettings
        Threshold and limits.
    saturation_dn : float, optional
        DN at and above which a pixel is saturated; None: a flat top at the highest value.
    stop : bool
        Stop the search at the `max_stars`-th star in reading order, as the thesis does.

    Returns
    -------
    Spots
        Brightest first, with the number of regions left out by reason.

    Raises
    ------
    InputError
        Shapes that differ, a step below one.
    """
    pixels = as_image(image)
    if pixels.shape != background.shape:
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; make it anew")
    if settings.search_step_px < 1:
        raise InputError(f"detection.search_step_px is {settings.search_step_px}; it must be at least 1")
    level = background.level
    if settings.threshold_dn is None:
        limit = level + np.float32(settings.threshold_sigma) * background.noise
    else:
        limit = np.full(pixels.shape, settings.threshold_dn, np.float32)
    table, verdict = _grow_round(
        pixels,
        level,
        limit,
        settings.search_step_px,
        np.float32(np.inf if saturation_dn is None else saturation_dn),
        settings.min_pixels,
        settings.max_pixels,
        settings.max_axis_ratio - 1.0,
        settings.max_stars if stop else np.iinfo(np.int64).max,
    )
    kept = table[verdict == _KEPT]
    left_out = np.bincount(verdict, minlength=4)[1:]
    rejected = {reason: int(number) for reason, number in zip(_REASONS, left_out, strict=True) if number}
    if not len(kept):
        return Spots.none(rejected)
    order = np.lexsort((kept[:, X_PEAK], kept[:, Y_PEAK], -kept[:, FLUX]))
    saturated = is_saturated(kept, saturation_dn is not None)[order[: settings.max_stars]]
    stars = kept[order[: settings.max_stars]]
    if len(kept) > len(stars):
        rejected["fainter than the brightest"] = len(kept) - len(stars)
    return Spots(
        stars[:, X_PEAK].astype(np.int64),
        stars[:, Y_PEAK].astype(np.int64),
        stars[:, FLUX].copy(),
        stars[:, PIXELS].astype(np.int64),
        saturated,
        stars[:, EDGE] > 0.0,
        stars[:, [SUM_X, SUM_Y]] / stars[:, [FLUX]],
        np.zeros((len(stars), 2)),
        rejected,
    )


find_first_regions = partial(find_round_regions, stop=True)
"""`find_round_regions` that stops at the `max_stars`-th star in reading order ("stop at 8")."""


@njit(cache=True, error_model="numpy")
def _judge(row: FloatArray, fewest: int, largest: int, tolerance: float) -> int:
    """Verdict on a region: its size, then its axis ratio (eqs. 4.8 and 4.9)."""
    if row[PIXELS] < fewest:
        return _SMALL
    if row[PIXELS] > largest:
        return _LARGE
    flux = row[FLUX]
    if not flux > 0.0:
        return _NOT_ROUND
    xx = row[SUM_XX] / flux - (row[SUM_X] / flux) ** 2
    yy = row[SUM_YY] / flux - (row[SUM_Y] / flux) ** 2
    if abs(xx - yy) < tolerance * yy:
        return _KEPT
    return _NOT_ROUND


@njit(cache=True, error_model="numpy")
def _grow_round(
    image: FloatImage,
    level: FloatImage,
    limit: FloatImage,
    step: int,
    saturation: float,
    fewest: int,
    largest: int,
    tolerance: float,
    most: int,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Table of regions and the verdict on each, until `most` are stars.

    The pattern is that of Fig. 4.6. The thesis' recursion is a stack.
    """
    height, width = image.shape
    table, verdict = np.zeros((64, COLUMNS)), np.zeros(64, np.int64)
    found, stars = 0, 0
    erased = np.zeros((height, width), np.bool_)
    stack = np.empty(256, np.int64)
    for y0 in range(step - 1, height - step + 1, step):
        shift = (y0 // step) % 2 if step > 1 else 0
        for x0 in range(step - 1 + shift, width - step + 1, step):
            value = image[y0, x0]
            if erased[y0, x0] or not (value > limit[y0, x0] and value < np.inf):
                continue
            if found == len(table):
                table = np.concatenate((table, np.zeros_like(table)))
                verdict = np.concatenate((verdict, np.zeros_like(verdict)))
            row = table[found]
            erased[y0, x0] = True
            stack[0] = y0 * width + x0
            depth = 1
            while depth > 0:
                depth -= 1
                y, x = stack[depth] // width, stack[depth] % width
                add_pixel(row, x, y, image[y, x], level[y, x], saturation)
                if x == 0 or y == 0 or x == width - 1 or y == height - 1:
                    row[EDGE] = 1.0
                if depth + 4 > len(stack):
                    stack = np.concatenate((stack, np.empty_like(stack)))
                for direction in range(4):
                    xn = x + (1 if direction == 2 else -1 if direction == 0 else 0)
                    yn = y + (1 if direction == 1 else -1 if direction == 3 else 0)
                    if xn < 0 or yn < 0 or xn >= width or yn >= height or erased[yn, xn]:
                        continue
                    value = image[yn, xn]
                    if value > limit[yn, xn] and value < np.inf:
                        erased[yn, xn] = True
                        stack[depth] = yn * width + xn
                        depth += 1
            verdict[found] = _judge(row, fewest, largest, tolerance)
            stars += verdict[found] == _KEPT
            found += 1
            if stars == most:
                return table[:found], verdict[:found]
    return table[:found], verdict[:found]
