"""Uniformly bright disks, integrated exactly over pixels: ghosts, and bodies without a phase."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from startracker.arrays import FloatArray
from startracker.kernels import pixel_kernel


def add_disk(image: FloatArray, xy: ArrayLike, radius_px: float | tuple[float, float], electrons: float) -> None:
    """Add a uniformly bright disk (planet, Sun, full Moon) to `image` in place, integrated exactly over pixels.

    A pixel gets electrons × (area of the disk inside it) / (area of the disk). Blur by the optics is neglected, so this
    is for disks much wider than the PSF.

    Parameters
    ----------
    image : (rows, columns) float64 array
        Mean photo-electrons.
    xy : (2,) array
        Centre, pixels; may be outside the image.
    radius_px : float or (float, float)
        Radius; along columns and rows if pixels are not square.
    electrons : float
        Electrons of the whole disk over the exposure.
    """
    x, y = np.asarray(xy, dtype=float)
    radius_x, radius_y = (radius_px, radius_px) if isinstance(radius_px, int | float) else radius_px
    if math.isfinite(x) and math.isfinite(y):
        add_ellipse(image, float(x), float(y), float(radius_x), float(radius_y), float(electrons))


@pixel_kernel
def add_ellipse(image: FloatArray, x: float, y: float, radius_x: float, radius_y: float, electrons: float) -> None:
    """Kernel: exact overlap of an axis-aligned ellipse with each pixel."""
    height, width = image.shape
    for j in range(max(math.ceil(y - radius_y - 0.5), 0), min(math.floor(y + radius_y + 0.5), height - 1) + 1):
        low, high = (j - 0.5 - y) / radius_y, (j + 0.5 - y) / radius_y
        for i in range(max(math.ceil(x - radius_x - 0.5), 0), min(math.floor(x + radius_x + 0.5), width - 1) + 1):
            left, right = (i - 0.5 - x) / radius_x, (i + 0.5 - x) / radius_x
            area = _corner(right, high) - _corner(left, high) - _corner(right, low) + _corner(left, low)
            image[j, i] += electrons / math.pi * max(area, 0.0)  # rounding can give −1e-17


@pixel_kernel
def _corner(x: float, y: float) -> float:
    """Area of the part of the unit disk with X ≤ x and Y ≤ y."""
    x, y = min(max(x, -1.0), 1.0), min(max(y, -1.0), 1.0)
    half_chord = math.sqrt(1.0 - y * y)
    # for |X| > half_chord the whole chord of the disk is below y (y > 0) or above it (y < 0)
    inner = min(max(x, -half_chord), half_chord)
    area: float = _semicircle(inner) - _semicircle(-half_chord) + y * (inner + half_chord)
    if y > 0.0:
        area += 2.0 * (_semicircle(min(x, -half_chord)) - _semicircle(-1.0))
        area += 2.0 * (_semicircle(max(x, half_chord)) - _semicircle(half_chord))
    return area


@pixel_kernel
def _semicircle(t: float) -> float:
    """∫ √(1 − t²) dt."""
    area: float = 0.5 * (t * math.sqrt(max(1.0 - t * t, 0.0)) + math.asin(t))
    return area
