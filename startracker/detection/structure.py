"""Background of frames with strong smooth structure (aurora, stray light, nebulae), which tiles are too coarse for."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.detection.background import Background, noise_floor
from startracker.detection.plane import Plane
from startracker.detection.thresholds import STRUCTURE_NOISE_TIMES
from startracker.detection.tiles import interpolate_tiles, smooth_tiles, tile_statistics
from startracker.detection.values import Image, is_value
from startracker.kernels import pixel_kernel

FloatImage = NDArray[np.float32]

_LAG_PX = 5
"""Distance of the pixels whose difference measures the noise: beyond a star image and correlation in photographs."""
_ROWS, _COLUMNS = 16, 64
"""Where differences are taken: along few rows, as every row of an image must be fetched again."""
_SPREAD = 0.67449 * math.sqrt(1.5)
"""Median of the absolute value of such a difference, for noise of 1."""
_BIN_PX = 4
_REACH_BINS = 2
"""The background is a median of 5 × 5 bins: 20 px, of which a star takes 4 bins of 25, a long trail 5 to 10."""


def has_structure(image: Image, background: Background) -> bool:
    """Whether the background's noise is more than 1.5 times the noise of the pixels.

    The latter is measured by differences of a pixel to the mean of two at 5 px on either side, along x or y, whichever
    are larger, in units of the background's noise: slopes do not count in them.
    """
    if min(image.shape) <= 2 * _LAG_PX:
        return False
    return bool(_is_quiet(image, background.noise_plane))


@pixel_kernel
def _is_quiet(image: Image, noise: Plane) -> bool:
    """Whether the robust standard deviation of the differences of a thousand pixels, in units of the background's
    noise, is below the limit in both directions, and not zero in one: the medians are compared by counting."""
    height, width = image.shape
    down, right = max(1, height // _ROWS), max(1, width // _COLUMNS)
    quiet, moving = True, False
    for dy, dx in ((0, _LAG_PX), (_LAG_PX, 0)):
        count = below = equal = 0
        for y in range(_LAG_PX, height - _LAG_PX, down):
            for x in range(_LAG_PX, width - _LAG_PX, right):
                beside = np.float64(image[y - dy, x - dx]) + np.float64(image[y + dy, x + dx])
                value = np.float32(abs(np.float64(image[y, x]) - 0.5 * beside) / noise[y, x])
                count += int(abs(value) < np.inf)
                below += int(value / _SPREAD * STRUCTURE_NOISE_TIMES < 1.0)
                equal += int(value <= 0.0)
        quiet &= below > count // 2 or count == 0
        moving |= equal <= count // 2 and count > 0
    return quiet and moving


def follow_structure(image: Image, tile_px: int = 64) -> Background:
    """Background that follows structure of some 20 px and more.

    Means of bins of 4 px, without the highest and the lowest pixel of each, pass a 5 × 5 median, which a slope passes
    unchanged and a star does not; the median of what is left is added once more (Tukey's twicing), so that a ridge is
    not cut off by its curvature. The noise is that of what remains, from tiles as in `estimate`.

    Parameters
    ----------
    image : array, shape (H, W)
        DN; not finite: left out.
    tile_px : int
        Side of the tiles of the noise.
    """
    height, width = image.shape
    floor = noise_floor(image)[1]
    bins = _bin_means(image, max(1, round(height / _BIN_PX)), max(1, round(width / _BIN_PX)))
    gaps = ~np.isfinite(bins)
    bins[gaps] = np.median(bins[~gaps]) if not gaps.all() else 0.0
    level = _medians(bins)
    level += _medians(bins - level)
    plane = interpolate_tiles(level, height, width, True)
    made = Background(plane, plane)
    residual = np.asarray(image, np.float32) - made.level
    rows, columns = max(1, round(height / tile_px)), max(1, round(width / tile_px))
    _, noise = tile_statistics(residual, rows, columns, 0.0)
    known = np.isfinite(noise)
    noise[~known] = np.median(noise[known]) if known.any() else 1.0
    return Background(plane, interpolate_tiles(np.maximum(smooth_tiles(noise), floor), height, width, False))


@pixel_kernel
def _bin_means(image: Image, rows: int, columns: int) -> FloatArray:
    """Mean of each of rows × columns bins without its highest and its lowest pixel; NaN of no pixel."""
    height, width = image.shape
    out = np.empty((rows, columns))
    for row in range(rows):
        y0, y1 = row * height // rows, (row + 1) * height // rows
        for column in range(columns):
            x0, x1 = column * width // columns, (column + 1) * width // columns
            total, low, high, count = 0.0, np.inf, -np.inf, 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    value = np.float64(image[y, x])
                    if is_value(image[y, x]):
                        total, low, high, count = total + value, min(low, value), max(high, value), count + 1
            if count > 2:
                total, count = total - low - high, count - 2
            out[row, column] = total / count if count > 0 else np.nan
    return out


def _medians(bins: FloatArray) -> FloatArray:
    """Medians of 5 × 5; outside, the map goes on point-symmetrically about its border, so that a slope stays one."""
    from scipy import ndimage

    reach = min(_REACH_BINS, min(bins.shape) - 1)
    padded = np.pad(bins, reach, mode="reflect", reflect_type="odd") if reach > 0 else bins
    side, (height, width) = 2 * reach + 1, bins.shape
    filtered = ndimage.median_filter(padded.astype(np.float32), side)[reach : reach + height, reach : reach + width]
    return np.asarray(filtered, dtype=np.float64)
