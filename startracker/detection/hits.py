"""Kernels that tell charge that arose in the detector, hot pixels and particles' tracks, from light: by sharpness."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.plane import Plane
from startracker.detection.scan import filtered_at
from startracker.detection.shapes import measure_shapes
from startracker.detection.spots import EDGE, PIXELS, X_PEAK, Y_PEAK
from startracker.detection.values import Image

__all__ = ["common_width", "is_hit", "peak_share"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
Flags = NDArray[np.bool_]

_PIXEL_VARIANCE = 1.0 / 12.0
_WEIGHT_PX = 1.2
_WIDTH_STARS = 40
_WIDTH_SNR = 8.0
_WIDTH_RATIO = 1.3
_SHARP_SHARE = 0.45
_SHARPEST_STAR_PX2 = 0.3
"""Star images of less variance, pixel included (σ < 0.47 px), are as sharp as a particle's track, which has 0.03 to
0.25: then sharpness tells nothing."""
_TRACK_PX2 = 0.4
_SHARP_ERRORS = 2.0
_PEAK_ERRORS = 3.0
_ONE_PIXEL = 0.6
_ALONE, _ALONE_SHARE, _MANY_SHARP, _FEWEST_STARS = 0.75, 0.8, 5, 3


@njit(cache=True, error_model="numpy")
def common_width(variance: FloatArray) -> float:
    """The variance that most values share, to a factor 1.3 either way; NaN for none.

    Hits scatter over all widths, stars agree: so the stars are found among more hits than stars, where a median is
    not. Of equal numbers the wider counts.
    """
    values = np.sort(variance[np.isfinite(variance) & (variance > 0.0)])
    count = len(values)
    if count == 0:
        return np.nan
    most, centre = 0, 0.0
    for k in range(count):
        near = 0
        for other in range(count):
            near += values[k] / _WIDTH_RATIO <= values[other] <= values[k] * _WIDTH_RATIO
        if near >= most:
            most, centre = near, values[k]
    first, last = 0, count - 1
    while values[first] < centre / _WIDTH_RATIO:
        first += 1
    while values[last] > centre * _WIDTH_RATIO:
        last -= 1
    return float(0.5 * (values[(first + last) // 2] + values[(first + last + 1) // 2]))


@njit(cache=True, error_model="numpy")
def is_hit(
    table: FloatArray, saturated: Flags, image: Image, level: Plane, noise: Plane, half: FloatImage
) -> tuple[Flags, Flags]:
    """Objects sharper than the star images of their frame, and which of them are single pixels.

    The optics spread all light alike; charge that arises in the detector stays in its pixels. Judged is the variance
    along the minor axis: a track is long at most in one direction, and smear widens no star in that one. The sharpest
    star allowed has 0.45 of the variance that the frame's stars share, and at most 0.4 px² (the PSF of a poor lens
    varies more than twice over its field, but a track is never wider). Out goes what is below that by twice its
    standard error; and, where the matched filter `half` is one that spreads light, what has a brightest pixel that
    exceeds by three times its noise the one which such a star has with the object's filtered signal: this tells a hot
    pixel of 9σ, whose moments do not. Saturated objects, those cut off by the border, and frames whose stars are as
    sharp as tracks, are not judged.
    """
    count = len(table)
    x, y = table[:, X_PEAK].astype(np.int64), table[:, Y_PEAK].astype(np.int64)
    hit, one_pixel = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    judged = ~saturated & (table[:, EDGE] == 0.0)
    weight, width = _WEIGHT_PX, np.nan
    shapes = measure_shapes(image, level, noise, x, y, weight)
    for _ in range(2):
        width = _width_of_stars(judged & (table[:, PIXELS] >= 3.0), shapes)
        if not width > weight**2:
            break
        weight = 1.2 * math.sqrt(width)
        shapes = measure_shapes(image, level, noise, x, y, weight)
    if not width > _SHARPEST_STAR_PX2:
        return hit, one_pixel
    limit = min(_SHARP_SHARE * width, _TRACK_PX2)
    filtering = half[1] != 0.0
    share = peak_share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), half)
    filtered = filtered_at(image, level, half, x, y) if filtering else np.zeros(count, np.float32)
    for n in range(count):
        if not judged[n]:
            continue
        hit[n] = shapes[n, 0] + _SHARP_ERRORS * shapes[n, 2] < limit
        if filtering:
            signal = np.float32(image[y[n], x[n]]) - level[y[n], x[n]]
            hit[n] |= signal > share * filtered[n] + _PEAK_ERRORS * noise[y[n], x[n]]
        one_pixel[n] = shapes[n, 3] > _ONE_PIXEL
    return hit, one_pixel


@njit(cache=True, error_model="numpy")
def _width_of_stars(judged: Flags, shapes: FloatArray) -> float:
    """The variance that the brightest well measured objects share; NaN for none.

    Where stars are few, hot pixels are most of what is found, and agree. Stars sharper than a pixel are not taken for
    them: wherever such a star falls off the middle of its pixel, its neighbours have light too. So where nearly all
    that is sharp is nothing but one pixel, and three others are not sharp, these are the stars.
    """
    clean = np.empty(_WIDTH_STARS)
    used = 0
    for n in np.flatnonzero(judged)[: 2 * _WIDTH_STARS]:
        if used < _WIDTH_STARS and shapes[n, 4] > _WIDTH_SNR:
            clean[used] = shapes[n, 0]
            used += 1
    width: float = common_width(clean[:used])
    if width > _SHARPEST_STAR_PX2:
        return width
    clear = shapes[judged & (shapes[:, 4] > _WIDTH_SNR)]
    wide = clear[:, 0] > _SHARPEST_STAR_PX2
    sharp = len(clear) - np.sum(wide)
    alone = np.sum(clear[~wide, 3] > _ALONE)
    if sharp >= _MANY_SHARP and alone >= _ALONE_SHARE * sharp and np.sum(wide) >= _FEWEST_STARS:
        width = common_width(clear[wide, 0])
    return width


@njit(cache=True, error_model="numpy")
def peak_share(star_sigma_px: float, half: FloatImage) -> float:
    """Brightest pixel of a star on a pixel's centre, as a share of its signal after the filter `half`."""
    before = math.erf(0.5 / (math.sqrt(2.0) * star_sigma_px))
    middle, along = before, before * half[0]
    for k in range(1, len(half)):
        edge = math.erf((k + 0.5) / (math.sqrt(2.0) * star_sigma_px))
        along += (edge - before) * half[k]
        before = edge
    return float((middle / along) ** 2)
