"""Defective pixels of a single frame: values that no light gives, hot pixels by the thousand, gaps to be bridged."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.detection.background import Background
from startracker.detection.plane import Plane
from startracker.detection.spots import Spots
from startracker.detection.thresholds import (
    ALONE_OF_RANDOM,
    CROWDED,
    GAP_POWERS,
    HIGHEST_SIGMA,
    HOT_TIMES,
    IMPULSE_SHARE,
    IMPULSE_SIGMA,
    MOSTLY_ALONE,
)
from startracker.detection.values import Image, is_value

FloatImage = NDArray[np.float32]
Flags = NDArray[np.bool_]

_SAMPLES = 1024
_POWERS = 256
"""Of two, of float32's values on either side of 1."""


def mask_extremes(pixels: Image, lowest: float, highest: float) -> tuple[Image, int]:
    """A frame of such a range with NaN for the values that no light gives, and how many they are.

    Looked for only in a frame whose values extend beyond 1e5 times its noise from the median. Beyond that, what lies
    above the first gap of a factor of 128 or more in the distances from the median is no light, as the image of a star
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


@kernel
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


@kernel
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
            if near == 4 and far == 4:
                out[y, x] = 0.5 * beside - 0.25 * diagonal
            elif near > 0:
                out[y, x] = beside / near
            elif far > 0:
                out[y, x] = diagonal / far
    return out
