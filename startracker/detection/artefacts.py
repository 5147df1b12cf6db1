"""What is not light: defective pixels, hot pixels and tracks of particles, known by their sharpness."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray, IntArray
from startracker.detection.background import Background
from startracker.detection.matched import filtered_pixel
from startracker.detection.shapes import (
    MINOR,
    MINOR_ERROR,
    PEAK_SHARE,
    SHAPE_COLUMNS,
    SHAPE_SNR,
    shapes_at,
)
from startracker.detection.sources import Searched
from startracker.detection.spots import Spots
from startracker.detection.thresholds import (
    ALONE_OF_RANDOM,
    COMMON_WIDTH_RATIO,
    CROWDED,
    FEWEST_WIDE,
    GAP_POWERS,
    HIGHEST_SIGMA,
    HOT_PEAK_SHARE,
    HOT_SHARE,
    HOT_TIMES,
    IMPULSE_SHARE,
    IMPULSE_SIGMA,
    MANY_SHARP,
    MOSTLY_ALONE,
    PEAK_ERRORS,
    SHARP_ERRORS,
    SHARP_SHARE,
    SHARPEST_STARS_PX2,
    WIDEST_TRACK_PX2,
    WIDTH_SNR,
)
from startracker.detection.tiles import Plane
from startracker.detection.values import Image, is_value
from startracker.kernels import kernel_part, pixel_kernel

FloatImage = NDArray[np.float32]
Flags = NDArray[np.bool_]

_SAMPLES = 1024
_POWERS = 256
"""Of two, of float32's values on either side of 1."""


def mask_extremes(pixels: Image, lowest: float, highest: float) -> tuple[Image, int]:
    """A frame of such a range with NaN for the values that no light gives, and how many they are.

    Looked for only in a frame whose values extend beyond 1e5 times its noise from the median. Beyond that, what lies
    above the first gap of a factor of 128 or more in the distances from the median is not light, as the image of a star
    falls off gradually from pixel to pixel. The frame given stays as it is.
    """
    if pixels.dtype.kind == "u":
        return pixels, 0
    sample = pixels.reshape(-1)[:: max(1, pixels.size // _SAMPLES) | 1]
    ordered = np.sort(sample[np.isfinite(sample)])
    if not len(ordered):
        return pixels, 0
    low, middle, high = (float(ordered[int(share * len(ordered))]) for share in (0.158655, 0.5, 0.841345))
    limit = HIGHEST_SIGMA * min(high - middle, middle - low)
    if not max(highest - middle, middle - lowest) > limit:
        return pixels, 0
    most = _last_light(pixels, middle, limit)
    if most == np.inf:
        return pixels, 0
    bad = np.abs(pixels.astype(np.float64) - middle) > most
    return np.where(bad, np.float32(np.nan), pixels), int(np.count_nonzero(bad))


@pixel_kernel
def _last_light(image: FloatImage, middle: float, limit: float) -> float:
    """Upper end of the values before the first gap beyond a limit, as distances from the middle; infinite for none.

    Distances are counted by their powers of two, of which `GAP_POWERS` must be empty.
    """
    seen = np.zeros(2 * _POWERS, np.bool_)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            distance = abs(np.float64(image[y, x]) - middle)
            if 0.0 < distance < np.inf:
                seen[min(max(math.frexp(distance)[1] + _POWERS, 0), 2 * _POWERS - 1)] = True
    last, first = -1, math.frexp(limit)[1] + _POWERS if limit > 0.0 else 0
    for power in range(2 * _POWERS):
        if not seen[power]:
            continue
        if last >= 0 and power > first and power - max(last, first) > GAP_POWERS:
            return math.ldexp(1.0, max(last, first) - _POWERS)
        last = power
    return np.inf


def has_crowd(spots: Spots, pixels: int) -> bool:
    """Whether a frame has more objects than stars would give, or far more hot pixels than stars."""
    objects = len(spots) + sum(spots.rejected.values())
    return objects > CROWDED * pixels or spots.rejected.get("hot pixel", 0) > HOT_TIMES * max(len(spots), 1)


def mask_impulses(pixels: Image, background: Background) -> tuple[Image, int]:
    """A frame with NaN for its hot pixels, and how many they are; the frame as it is where they are not most objects.

    A hot pixel stands 5σ above the background and has at most two neighbours with more than 0.15 of its signal, which
    may be hot themselves.
    """
    bad, alone, peaks = _impulses(pixels, background.level_plane, background.noise_plane)
    at_random = (1.0 - np.count_nonzero(bad) / bad.size) ** 8
    if not alone or alone < min(MOSTLY_ALONE, ALONE_OF_RANDOM * at_random) * peaks:
        return pixels, 0
    count = int(np.count_nonzero(bad))
    return np.where(bad, np.float32(np.nan), pixels.astype(np.float32, copy=False)), count


@pixel_kernel
def _impulses(image: Image, level: Plane, noise: Plane) -> tuple[Flags, int, int]:
    """Hot pixels, how many have no bright neighbour, and how many bright pixels are hot or the highest of nine."""
    height, width = image.shape
    bad: Flags = np.zeros((height, width), np.bool_)
    alone, peaks = 0, 0
    for y in range(height):
        for x in range(width):
            sky = level[y, x]
            signal = np.float32(image[y, x]) - sky
            if not (signal > np.float32(IMPULSE_SIGMA) * noise[y, x] and is_value(image[y, x])):
                continue
            limit, higher, above = np.float32(IMPULSE_SHARE) * signal + sky, 0, 0
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    above += int(np.float32(image[j, i]) > limit)
                    higher += int(image[j, i] > image[y, x])
            hot = above <= 3  # itself and two more
            bad[y, x] = hot
            alone += int(above == 1)
            peaks += int(hot or higher == 0)
    return bad, alone, peaks


def fill_gaps(pixels: Image) -> Image:
    """A frame whose pixels that are not finite are bridged from their neighbours, as far as they have some.

    From all eight it is (2 Σ beside − Σ diagonal) / 4, exact for any a(x) + b(y) + c x y; with
    fewer, the mean of those beside, or of the diagonal ones. For detection only: a centroid leaves such pixels out.
    """
    if pixels.dtype.kind == "u" or np.isfinite(pixels.sum(dtype=np.float64)):
        return pixels
    return np.asarray(_filled(pixels))


@pixel_kernel
def _filled(image: FloatImage) -> FloatImage:
    height, width = image.shape
    out = image.copy()
    for y in range(height):
        for x in range(width):
            if is_value(image[y, x]):
                continue
            beside, diagonal, near, far = 0.0, 0.0, 0, 0
            for j in range(max(y - 1, 0), min(y + 2, height)):
                for i in range(max(x - 1, 0), min(x + 2, width)):
                    if is_value(image[j, i]):
                        if j == y or i == x:
                            beside, near = beside + image[j, i], near + 1
                        else:
                            diagonal, far = diagonal + image[j, i], far + 1
            if near == 4 and far == 4:
                out[y, x] = 0.5 * beside - 0.25 * diagonal
            elif near > 0:
                out[y, x] = beside / near
            elif far > 0:
                out[y, x] = diagonal / far
    return out


_PIXEL_VARIANCE = 1.0 / 12.0
_WEIGHT_PX = 1.2
_WEIGHTS = 3
_WIDTH_STARS = 40


class Sharpness(NamedTuple):
    """The sharpest star image that a frame can have."""

    limit_px2: float
    """Its variance along the minor axis; 0 where stars are as sharp as tracks, and sharpness cannot decide."""
    peak_share: float
    """Its brightest pixel as a share of its filtered signal; infinite where the filter spreads no light."""
    weight_px: float
    """Standard deviation of the weight under which shapes are measured."""
    shapes: FloatArray
    """Shapes (N, 5) of the sources measured under it so far; NaN for the others."""


def common_width(variance: FloatArray) -> float:
    """The variance that most values share, to a factor 1.3 either way; NaN for none.

    Cosmic rays scatter over all widths, stars agree: so stars are found among more cosmic rays than stars, where a
    median fails. Of equal numbers the wider counts.
    """
    values = np.sort(variance[(variance > 0.0) & (variance < np.inf)])
    if not len(values):
        return math.nan
    first = values.searchsorted(values / COMMON_WIDTH_RATIO, "left")
    last = values.searchsorted(values * COMMON_WIDTH_RATIO, "right") - 1
    widest = len(values) - 1 - (last - first)[::-1].argmax()
    middle = first[widest] + last[widest]
    return float(0.5 * (values[middle // 2] + values[(middle + 1) // 2]))


def sharpest_star(pixels: IntArray, judged: Flags, searched: Searched, ahead: int) -> Sharpness:
    """Least variance along the minor axis that a star image of the frame can have.

    The stars' common variance is that of the first forty clear ones among the eighty brightest sources that are
    `judged`, or of what is not a hot pixel where hot pixels are nearly all. `pixels` (N, 2) are the sources' brightest,
    x and y. The first sources, `ahead` of them, are measured in any case.
    """
    candidates = judged.nonzero()[0]
    brightest, rest = candidates[: 2 * _WIDTH_STARS], candidates[2 * _WIDTH_STARS :]
    first = np.zeros(len(pixels), np.bool_)
    first[:ahead] = first[brightest] = True
    shapes, width = np.full((len(pixels), SHAPE_COLUMNS), np.nan), math.nan
    examined, weight_px = first.nonzero()[0], _WEIGHT_PX
    for attempt in range(_WEIGHTS):
        shapes[examined] = shapes_at(*searched[:3], pixels[examined], weight_px)
        if attempt == _WEIGHTS - 1:
            break
        clear = shapes[brightest]
        width = common_width(clear[clear[:, SHAPE_SNR] > WIDTH_SNR, MINOR][:_WIDTH_STARS])
        if not width > SHARPEST_STARS_PX2:
            if len(rest):
                shapes[rest] = shapes_at(*searched[:3], pixels[rest], weight_px)
                examined, rest = (first | judged).nonzero()[0], rest[:0]
            width = _width_beside_pixels(shapes[candidates], width)
        if not width > weight_px**2:
            break
        weight_px = 1.2 * math.sqrt(width)
    limit = min(SHARP_SHARE * width, WIDEST_TRACK_PX2) if width > SHARPEST_STARS_PX2 else 0.0
    share = math.inf
    if limit > 0.0 and searched.half[1] != 0.0:
        share = peak_share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), searched.half)
    return Sharpness(limit, share, weight_px, shapes)


def _width_beside_pixels(shapes: FloatArray, width: float) -> float:
    """The variance that stars share where they are few among hot pixels; else `width`.

    Stars sharper than a pixel are not taken for hot pixels: wherever such a star falls off the middle of its pixel, its
    neighbours have light too. So where nearly all that is sharp is nothing but one pixel, and three others are not
    sharp, these are the stars.
    """
    clear = shapes[shapes[:, SHAPE_SNR] > WIDTH_SNR]
    is_wide = clear[:, MINOR] > SHARPEST_STARS_PX2
    wide, sharp = clear[is_wide, MINOR], clear[~is_wide]
    alone = np.count_nonzero(sharp[:, PEAK_SHARE] > HOT_PEAK_SHARE)
    if len(sharp) >= MANY_SHARP and alone >= HOT_SHARE * len(sharp) and len(wide) >= FEWEST_WIDE:
        width = common_width(wide)
    return width


def measure_more(sharpness: Sharpness, which: IntArray, pixels: IntArray, searched: Searched) -> None:
    """Shapes of those of some sources that are not measured yet, into the table of them."""
    new = which[np.isnan(sharpness.shapes[which, MINOR])]
    if len(new):
        sharpness.shapes[new] = shapes_at(*searched[:3], pixels[new], sharpness.weight_px)


@kernel_part
def is_sharp(searched: Searched, sharpness: Sharpness, source: int, x: int, y: int) -> bool:
    """Whether a source with its brightest pixel at x, y is sharper than the star images of its frame.

    The optics spread all light alike; charge that arises in the detector stays in its pixels. Judged is the variance
    along the minor axis: a track is long at most in one direction, and smear widens no star in that one. The sharpest
    star allowed has 0.45 of the variance that the frame's stars share, and at most 0.4 px² (the PSF of a poor lens
    varies more than twice over its field, but a track is never wider). A source is sharp if it is below that by twice
    its standard error; or, where the matched filter spreads light, if its brightest pixel exceeds by three times its
    noise that of such a star with the source's filtered signal: this finds a hot pixel of 9σ, whose moments do not show
    it. Saturated sources, those cut off by the border, and frames whose stars are as sharp as tracks, are not judged.
    """
    shapes = sharpness.shapes
    if shapes[source, MINOR] + SHARP_ERRORS * shapes[source, MINOR_ERROR] < sharpness.limit_px2:
        return True
    if not sharpness.peak_share < np.inf:
        return False
    filtered, signal = filtered_pixel(searched.image, searched.level, searched.half, x, y)
    return bool(signal > sharpness.peak_share * filtered + PEAK_ERRORS * np.float64(searched.noise[y, x]))


def peak_share(star_sigma_px: float, half: FloatImage) -> float:
    """Brightest pixel of a star on a pixel's centre, as a share of its signal after the filter `half`."""
    edges = [math.erf((k + 0.5) / (math.sqrt(2.0) * star_sigma_px)) for k in range(len(half))]
    along, before = 0.0, 0.0
    for edge, weight in zip(edges, half.tolist(), strict=True):
        along += (edge - before) * weight
        before = edge
    return (edges[0] / along) ** 2
