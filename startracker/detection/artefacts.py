"""Artefacts: defective pixels, hot pixels and particle tracks, recognised by being sharper than any star image."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
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

FloatImage = NDArray[np.float32]
Flags = NDArray[np.bool_]

_SAMPLES = 1024
_POWERS = 256
"""Number of powers of two on either side of 1 that are counted; float32 has no more."""


def mask_extremes(pixels: Image, lowest: float, highest: float) -> tuple[Image, int]:
    """Mask the values of a frame that no light can produce.

    A frame is searched only if its values extend beyond 1e5 times its noise from the median. Distances from the median
    are then sorted into powers of two; values above the first gap of a factor of 128 or more are not light, because the
    image of a star falls off gradually from pixel to pixel. `lowest` and `highest` are the extremes of the frame, DN.
    Returns the frame, a copy with NaN if anything was masked, and the number of masked pixels.
    """
    if pixels.dtype.kind == "u":
        return pixels, 0
    # An odd stride does not stay in one column of a frame whose width is a power of two.
    sample = pixels.reshape(-1)[:: max(1, pixels.size // _SAMPLES) | 1]
    ordered = np.sort(sample[np.isfinite(sample)])
    if not len(ordered):
        return pixels, 0
    # The 16 % and 84 % quantiles lie one standard deviation from the median of a Gaussian; the smaller of the two
    # distances is used, because stars or defects widen the other.
    low, middle, high = (float(ordered[int(share * len(ordered))]) for share in (0.158655, 0.5, 0.841345))
    limit = HIGHEST_SIGMA * min(high - middle, middle - low)
    if not max(highest - middle, middle - lowest) > limit:
        return pixels, 0
    most = _last_light(pixels, middle, limit)
    if most == np.inf:
        return pixels, 0
    bad = np.abs(pixels.astype(np.float64) - middle) > most
    return np.where(bad, np.float32(np.nan), pixels), int(np.count_nonzero(bad))


@kernel
def _last_light(image: FloatImage, middle: float, limit: float) -> float:
    """Upper bound, a power of two, of the distances from `middle` below the first gap beyond `limit`, DN.

    Distances are counted by powers of two; a gap is at least `GAP_POWERS` empty ones. Infinite if there is no gap.
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
    """Mask the hot pixels of a frame in which most objects are hot pixels.

    A hot pixel is 5σ above the background and at most two of its neighbours, which may be hot themselves, have more
    than 0.15 of its signal. Returns the frame, a float32 copy with NaN if anything was masked, and the number of masked
    pixels.
    """
    bad, alone, peaks = _impulses(pixels, background.level_plane, background.noise_plane)
    # A pixel has eight neighbours: if a fraction f of all pixels is hot at random, (1 − f)⁸ of the hot ones stand
    # alone.
    at_random = (1.0 - np.count_nonzero(bad) / bad.size) ** 8
    if not alone or alone < min(MOSTLY_ALONE, ALONE_OF_RANDOM * at_random) * peaks:
        return pixels, 0
    count = int(np.count_nonzero(bad))
    return np.where(bad, np.float32(np.nan), pixels.astype(np.float32, copy=False)), count


@kernel
def _impulses(image: Image, level: Plane, noise: Plane) -> tuple[Flags, int, int]:
    """Mask of hot pixels, how many of them stand alone, and how many bright pixels are hot or local maxima."""
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
            hot = above <= 3  # the pixel itself and two neighbours
            bad[y, x] = hot
            alone += int(above == 1)
            peaks += int(hot or higher == 0)
    return bad, alone, peaks


def fill_gaps(pixels: Image) -> Image:
    """Fill the pixels that are not finite from their neighbours, where these are finite.

    With all eight neighbours the value is (2 Σ adjacent − Σ diagonal) / 4, which is exact for any a(x) + b(y) + c x y;
    with fewer, it is the mean of the adjacent ones, or else of the diagonal ones. Used for detection only: centroids
    leave such pixels out.
    """
    if pixels.dtype.kind == "u" or np.isfinite(pixels.sum(dtype=np.float64)):
        return pixels
    return np.asarray(_filled(pixels))


@kernel
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
            # With 2 Σ adjacent − Σ diagonal the result is exact for a(x) + b(y) + c x y; a plain mean flattens a peak.
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
    """Variance that the largest number of values share, within a factor of 1.3 either way; NaN if there are none.

    Cosmic rays scatter over all widths while stars agree, so this finds the stars' width even where cosmic rays
    outnumber stars and a median fails. Of two groups of equal size the wider one is chosen.
    """
    values = np.sort(variance[(variance > 0.0) & (variance < np.inf)])
    if not len(values):
        return math.nan
    first = values.searchsorted(values / COMMON_WIDTH_RATIO, "left")
    last = values.searchsorted(values * COMMON_WIDTH_RATIO, "right") - 1
    # Reversed, so that argmax, which returns the first of equal counts, finds the widest group.
    widest = len(values) - 1 - (last - first)[::-1].argmax()
    middle = first[widest] + last[widest]
    return float(0.5 * (values[middle // 2] + values[(middle + 1) // 2]))


def sharpest_star(pixels: IntArray, judged: Flags, searched: Searched, ahead: int) -> Sharpness:
    """Sharpest star image of the frame: the least variance along the minor axis that a star can have.

    The stars' common variance is taken from the first forty clear sources among the eighty brightest of `judged` (N,),
    or from those that are not hot pixels where nearly all are. `pixels` (N, 2) holds the brightest pixel of each
    source, x and y. The first `ahead` sources are measured in any case.
    """
    candidates = judged.nonzero()[0]
    brightest, rest = candidates[: 2 * _WIDTH_STARS], candidates[2 * _WIDTH_STARS :]
    first = np.zeros(len(pixels), np.bool_)
    first[:ahead] = first[brightest] = True
    shapes, width = np.full((len(pixels), SHAPE_COLUMNS), np.nan), math.nan
    examined, weight_px = first.nonzero()[0], _WEIGHT_PX
    # The weight must be wider than the stars, or their variance cannot be recovered from the weighted moments: it is
    # widened until it is, and then all shapes are measured again.
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
        # The least variance of a star includes that of the pixel, 1/12 px²; the profile needs the star's own.
        share = peak_share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), searched.half)
    return Sharpness(limit, share, weight_px, shapes)


def _width_beside_pixels(shapes: FloatArray, width: float) -> float:
    """Variance that stars share where they are few among hot pixels; otherwise `width`.

    Stars sharper than a pixel are not mistaken for hot pixels: wherever such a star falls off the middle of its pixel,
    its neighbours receive light too. So if nearly all sharp sources are single pixels, and at least three others are
    not sharp, the others are the stars.
    """
    clear = shapes[shapes[:, SHAPE_SNR] > WIDTH_SNR]
    is_wide = clear[:, MINOR] > SHARPEST_STARS_PX2
    wide, sharp = clear[is_wide, MINOR], clear[~is_wide]
    alone = np.count_nonzero(sharp[:, PEAK_SHARE] > HOT_PEAK_SHARE)
    if len(sharp) >= MANY_SHARP and alone >= HOT_SHARE * len(sharp) and len(wide) >= FEWEST_WIDE:
        width = common_width(wide)
    return width


def measure_more(sharpness: Sharpness, which: IntArray, pixels: IntArray, searched: Searched) -> None:
    """Measure those sources of `which` that are not measured yet, and enter their shapes into the table."""
    new = which[np.isnan(sharpness.shapes[which, MINOR])]
    if len(new):
        sharpness.shapes[new] = shapes_at(*searched[:3], pixels[new], sharpness.weight_px)


@kernel_part
def is_sharp(searched: Searched, sharpness: Sharpness, source: int, x: int, y: int) -> bool:
    """Whether a source with its brightest pixel at x, y is sharper than the star images of its frame.

    The optics spread all light in the same way, while charge generated in the detector stays in its pixels. The test
    uses the variance along the minor axis: a track is long in one direction at most, and smear does not widen a star
    across it. The sharpest star allowed has 0.45 of the variance that the frame's stars share, and at most 0.4 px² (the
    PSF of a poor lens varies more than twofold over its field, but a track is never wider).

    A source is sharp if its variance is below that limit by twice its standard error. It is also sharp, where the
    matched filter spreads light, if its brightest pixel exceeds that of the sharpest star of the same filtered signal
    by three times its noise: this finds a hot pixel of 9σ, whose moments are too noisy. Saturated sources, sources cut
    off by the border, and frames whose stars are as sharp as tracks are not tested.
    """
    shapes = sharpness.shapes
    if shapes[source, MINOR] + SHARP_ERRORS * shapes[source, MINOR_ERROR] < sharpness.limit_px2:
        return True
    if not sharpness.peak_share < np.inf:
        return False
    filtered, signal = filtered_pixel(searched.image, searched.level, searched.half, x, y)
    return bool(signal > sharpness.peak_share * filtered + PEAK_ERRORS * np.float64(searched.noise[y, x]))


def peak_share(star_sigma_px: float, half: FloatImage) -> float:
    """Brightest pixel of a star centred on a pixel, as a share of its signal after the filter `half`."""
    # erf((k + ½) / √2 σ) is the light between −(k + ½) and k + ½, so that the difference of two successive values is
    # the light of the pixels k and −k together. Both axes are the same, hence the square.
    edges = [math.erf((k + 0.5) / (math.sqrt(2.0) * star_sigma_px)) for k in range(len(half))]
    along, before = 0.0, 0.0
    for edge, weight in zip(edges, half.tolist(), strict=True):
        along += (edge - before) * weight
        before = edge
    return (edges[0] / along) ** 2
