"""Charge that arose in the detector, hot pixels and particles' tracks, distinguished from light by its sharpness."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import FloatArray, IntArray
from startracker.detection.shapes import (
    MINOR,
    MINOR_ERROR,
    PEAK_SHARE,
    SHAPE_COLUMNS,
    SHAPE_SNR,
    Weight,
    measure_shape,
    shape_weight,
)
from startracker.detection.sources import Searched, Sources
from startracker.detection.stamps import filtered_pixel
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
from startracker.kernels import kernel, kernel_part
from startracker.sorting import sort

FloatImage = NDArray[np.float32]

Flags = NDArray[np.bool_]

_PIXEL_VARIANCE = 1.0 / 12.0
_WEIGHT_PX = 1.2
_WEIGHTS = 3
_WIDTH_STARS = 40
_SHAPE_PIXELS = 3


class Sharpness(NamedTuple):
    """The sharpest star image that a frame can have."""

    limit_px2: float
    """Its variance along the minor axis; 0 where stars are as sharp as tracks, and sharpness cannot decide."""
    peak_share: float
    """Its brightest pixel as a share of its filtered signal; infinite where the filter spreads no light."""
    weight: Weight
    """Weight under which shapes are measured."""
    shapes: FloatArray
    """Shapes (N, 5) of the sources measured under it so far; NaN for the others."""


@kernel
def common_width(variance: FloatArray) -> float:
    """The variance that most values share, to a factor 1.3 either way; NaN for none.

    Cosmic rays scatter over all widths, stars agree: so stars are found among more cosmic rays than stars, where a
    median fails. Of equal numbers the wider counts.
    """
    values, count = np.empty(len(variance)), 0
    for value in variance:
        if math.isfinite(value) and value > 0.0:
            values[count] = value
            count += 1
    values = values[:count]
    sort(values)
    most, centre = 0, math.nan
    for n in range(count):
        near = 0
        for value in values:
            near += values[n] / COMMON_WIDTH_RATIO <= value <= values[n] * COMMON_WIDTH_RATIO
        if near >= most:
            most, centre = near, values[n]
    first, last = 0, -1
    for n in range(count):
        first += values[n] < centre / COMMON_WIDTH_RATIO
        last += values[n] <= centre * COMMON_WIDTH_RATIO
    return 0.5 * (values[(first + last) // 2] + values[(first + last + 1) // 2]) if count else math.nan


@kernel_part
def sharpest_star(table: Sources, judged: Flags, searched: Searched) -> Sharpness:
    """Least variance along the minor axis that a star image of the frame can have.

    The stars' common variance is that of the first forty clear ones among the eighty brightest sources that are
    `judged`, or of what is not a hot pixel where hot pixels are nearly all.
    """
    candidates, count = np.empty(len(table), np.int64), 0
    for n in range(len(table)):
        if judged[n] and table[n]["pixels"] >= _SHAPE_PIXELS:
            candidates[count] = n
            count += 1
    candidates = candidates[:count]
    shapes, width, examined = np.full((len(table), SHAPE_COLUMNS), np.nan), math.nan, min(count, 2 * _WIDTH_STARS)
    weight_px = _WEIGHT_PX
    weight = shape_weight(weight_px)
    for attempt in range(_WEIGHTS):
        _measure(table, candidates[:examined], searched, weight, shapes)
        if attempt == _WEIGHTS - 1:
            break
        width = common_width(_clear_widths(shapes, candidates[: 2 * _WIDTH_STARS], 0.0, _WIDTH_STARS))
        if not width > SHARPEST_STARS_PX2:
            _measure(table, candidates[examined:], searched, weight, shapes)
            examined = count
            width = _width_beside_pixels(shapes, candidates, width)
        if not width > weight_px**2:
            break
        weight_px = 1.2 * math.sqrt(width)
        weight = shape_weight(weight_px)
    limit = min(SHARP_SHARE * width, WIDEST_TRACK_PX2) if width > SHARPEST_STARS_PX2 else 0.0
    share = math.inf
    if limit > 0.0 and searched.half[1] != 0.0:
        share = peak_share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), searched.half)
    return Sharpness(limit, share, weight, shapes)


@kernel_part
def _measure(table: Sources, which: IntArray, searched: Searched, weight: Weight, shapes: FloatArray) -> None:
    """Shapes of some sources, to their rows."""
    for n in which:
        x, y = table[n]["x_peak"], table[n]["y_peak"]
        measure_shape(searched.image, searched.level, searched.noise, x, y, weight, shapes[n])


@kernel_part
def _clear_widths(shapes: FloatArray, which: IntArray, above_px2: float, most: int) -> FloatArray:
    """Variances along the minor axis, above a limit, of the first sources with a sufficient signal-to-noise ratio."""
    out, count = np.empty(len(which)), 0
    for n in which:
        if count < most and shapes[n, SHAPE_SNR] > WIDTH_SNR and (above_px2 == 0.0 or shapes[n, MINOR] > above_px2):
            out[count] = shapes[n, MINOR]
            count += 1
    return out[:count]


@kernel_part
def _width_beside_pixels(shapes: FloatArray, which: IntArray, width: float) -> float:
    """The variance that stars share where they are few among hot pixels; else `width`.

    Stars sharper than a pixel are not taken for hot pixels: wherever such a star falls off the middle of its pixel, its
    neighbours have light too. So where nearly all that is sharp is nothing but one pixel, and three others are not
    sharp, these are the stars.
    """
    wide = _clear_widths(shapes, which, SHARPEST_STARS_PX2, len(which))
    sharp, alone = 0, 0
    for n in which:
        if shapes[n, SHAPE_SNR] > WIDTH_SNR and not shapes[n, MINOR] > SHARPEST_STARS_PX2:
            sharp += 1
            alone += shapes[n, PEAK_SHARE] > HOT_PEAK_SHARE
    if sharp >= MANY_SHARP and alone >= HOT_SHARE * sharp and len(wide) >= FEWEST_WIDE:
        width = common_width(wide)
    return width


@kernel_part
def is_sharp(shape: FloatArray, sharpness: Sharpness, x: int, y: int, searched: Searched) -> bool:
    """Whether a source is sharper than the star images of its frame.

    The optics spread all light alike; charge that arises in the detector stays in its pixels. Judged is the variance
    along the minor axis: a track is long at most in one direction, and smear widens no star in that one. The sharpest
    star allowed has 0.45 of the variance that the frame's stars share, and at most 0.4 px² (the PSF of a poor lens
    varies more than twice over its field, but a track is never wider). A source is sharp if it is below that by twice
    its standard error; or, where the matched filter spreads light, if its brightest pixel exceeds by three times its
    noise that of such a star with the source's filtered signal: this finds a hot pixel of 9σ, whose moments do not show
    it. Saturated sources, those cut off by the border, and frames whose stars are as sharp as tracks, are not judged.

    Parameters
    ----------
    shape : array, shape (5,)
        Of `measure_shape`.
    sharpness : Sharpness
        From `sharpest_star`.
    x, y : int
        Brightest pixel.
    """
    if shape[MINOR] + SHARP_ERRORS * shape[MINOR_ERROR] < sharpness.limit_px2:
        return True
    if sharpness.peak_share == math.inf:
        return False
    filtered, signal = filtered_pixel(searched.image, searched.level, searched.half, x, y)
    return bool(signal > sharpness.peak_share * filtered + PEAK_ERRORS * np.float64(searched.noise[y, x]))


@kernel
def peak_share(star_sigma_px: float, half: FloatImage) -> float:
    """Brightest pixel of a star on a pixel's centre, as a share of its signal after the filter `half`."""
    before = math.erf(0.5 / (math.sqrt(2.0) * star_sigma_px))
    middle, along = before, before * half[0]
    for k in range(1, len(half)):
        edge = math.erf((k + 0.5) / (math.sqrt(2.0) * star_sigma_px))
        along += (edge - before) * half[k]
        before = edge
    share: float = (middle / along) ** 2
    return share
