"""Local background of an image, its noise, and a background that follows strong, smooth structure."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker._compiled import kernel
from startracker.core import BoolArray, FloatArray
from startracker.detection.thresholds import STRUCTURE_NOISE_TIMES
from startracker.detection.tiles import (
    Plane,
    as_plane,
    fill_plane,
    interpolate_tiles,
    smooth_tiles,
    tile_statistics,
    whole_step,
)
from startracker.detection.values import Image, as_image, as_pixels, is_value
from startracker.errors import InputError

__all__ = ["Background", "as_image", "estimate", "noise_floor"]

FloatImage = NDArray[np.float32]

_SMALLEST_TILE_PX = 8
_STEP_SAMPLES = 4096
_ON_LATTICE = 0.01
_NOISE_FREE = 1e-5
"""Noise assigned to an image that has none, as a share of its range: small enough that a bright star stays small."""


class Background:
    """Background of an image.

    Parameters
    ----------
    level : float32 array, shape (H, W), or Plane
        Local background, DN.
    noise : float32 array, shape (H, W), or Plane
        Local standard deviation of one pixel, DN; never zero.

    Attributes
    ----------
    level_plane, noise_plane : Plane
        The same maps for kernels, which read only a few pixels; the full arrays are computed on first access.
    """

    def __init__(self, level: FloatImage | Plane, noise: FloatImage | Plane) -> None:
        self.level_plane = level if isinstance(level, Plane) else as_plane(level)
        self.noise_plane = noise if isinstance(noise, Plane) else as_plane(noise)
        # A given array is the value of its cached property, which is then never computed.
        if not isinstance(level, Plane):
            self.level = level
        if not isinstance(noise, Plane):
            self.noise = noise

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return len(self.level_plane.cell), self.level_plane.lines.shape[1]

    @cached_property
    def level(self) -> FloatImage:
        """Local background, DN, shape (H, W)."""
        return np.asarray(fill_plane(self.level_plane))

    @cached_property
    def noise(self) -> FloatImage:
        """Local standard deviation of one pixel, DN, shape (H, W)."""
        return np.asarray(fill_plane(self.noise_plane))


def estimate(image: ArrayLike, tile_px: int = 64) -> Background:
    """Background level and noise of an image.

    The image is cut into tiles of about `tile_px`. Some 400 pixels of each tile, spread over all its rows, give a
    median and the 84 % quantile, then a mean and a standard deviation, clipped three times at 3σ about the median; the
    standard deviation is corrected for the clipping. The tiles pass a 3 × 3 median, which removes a bright star or the
    Moon, and are interpolated bilinearly between their centres; the level is extrapolated linearly to the borders. The
    procedure follows Bertin & Arnouts 1996 (SExtractor, section 4).

    The noise is never below the rounding error of the image's own digitisation, step/√12, nor, in an image without a
    step, below 1e-5 of its range: an image without noise (a rendered frame, the black of an 8-bit photograph) still
    gets a threshold that only its stars exceed.

    Parameters
    ----------
    image : array_like, shape (H, W)
        DN, any real type. Values that are not finite are left out.
    tile_px : int
        Side of a tile, at least 8. A tile should be far larger than a star.

    Returns
    -------
    Background
        Level 0 and noise 1 when no pixel is finite.

    Raises
    ------
    InputError
        Not a two-dimensional numeric image; tile too small.
    """
    if tile_px < _SMALLEST_TILE_PX:
        raise InputError(f"detection.background_tile_px is {tile_px}; it must be at least {_SMALLEST_TILE_PX} pixels")
    pixels = as_pixels(image)
    height, width = pixels.shape
    if pixels.size == 0:
        return Background(np.zeros(pixels.shape, np.float32), np.ones(pixels.shape, np.float32))
    step, floor = noise_floor(pixels)
    rows, columns = max(1, round(height / tile_px)), max(1, round(width / tile_px))
    statistics = tile_statistics(pixels, rows, columns, step)
    level, noise = statistics
    valid = np.isfinite(level)
    if not valid.any():
        return Background(np.zeros(pixels.shape, np.float32), np.ones(pixels.shape, np.float32))
    # A tile without finite pixels (a masked region, a border of NaN) gets the median of the others.
    if not valid.all():
        level[~valid], noise[~valid] = np.median(level[valid]), np.median(noise[valid])
    level, noise = smooth_tiles(statistics)
    return Background(
        interpolate_tiles(level, height, width, True),
        interpolate_tiles(np.maximum(noise, floor), height, width, False),
    )


def noise_floor(image: Image) -> tuple[float, float]:
    """Digitisation step of an image and the least noise it can have, DN.

    The step is the greatest common divisor of the differences of integer values (16 for a 12-bit image stretched to 16
    bits); for other values on a lattice (means of colour channels) it is their smallest gap; for values that repeat
    without lying on a lattice it is their median gap; otherwise it is 0. The floor is step/√12, the standard deviation
    of rounding, and at least 1e-5 of the range if the values are not integers.
    """
    flat = image.reshape(-1)
    sample: NDArray[Any] = flat[:: max(1, flat.size // _STEP_SAMPLES)]
    divisor = whole_step(sample)
    if divisor:
        return float(divisor), divisor / math.sqrt(12.0)
    values = np.unique(sample[np.isfinite(sample)])
    with np.errstate(invalid="ignore"):
        all_finite = bool(np.isfinite(flat.sum(dtype=np.float64)))
    finite = flat if all_finite else flat[np.isfinite(flat)]
    if not values.size or not finite.size:
        return 0.0, 1.0
    span = float(finite.max()) - float(np.median(values))
    # Values that are nearly all different are not digitised: only repeated ones can show a step.
    step = _lattice_step(values) if values.size <= sample.size // 4 else 0.0
    # float32 does not resolve values closer than this
    resolution = float(np.finfo(np.float32).eps) * float(np.abs(finite).max())
    return step, max(step / math.sqrt(12.0), _NOISE_FREE * span, resolution, float(np.finfo(np.float32).tiny))


def _lattice_step(values: NDArray[Any]) -> float:
    """Step of the lattice of sorted values; if they lie on no lattice, their median gap, at most 1/255 of the range."""
    if values.size < 3:
        return 0.0
    gaps = np.diff(values.astype(np.float64))
    steps_from_first = (values - np.float64(values[0])) / gaps.min()
    if np.abs(steps_from_first - np.rint(steps_from_first)).max() < _ON_LATTICE:
        return float(gaps.min())
    return min(float(np.median(gaps)), float(values[-1] - values[0]) / 255.0)


_LAG_PX = 5
"""Distance between the pixels whose difference measures the noise: larger than a star image and than the correlation
length of noise in photographs."""
_ROWS, _COLUMNS = 16, 64
"""Rows and columns at which differences are taken; only few rows, because each row must be fetched from memory
again."""
_SPREAD = 0.67449 * math.sqrt(1.5)
"""Median absolute value of the difference of a pixel to the mean of two others, for noise of standard deviation 1:
0.67449 times √(1 + ½)."""
_BIN_PX = 4
_REACH_BINS = 2
"""The background is a median of 5 × 5 bins of 4 px: 20 px, of which a star covers 4 bins of 25 and a long trail 5 to
10."""


def has_structure(image: Image, background: Background) -> bool:
    """Whether the background's noise is more than 1.5 times the noise of the pixels.

    The noise of the pixels is measured by the differences between a pixel and the mean of the two at 5 px on either
    side, along x or y, whichever are larger, in units of the background's noise. Slopes cancel in these differences.
    """
    if min(image.shape) <= 2 * _LAG_PX:
        return False
    return bool(_is_quiet(image, background.noise_plane))


@kernel
def _is_quiet(image: Image, noise: Plane) -> bool:
    """Whether the differences of a thousand pixels are quiet along both axes, and not all zero along one.

    Quiet means that their robust standard deviation, in units of the background's noise, is below the limit. The
    medians are compared by counting values below the limit, so that nothing is sorted.
    """
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

    Means of bins of 4 px, without the highest and the lowest pixel of each, pass a 5 × 5 median, which leaves a slope
    unchanged and removes a star. The median of the residual is added once more (Tukey's twicing), so that a ridge is
    not cut off by its curvature. The noise is that of the residual image, from tiles as in `estimate`.

    Parameters
    ----------
    image : array, shape (H, W)
        DN; pixels that are not finite are left out.
    tile_px : int
        Size of the tiles in which the noise is measured.
    """
    height, width = image.shape
    floor = noise_floor(image)[1]
    bins = _bin_means(image, max(1, round(height / _BIN_PX)), max(1, round(width / _BIN_PX)))
    gaps = ~np.isfinite(bins)
    bins[gaps] = np.median(bins[~gaps]) if not gaps.all() else 0.0
    level = _medians(bins)
    level += _medians(bins - level)
    plane = interpolate_tiles(level, height, width, True)
    residual = np.asarray(image, np.float32) - fill_plane(plane)
    rows, columns = max(1, round(height / tile_px)), max(1, round(width / tile_px))
    _, noise = tile_statistics(residual, rows, columns, 0.0)
    known = np.isfinite(noise)
    noise[~known] = np.median(noise[known]) if known.any() else 1.0
    return Background(plane, interpolate_tiles(np.maximum(smooth_tiles(noise), floor), height, width, False))


@kernel
def _bin_means(image: Image, rows: int, columns: int) -> FloatArray:
    """Mean of each of rows × columns bins without its highest and lowest pixel; NaN for a bin without finite pixels."""
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
    """Median of 5 × 5 bins; beyond its border the map is continued point-symmetrically, so that slopes continue."""
    from scipy import ndimage

    reach = min(_REACH_BINS, min(bins.shape) - 1)
    padded = np.pad(bins, reach, mode="reflect", reflect_type="odd") if reach > 0 else bins
    side, (height, width) = 2 * reach + 1, bins.shape
    filtered = ndimage.median_filter(padded.astype(np.float32), side)[reach : reach + height, reach : reach + width]
    return np.asarray(filtered, dtype=np.float64)


_GRID = 48
"""Positions per axis at which the share of bright pixels is measured: a share of 3 % is found to 0.4 %."""
_CHANCE_SIGMAS = 3.0  # standard deviations of the number of chance coincidences
_AROUND = np.array([(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)])


class Light(NamedTuple):
    """An image and its background.

    Parameters
    ----------
    image : (H, W)
    background : Background
    threshold_sigma : float
        Threshold in standard deviations of the noise of a pixel.
    """

    image: Image
    background: Background
    threshold_sigma: float

    def stands_out(self, xy: FloatArray) -> BoolArray:
        """Whether one of the 3 × 3 pixels about each position (N, 2) is above the threshold."""
        height, width = self.image.shape
        pixel = np.rint(xy).astype(np.int64)[:, None, :] + _AROUND
        x, y = np.clip(pixel[..., 0], 0, width - 1), np.clip(pixel[..., 1], 0, height - 1)
        level, noise = self.background.level[y, x], self.background.noise[y, x]
        # Comparisons with NaN are false, so that a pixel without a value does not count as bright.
        above = self.image[y, x] - level > self.threshold_sigma * noise
        return np.asarray(above.any(axis=1))

    def seen(self, xy: FloatArray) -> BoolArray:
        """Which positions (N, 2) have light; none if no more of them have than random positions would.

        If a share p of the image is above the threshold, p n of n positions have light by chance, with a standard
        deviation of √(p (1 − p) n). Unless the number is more than three of these above p n, all positions count as
        dark.
        """
        lit = self.stands_out(xy)
        height, width = self.image.shape
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID)), axis=-1)
        share, count = float(np.mean(self.stands_out(grid.reshape(-1, 2)))), len(xy)
        by_chance = share * count + _CHANCE_SIGMAS * math.sqrt(share * (1.0 - share) * count)
        return lit if np.count_nonzero(lit) > by_chance else np.zeros_like(lit)
