"""Uniformly bright disks, integrated exactly over pixels: ghosts, and bodies without a phase."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray


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
    (x, y), (height, width) = np.asarray(xy, dtype=float).tolist(), image.shape
    radius_x, radius_y = (radius_px, radius_px) if isinstance(radius_px, int | float) else radius_px
    if not (math.isfinite(x) and math.isfinite(y)):
        return
    # Pixels that the disk may touch, with centres at integer coordinates, and their edges in radii of the disk.
    left, right = max(math.ceil(x - radius_x - 0.5), 0), min(math.floor(x + radius_x + 0.5), width - 1)
    top, bottom = max(math.ceil(y - radius_y - 0.5), 0), min(math.floor(y + radius_y + 0.5), height - 1)
    if left > right or top > bottom:
        return
    columns, rows = np.arange(left, right + 2) - 0.5, np.arange(top, bottom + 2) - 0.5
    areas = np.diff(np.diff(_corners((columns - x) / radius_x, (rows - y) / radius_y), axis=0), axis=1)
    # Second differences of the areas left of and above the corners are the areas within the pixels; rounding can make
    # them −1e-17.
    image[top : bottom + 1, left : right + 1] += electrons / math.pi * np.maximum(areas, 0.0)


def _corners(x: FloatArray, y: FloatArray) -> FloatArray:
    """Areas (J, I) of the parts of the unit disk with X ≤ x (I,) and Y ≤ y (J,)."""
    x, y = np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0)[:, None]
    half_chord = np.sqrt(1.0 - y * y)
    until_x, until_chord = _semicircle(x), _semicircle(half_chord)
    # Columns X that the line Y = y crosses inside the disk, |X| ≤ half_chord, contribute the part of their chord below
    # y. For |X| > half_chord the whole chord is below y (y > 0) or above it (y < 0).
    inner = (
        np.clip(until_x, -until_chord, until_chord)
        + until_chord
        + y * (np.clip(x, -half_chord, half_chord) + half_chord)
    )
    outer = np.minimum(until_x, -until_chord) + math.pi / 4.0 + np.maximum(until_x, until_chord) - until_chord
    return np.asarray(inner + np.where(y > 0.0, 2.0 * outer, 0.0))


def _semicircle(t: FloatArray) -> FloatArray:
    """Area under the unit circle, ∫₀ᵗ √(1 − t²) dt, an increasing function of t."""
    return np.asarray(0.5 * (t * np.sqrt(np.maximum(1.0 - t * t, 0.0)) + np.arcsin(t)))
