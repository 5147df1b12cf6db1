"""Charge that arose in the detector, hot pixels and particles' tracks, distinguished from light by its sharpness."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.detection.shapes import MINOR, MINOR_ERROR, PEAK_SHARE, SHAPE_COLUMNS, SHAPE_SNR, measure_shapes
from startracker.detection.sources import Searched, Sources, peak_pixels
from startracker.detection.stamps import filtered_at
from startracker.detection.thresholds import (
    COMMON_WIDTH_RATIO,
    FEWEST_WIDE,
    HOT_PEAK_SHARE,
    HOT_SHARE,
    MANY_SHARP,
    PEAK_ERRORS,
    SHARP_ERRORS,
    SHARP_SHARE,
    SHARPEST_STARS_PX2,
    WIDEST_TRACK_PX2,
    WIDTH_SNR,
)

__all__ = ["Sharpness", "are_cosmic_rays", "common_width", "peak_share", "sharpest_star"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

_PIXEL_VARIANCE = 1.0 / 12.0
_WEIGHT_PX = 1.2
_WEIGHTS = 3
_WIDTH_STARS = 40
_SHAPE_PIXELS = 3


class Sharpness(NamedTuple):
    """The sharpest star image that a frame can have."""

    limit_px2: float
    """Its variance along the minor axis; 0 where stars are as sharp as tracks, and nothing is to be judged."""
    weight_px: float
    """Width of the weight that shapes are measured under."""
    shapes: FloatArray
    """Shapes (N, 5) of the objects measured under it so far; NaN for the others."""


def common_width(variance: FloatArray) -> float:
    """The variance that most values share, to a factor 1.3 either way; NaN for none.

    Cosmic rays scatter over all widths, stars agree: so stars are found among more cosmic rays than stars, where a
    median is not. Of equal numbers the wider counts.
    """
    values = np.sort(variance[np.isfinite(variance) & (variance > 0.0)])
    if not len(values):
        return math.nan
    upper = np.searchsorted(values, values * COMMON_WIDTH_RATIO, "right")
    near = upper - np.searchsorted(values, values / COMMON_WIDTH_RATIO, "left")
    centre = values[len(values) - 1 - int(np.argmax(near[::-1]))]
    first = int(np.searchsorted(values, centre / COMMON_WIDTH_RATIO, "left"))
    last = int(np.searchsorted(values, centre * COMMON_WIDTH_RATIO, "right")) - 1
    return 0.5 * float(values[(first + last) // 2] + values[(first + last + 1) // 2])


def sharpest_star(table: Sources, judged: Flags, searched: Searched) -> Sharpness:
    """Least variance along the minor axis that a star image of the frame can have.

    The stars' common variance is that of the first forty clear ones among the eighty brightest objects that are to be
    `judged`, or of what is not a hot pixel where hot pixels are nearly all.
    """
    image, level, noise, _ = searched
    x, y = peak_pixels(table)
    candidates = np.flatnonzero(judged & (table["pixels"] >= _SHAPE_PIXELS))
    brightest = candidates[: 2 * _WIDTH_STARS]
    shapes = np.full((len(table), SHAPE_COLUMNS), np.nan)
    weight, width, examined = _WEIGHT_PX, math.nan, brightest
    for attempt in range(_WEIGHTS):
        shapes[examined] = measure_shapes(image, level, noise, x[examined], y[examined], weight)
        if attempt == _WEIGHTS - 1:
            break
        clear = brightest[shapes[brightest, SHAPE_SNR] > WIDTH_SNR][:_WIDTH_STARS]
        width = common_width(shapes[clear, MINOR])
        if not width > SHARPEST_STARS_PX2:
            others = candidates[len(examined) :]
            shapes[others] = measure_shapes(image, level, noise, x[others], y[others], weight)
            examined = candidates
            width = _width_beside_pixels(shapes[examined], width)
        if not width > weight**2:
            break
        weight = 1.2 * math.sqrt(width)
    limit = min(SHARP_SHARE * width, WIDEST_TRACK_PX2) if width > SHARPEST_STARS_PX2 else 0.0
    return Sharpness(limit, weight, shapes)


def _width_beside_pixels(shapes: FloatArray, width: float) -> float:
    """The variance that stars share where they are few among hot pixels; else `width`.

    Stars sharper than a pixel are not taken for hot pixels: wherever such a star falls off the middle of its pixel, its
    neighbours have light too. So where nearly all that is sharp is nothing but one pixel, and three others are not
    sharp, these are the stars.
    """
    clear = shapes[shapes[:, SHAPE_SNR] > WIDTH_SNR]
    wide = clear[:, MINOR] > SHARPEST_STARS_PX2
    sharp = np.count_nonzero(~wide)
    alone = np.count_nonzero(clear[~wide, PEAK_SHARE] > HOT_PEAK_SHARE)
    if sharp >= MANY_SHARP and alone >= HOT_SHARE * sharp and np.count_nonzero(wide) >= FEWEST_WIDE:
        return common_width(clear[wide, MINOR])
    return width


def are_cosmic_rays(shapes: FloatArray, limit_px2: float, x: IntArray, y: IntArray, searched: Searched) -> Flags:
    """Which objects (N,) are sharper than the star images of their frame.

    The optics spread all light alike; charge that arises in the detector stays in its pixels. Judged is the variance
    along the minor axis: a track is long at most in one direction, and smear widens no star in that one. The sharpest
    star allowed has 0.45 of the variance that the frame's stars share, and at most 0.4 px² (the PSF of a poor lens
    varies more than twice over its field, but a track is never wider). Out goes what is below that by twice its
    standard error; and, where the matched filter is one that spreads light, what has a brightest pixel that
    exceeds by three times its noise the one which such a star has with the object's filtered signal: this finds a hot
    pixel of 9σ, whose moments do not show it. Saturated objects, those cut off by the border, and frames whose stars
    are as sharp as tracks, are not to be judged.

    Parameters
    ----------
    shapes : array, shape (N, 5)
        Of `measure_shapes`.
    limit_px2 : float
        From `sharpest_star`.
    x, y : int array, shape (N,)
        Brightest pixels.
    """
    image, level, noise, half = searched
    sharp = shapes[:, MINOR] + SHARP_ERRORS * shapes[:, MINOR_ERROR] < limit_px2
    if half[1] == 0.0:
        return np.asarray(sharp)
    share = peak_share(math.sqrt(max(limit_px2 - _PIXEL_VARIANCE, 0.01)), half)
    filtered, signal = filtered_at(image, level, half, x, y)
    most = share * filtered + PEAK_ERRORS * noise[y, x].astype(np.float64)
    return np.asarray(sharp | (signal > most))


def peak_share(star_sigma_px: float, half: FloatImage) -> float:
    """Brightest pixel of a star on a pixel's centre, as a share of its signal after the filter `half`."""
    before = math.erf(0.5 / (math.sqrt(2.0) * star_sigma_px))
    middle, along = before, before * float(half[0])
    for k in range(1, len(half)):
        edge = math.erf((k + 0.5) / (math.sqrt(2.0) * star_sigma_px))
        along += (edge - before) * float(half[k])
        before = edge
    return (middle / along) ** 2
