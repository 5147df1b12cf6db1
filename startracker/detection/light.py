"""Light at given positions of an image, whatever the detector made of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.core import BoolArray, FloatArray
from startracker.detection.background import Background
from startracker.detection.values import Image

_GRID = 48
"""Positions per axis at which the share of the image that stands out is measured: 3 % of it to 0.4 %."""
_CHANCE_SIGMAS = 3.0
_AROUND = np.array([(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)])


class Light(NamedTuple):
    """An image and its background.

    Parameters
    ----------
    image : (H, W)
    background : Background
    threshold_sigma : float
        What stands out, in standard deviations of the noise of a pixel.
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
        above = self.image[y, x] - level > self.threshold_sigma * noise  # NaN is not
        return np.asarray(above.any(axis=1))

    def seen(self, xy: FloatArray) -> BoolArray:
        """Whether each position has light, if more of them have than positions anywhere on the image by chance.

        With n positions and a share p of the image that stands out, p n have light by chance, with a standard deviation
        of √(p (1 − p) n); up to three of these above it none counts as seen.
        """
        lit = self.stands_out(xy)
        height, width = self.image.shape
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID)), axis=-1)
        share, count = float(np.mean(self.stands_out(grid.reshape(-1, 2)))), len(xy)
        by_chance = share * count + _CHANCE_SIGMAS * math.sqrt(share * (1.0 - share) * count)
        return lit if np.count_nonzero(lit) > by_chance else np.zeros_like(lit)
