"""Kernels that tell charge that arose in the detector, hot pixels and particles' tracks, from light: by sharpness."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.shapes import PEAK_SHARE, SHAPE_COLUMNS, SHAPE_SNR, measure_shapes
from startracker.detection.sources import Sources
from startracker.detection.stamps import filtered_at
from startracker.detection.thresholds import (
    COMMON_WIDTH_RATIO,
    PEAK_ERRORS,
    SHARP_ERRORS,
    SHARP_SHARE,
    SHARPEST_STARS_PX2,
    WIDEST_TRACK_PX2,
    WIDTH_SNR,
)
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = ["common_width", "is_cosmic_ray", "peak_share", "sharpest_share", "sharpest_star"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
Flags = NDArray[np.bool_]

_PIXEL_VARIANCE = 1.0 / 12.0
_WEIGHT_PX = 1.2
_WEIGHTS = 3
_WIDTH_STARS = 40
_ALONE, _ALONE_SHARE, _MANY_SHARP, _FEWEST_STARS = 0.75, 0.8, 5, 3


@kernel
def common_width(variance: FloatArray) -> float:
    """The variance that most values share, to a factor 1.3 either way; NaN for none.

    Cosmic rays scatter over all widths, stars agree: so stars are found among more cosmic rays than stars, where a
    median is not. Of equal numbers the wider counts.
    """
    values = np.sort(variance[np.isfinite(variance) & (variance > 0.0)])
    count = len(values)
    if count == 0:
        return np.nan
    most, centre = 0, 0.0
    for k in range(count):
        near = 0
        for other in range(count):
            near += values[k] / COMMON_WIDTH_RATIO <= values[other] <= values[k] * COMMON_WIDTH_RATIO
        if near >= most:
            most, centre = near, values[k]
    first, last = 0, count - 1
    while values[first] < centre / COMMON_WIDTH_RATIO:
        first += 1
    while values[last] > centre * COMMON_WIDTH_RATIO:
        last -= 1
    return float(0.5 * (values[(first + last) // 2] + values[(first + last + 1) // 2]))


@kernel
def sharpest_star(
    table: Sources, judged: Flags, image: Image, level: Plane, noise: Plane
) -> tuple[float, float, FloatArray]:
    """Least variance along the minor axis that a star image of the frame can have, px²; the weight that variances are
    measured under, and the shapes of the objects measured under it so far: NaN for the others.

    The stars' common variance is that of the first forty clear ones among the eighty brightest objects, or of what is
    not a hot pixel where hot pixels are nearly all. Zero where stars are as sharp as tracks.
    """
    x, y = table["x_peak"].astype(np.int64), table["y_peak"].astype(np.int64)
    candidates = np.flatnonzero(judged & (table["pixels"] >= 3))
    brightest = candidates[: 2 * _WIDTH_STARS]
    shapes = np.full((len(table), SHAPE_COLUMNS), np.nan)
    weight, width, examined = _WEIGHT_PX, np.nan, brightest
    for attempt in range(_WEIGHTS):
        shapes[examined] = measure_shapes(image, level, noise, x[examined], y[examined], weight)
        if attempt == _WEIGHTS - 1:
            break
        clear = brightest[shapes[brightest, SHAPE_SNR] > WIDTH_SNR][:_WIDTH_STARS]
        width = common_width(shapes[clear, 0])
        if not width > SHARPEST_STARS_PX2:
            others = candidates[len(examined) :]
            shapes[others] = measure_shapes(image, level, noise, x[others], y[others], weight)
            examined = candidates
            width = _width_beside_pixels(shapes[examined], width)
        if not width > weight**2:
            break
        weight = 1.2 * math.sqrt(width)
    limit = min(SHARP_SHARE * width, WIDEST_TRACK_PX2) if width > SHARPEST_STARS_PX2 else 0.0
    return limit, weight, shapes


@kernel
def _width_beside_pixels(shapes: FloatArray, width: float) -> float:
    """The variance that stars share where they are few among hot pixels; else `width`.

    Stars sharper than a pixel are not taken for hot pixels: wherever such a star falls off the middle of its pixel, its
    neighbours have light too. So where nearly all that is sharp is nothing but one pixel, and three others are not
    sharp, these are the stars.
    """
    clear = shapes[shapes[:, SHAPE_SNR] > WIDTH_SNR]
    wide = clear[:, 0] > SHARPEST_STARS_PX2
    sharp = len(clear) - np.sum(wide)
    alone = np.sum(clear[~wide, PEAK_SHARE] > _ALONE)
    if sharp >= _MANY_SHARP and alone >= _ALONE_SHARE * sharp and np.sum(wide) >= _FEWEST_STARS:
        width = common_width(clear[wide, 0])
    return width


@kernel
def is_cosmic_ray(
    shape: FloatArray, limit: float, share: float, x: int, y: int, image: Image, level: Plane, noise: Plane,
    half: FloatImage,
) -> bool:  # fmt: skip
    """Whether an object is sharper than the star images of its frame.

    The optics spread all light alike; charge that arises in the detector stays in its pixels. Judged is the variance
    along the minor axis: a track is long at most in one direction, and smear widens no star in that one. The sharpest
    star allowed has 0.45 of the variance that the frame's stars share, and at most 0.4 px² (the PSF of a poor lens
    varies more than twice over its field, but a track is never wider). Out goes what is below that by twice its
    standard error; and, where the matched filter `half` is one that spreads light, what has a brightest pixel that
    exceeds by three times its noise the one which such a star has with the object's filtered signal: this tells a hot
    pixel of 9σ, whose moments do not. Saturated objects, those cut off by the border, and frames whose stars are as
    sharp as tracks, are not to be judged.

    Parameters
    ----------
    shape : array, shape (5,)
        Of `measure_shapes`.
    limit, share : float
        From `sharpest_star` and `sharpest_share`.
    x, y : int
        Brightest pixel.
    """
    if shape[0] + SHARP_ERRORS * shape[2] < limit:
        return True
    if half[1] == 0.0:
        return False
    signal = np.float32(image[y, x]) - level[y, x]
    return bool(signal > share * filtered_at(image, level, half, x, y) + PEAK_ERRORS * noise[y, x])


@kernel
def sharpest_share(limit: float, half: FloatImage) -> float:
    """`peak_share` of a star whose variance, pixel included, is `limit`."""
    return float(peak_share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), half))


@kernel
def peak_share(star_sigma_px: float, half: FloatImage) -> float:
    """Brightest pixel of a star on a pixel's centre, as a share of its signal after the filter `half`."""
    before = math.erf(0.5 / (math.sqrt(2.0) * star_sigma_px))
    middle, along = before, before * half[0]
    for k in range(1, len(half)):
        edge = math.erf((k + 0.5) / (math.sqrt(2.0) * star_sigma_px))
        along += (edge - before) * half[k]
        before = edge
    return float((middle / along) ** 2)
