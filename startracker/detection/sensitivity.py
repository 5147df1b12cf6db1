"""Unequal sensitivities of the pixels: a map of them from evenly lit frames, and images corrected with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.errors import InputError

FloatImage = NDArray[np.float32]


def sensitivity_map(even: ArrayLike, dark: ArrayLike | float = 0.0) -> FloatImage:
    """Relative sensitivity (H, W) of each pixel, 1 on the mean, from evenly lit frames.

    Parameters
    ----------
    even : array, shape (N, H, W) or (H, W)
        Frames of an even light, DN; their mean is taken.
    dark : array, shape (N, H, W) or (H, W), or float
        Frames without light of the same exposure, or the level of such, DN.

    Raises
    ------
    InputError
        When the light is not above the dark level on the mean.

    Notes
    -----
    With N frames of S electrons per pixel the map has a relative error of 1/√(N S).
    """
    light = _mean(even) - _mean(dark)
    middle = float(np.nanmean(light))
    if not middle > 0.0:
        raise InputError(f"the even light is {middle:g} DN above the dark level; it must be brighter")
    return np.asarray(light / middle, dtype=np.float32)


def correct_sensitivity(image: ArrayLike, sensitivity: ArrayLike, dark: ArrayLike | float = 0.0) -> FloatImage:
    """An image (H, W) as pixels of equal sensitivity would have it: what is above the dark level over the sensitivity.

    Parameters
    ----------
    image : array, shape (H, W)
        DN.
    sensitivity : array, shape (H, W)
        As `sensitivity_map` gives; pixels where it is not positive become NaN, which every detector leaves out.
    dark : array, shape (H, W), or float
        Level without light, DN; it stays in the image.

    Raises
    ------
    InputError
        When the shapes differ.
    """
    pixels, gain = np.asarray(image, dtype=np.float32), np.asarray(sensitivity, dtype=np.float32)
    if pixels.shape != gain.shape:
        raise InputError(f"the image is {pixels.shape} but the map of sensitivities {gain.shape}")
    level = np.asarray(dark, dtype=np.float32)
    usable = np.where(gain > 0.0, gain, np.float32(np.nan))
    return np.asarray((pixels - level) / usable + level, dtype=np.float32)


def _mean(frames: ArrayLike | float) -> NDArray[np.float64]:
    stack = np.asarray(frames, dtype=float)
    return np.asarray(stack.mean(axis=0) if stack.ndim == 3 else stack)
