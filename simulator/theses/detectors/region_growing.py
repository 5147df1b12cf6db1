"""Region growing from a sparse search pattern (Greyling 1995, section 4.2.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.detection.background import Background, as_image
from startracker.detection.classify import select_spots
from startracker.detection.forms import brightest_first
from startracker.detection.sources import SOURCE, Sources, add_pixel
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.errors import InputError
from startracker.settings import DetectionSettings

FloatImage = NDArray[np.float32]


def grow_regions(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates by growing regions from every third pixel.

    The image is searched from left to right and top to bottom on a pattern that skips `settings.search_step_px` columns
    and rows; every other row is shifted by one pixel (Greyling 1995, Fig. 4.6: about a ninth of the pixels). From a
    pixel above background + `threshold_sigma` × noise the object grows to its four neighbours while they are above it;
    its pixels are erased as they are collected, so that each object is found once. Objects outside `min_pixels` to
    `max_pixels` (Greyling: 7 to 36) and streaks are erased but not returned, which removes the Moon.

    Greyling's `grow.m` stops at the eighth star found, in reading order; here all are collected and the brightest
    `max_stars` returned. An object narrower than the step may fall between the pixels of the pattern.

    Parameters
    ----------
    image : array, shape (H, W)
        DN. Values that are not finite belong to no object.
    background : Background
        Of the same shape.
    settings : DetectionSettings
        Threshold and limits.
    saturation_dn : float, optional
        DN at and above which a pixel is saturated; None: a flat top at the highest value.

    Returns
    -------
    Spots
        Brightest first.
    """
    pixels = as_image(image)
    if pixels.shape != background.shape:
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; compute it again")
    if settings.search_step_px < 1:
        raise InputError(f"detection.search_step_px is {settings.search_step_px}; it must be at least 1")
    saturation = np.inf if saturation_dn is None else float(saturation_dn)
    limit = background.level + np.float32(settings.threshold_sigma) * background.noise
    table, _ = grow_objects(pixels, background.level, limit, settings.search_step_px, np.float32(saturation))
    return select_spots(brightest_first(table), settings, saturation_dn is not None, pixels, background)


@kernel
def grow_objects(
    image: FloatImage, level: FloatImage, limit: FloatImage, step: int, saturation: float
) -> tuple[Sources, int]:
    """Sources found on the search pattern, in that order, and the number of pixels of the pattern.

    The recursion of `grow.m` is replaced by a stack, because an object may be as large as the image.

    Parameters
    ----------
    image, level, limit : array, shape (H, W)
        Pixels above their limit, and finite, belong to sources; signals are above the level.
    step : int
        Of the pattern, pixels.
    saturation : float
        DN.
    """
    height, width = image.shape
    table, found, visited = np.zeros(64, SOURCE), 0, 0
    # Pixels that belong to no object count as erased from the start.
    erased = ~((image > limit) & (image < np.inf))
    stack = np.empty(256, np.int64)
    for y0 in range(step - 1, height - step + 1, step):
        shift = (y0 // step) % 2 if step > 1 else 0
        for x0 in range(step - 1 + shift, width - step + 1, step):
            visited += 1
            if erased[y0, x0]:
                continue
            if found == len(table):
                table = np.concatenate((table, np.zeros_like(table)))
            row = table[found]
            found += 1
            erased[y0, x0] = True
            stack[0] = y0 * width + x0
            depth = 1
            while depth > 0:
                depth -= 1
                y, x = stack[depth] // width, stack[depth] % width
                add_pixel(row, x, y, image[y, x], level[y, x], saturation)
                if x == 0 or y == 0 or x == width - 1 or y == height - 1:
                    row["edge"] = True
                # Four neighbours at most are added per pixel.
                if depth + 4 > len(stack):
                    stack = np.concatenate((stack, np.empty_like(stack)))
                for direction in range(4):
                    xn = x + (1 if direction == 2 else -1 if direction == 0 else 0)
                    yn = y + (1 if direction == 1 else -1 if direction == 3 else 0)
                    if 0 <= xn < width and 0 <= yn < height and not erased[yn, xn]:
                        erased[yn, xn] = True
                        stack[depth] = yn * width + xn
                        depth += 1
    return table[:found], visited
