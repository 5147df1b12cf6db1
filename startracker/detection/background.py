"""Local background and its noise: robust statistics of tiles, smoothed and interpolated to every pixel."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.detection.plane import Plane, as_plane, fill_plane
from startracker.detection.tiles import interpolate_tiles, smooth_tiles, tile_statistics, whole_step
from startracker.detection.values import Image, as_image, as_pixels
from startracker.errors import InputError

__all__ = ["Background", "as_image", "estimate", "noise_floor"]

FloatImage = NDArray[np.float32]

_SMALLEST_TILE_PX = 8
_STEP_SAMPLES = 4096
_ON_LATTICE = 0.01
_NOISE_FREE = 1e-5
"""Noise ascribed to an image that has none, as a share of its range: the tails of a bright star stay a small spot."""


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
        The same for kernels, which look at few pixels; the whole maps are drawn when they are first asked for.
    """

    def __init__(self, level: FloatImage | Plane, noise: FloatImage | Plane) -> None:
        self.level_plane = level if isinstance(level, Plane) else as_plane(level)
        self.noise_plane = noise if isinstance(noise, Plane) else as_plane(noise)
        if not isinstance(level, Plane):
            self.__dict__["level"] = level
        if not isinstance(noise, Plane):
            self.__dict__["noise"] = noise

    @property
    def shape(self) -> tuple[int, int]:
        """Of the image."""
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

    The image is cut into tiles of about `tile_px`; some 400 pixels of each, spread over all its rows, give a median
    and the 84 % quantile, then a mean and a standard deviation clipped three times at 3σ about the median, the latter
    corrected for the clipping. Tiles pass a 3×3 median, which a bright star or
    the Moon does not survive, and are interpolated bilinearly between their centres; the level goes on
    linearly to the borders. The procedure is that of Bertin & Arnouts 1996 (SExtractor, section 4).

    The noise never falls below the rounding error of the image's own digitisation, step/√12, nor, in an image without
    a step, below 1e-5 of its range: what has no noise (a rendered frame, the black of an 8-bit photograph) still gets
    a threshold that its stars alone exceed.

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
    if not valid.all():
        level[~valid], noise[~valid] = np.median(level[valid]), np.median(noise[valid])
    level, noise = smooth_tiles(statistics)
    return Background(
        interpolate_tiles(level, height, width, True),
        interpolate_tiles(np.maximum(noise, floor), height, width, False),
    )


def noise_floor(image: Image) -> tuple[float, float]:
    """Digitisation step of an image and the least noise it can have, DN.

    The step is the greatest common divisor of the differences of whole-numbered values (16 for a 12-bit image
    stretched to 16 bits); the smallest gap of other values on a lattice (means of colour channels); the median gap of
    values that at least repeat; else 0. The floor is step/√12, the standard deviation of rounding, and at least 1e-5
    of the range where values are not whole.
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
    step = _lattice_step(values) if values.size <= sample.size // 4 else 0.0
    # float32 does not resolve values closer than this
    resolution = float(np.finfo(np.float32).eps) * float(np.abs(finite).max())
    return step, max(step / math.sqrt(12.0), _NOISE_FREE * span, resolution, float(np.finfo(np.float32).tiny))


def _lattice_step(values: NDArray[Any]) -> float:
    """Step of the lattice of sorted values; where they lie on none, their median gap, at most 1/255 of the range."""
    if values.size < 3:
        return 0.0
    gaps = np.diff(values.astype(np.float64))
    steps_from_first = (values - np.float64(values[0])) / gaps.min()
    if np.abs(steps_from_first - np.rint(steps_from_first)).max() < _ON_LATTICE:
        return float(gaps.min())
    return min(float(np.median(gaps)), float(values[-1] - values[0]) / 255.0)
