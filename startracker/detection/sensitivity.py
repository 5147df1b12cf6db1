"""Sensitivity of the pixels (flat field): a map from evenly lit frames, and the correction of images with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.errors import InputError

FloatImage = NDArray[np.float32]


def sensitivity_map(even: ArrayLike, dark: ArrayLike | float = 0.0) -> FloatImage:
    """Relative sensitivity (H, W) of each pixel, with a mean of 1, from evenly lit frames.

    Parameters
    ----------
    even : array, shape (N, H, W) or (H, W)
        Evenly lit frames, DN; their mean is used.
    dark : array, shape (N, H, W) or (H, W), or float
        Frames without light of the same exposure time, or their level, DN.

    Raises
    ------
    InputError
        If the mean of the evenly lit frames does not exceed the dark level.

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
    """Image (H, W) corrected to equal sensitivity of all pixels: the signal above the dark level over the sensitivity.

    Parameters
    ----------
    image : array, shape (H, W)
        DN.
    sensitivity : array, shape (H, W)
        From `sensitivity_map`; pixels where it is not positive become NaN, which every detector ignores.
    dark : array, shape (H, W), or float
        Level without light, DN; it is not subtracted from the result.

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
