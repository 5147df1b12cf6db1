"""Region growing from a sparse search pattern (Greyling 1995, section 4.2.1)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.background import Background, as_image
from startracker.detection.objects import add_pixel
from startracker.detection.selection import select_spots
from startracker.detection.spots import COLUMNS, EDGE, Spots
from startracker.detection.values import Image
from startracker.errors import InputError
from startracker.settings import DetectionSettings

__all__ = ["grow_objects", "grow_regions"]


def grow_regions(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates by growing regions from every third pixel.

    The image is searched left to right, top to bottom on a pattern that skips `settings.search_step_px` columns and
    rows, every other row moved by one pixel (thesis Fig. 4.6: about a ninth of the pixels). From a pixel above
    background + `threshold_sigma` × noise the object grows to its four neighbours while they are above it, and is
    erased as it is collected, so that it is met once. Objects outside `min_pixels` to `max_pixels` (the thesis: 7 to
    36), and streaks, are cleared but not kept; so the Moon goes.

    The thesis stops at the eighth star found, in reading order; here all are collected and the brightest
    `max_stars` kept. An object narrower than the step can slip through the pattern.

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
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; make it anew")
    if settings.search_step_px < 1:
        raise InputError(f"detection.search_step_px is {settings.search_step_px}; it must be at least 1")
    saturation = np.inf if saturation_dn is None else float(saturation_dn)
    table, _ = grow_objects(
        pixels,
        background.level,
        background.noise,
        np.float32(settings.threshold_sigma),
        settings.search_step_px,
        np.float32(saturation),
    )
    return select_spots(table, settings, saturation_dn is not None, pixels, background)


@njit(cache=True, error_model="numpy")
def _above(value: float, level: float, noise: float, threshold: float) -> bool:
    """Whether a pixel belongs to an object; one that is not finite does not."""
    return value > level + threshold * noise and value < np.inf


@njit(cache=True, error_model="numpy")
def grow_objects(
    image: NDArray[np.float32],
    level: NDArray[np.float32],
    noise: NDArray[np.float32],
    threshold: float,
    step: int,
    saturation: float,
) -> tuple[NDArray[np.float64], int]:
    """Table of objects (see `select_spots`) met on the search pattern, and the number of pixels looked at for them.

    The recursion of the thesis is a stack here: an object may be as large as the image.
    """
    height, width = image.shape
    table = np.zeros((64, COLUMNS))
    found, visited = 0, 0
    erased = np.zeros((height, width), np.bool_)
    stack = np.empty(256, np.int64)
    for y0 in range(step - 1, height - step + 1, step):
        shift = (y0 // step) % 2 if step > 1 else 0
        for x0 in range(step - 1 + shift, width - step + 1, step):
            visited += 1
            if erased[y0, x0] or not _above(image[y0, x0], level[y0, x0], noise[y0, x0], threshold):
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
                    row[EDGE] = 1.0
                if depth + 4 > len(stack):
                    stack = np.concatenate((stack, np.empty_like(stack)))
                for direction in range(4):
                    xn = x + (1 if direction == 2 else -1 if direction == 0 else 0)
                    yn = y + (1 if direction == 1 else -1 if direction == 3 else 0)
                    if xn < 0 or yn < 0 or xn >= width or yn >= height or erased[yn, xn]:
                        continue
                    if _above(image[yn, xn], level[yn, xn], noise[yn, xn], threshold):
                        erased[yn, xn] = True
                        stack[depth] = yn * width + xn
                        depth += 1
    return table[:found], visited
