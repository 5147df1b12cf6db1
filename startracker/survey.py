"""Checks of an image before detection: whether it is usable, its range and its saturation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.detection.defects import mask_extremes
from startracker.detection.values import Image, as_pixels, whole_range
from startracker.display import fields_repr
from startracker.errors import InputError

SATURATED_SHARE = 0.05
"""Fraction of saturated pixels above which an unsolved image gets the status `saturated`."""


def plain(values: ArrayLike) -> NDArray[Any]:
    """A masked array (`numpy.ma`) with NaN where it is masked; anything else unchanged.

    Raises
    ------
    InputError
        For rows of different lengths.
    """
    if not isinstance(values, np.ma.MaskedArray):
        try:
            return np.asarray(values)
        except ValueError as error:
            raise InputError(f"not an array of numbers: {' '.join(str(error).split())}") from None
    if values.dtype.kind not in "buif" or not np.ma.is_masked(values):
        return np.asarray(values.data)
    kind = np.float64 if values.dtype.itemsize > 2 else np.float32  # which represent every value exactly
    return np.asarray(np.ma.filled(values.astype(kind), np.nan))


@dataclass(frozen=True, eq=False)
class Survey:
    """A usable image as uint16 or float32, NaN where not finite or where light cannot cause the value (`masked` of
    them); its range; saturated fraction and saturation level; whether it contains NaN."""

    pixels: Image
    lowest: float
    highest: float
    saturated_share: float
    saturation_dn: float
    masked: int = 0
    gaps: bool = False

    __repr__ = fields_repr


def shape_fault(given: tuple[int, ...], shape: tuple[int, int] | None) -> str:
    """Reason why an image of a shape is not one of a camera of `shape`, (rows, columns); empty if it is."""
    if len(given) != 2:
        return f"an image must have two dimensions (rows, columns); got {given}"
    if shape is not None and given != shape:
        size = f"the image is {given[1]}×{given[0]} pixels, the camera {shape[1]}×{shape[0]}"
        return f"{size}: give the camera that took it"
    return ""


def survey(image: ArrayLike, shape: tuple[int, int] | None, saturation_dn: float | None) -> tuple[Survey | None, str]:
    """Survey of an image, or None and the reason why it cannot be used.

    The saturation level is the given one, the largest value of an unsigned type, or the image's maximum.
    """
    try:
        as_given = np.asanyarray(image)
        given = plain(as_given)
        if given.dtype.kind not in "buif":
            return None, f"an image needs real numbers; got {given.dtype}"
    except (TypeError, ValueError):
        return None, "an image must be an array of numbers"
    if fault := shape_fault(given.shape, shape):
        return None, fault
    pixels = as_pixels(given)
    if not given.size:
        return None, "no pixel of the image is a finite number"
    level = saturation_dn
    if level is None and as_given.dtype.kind == "u":
        level = float(np.iinfo(as_given.dtype).max)
    if pixels.dtype.kind == "u" and level is not None:  # always finite, and their range takes a quarter of the time
        lowest, highest, full = whole_range(pixels, math.ceil(max(min(2.0**16, level), 0.0)))
        return Survey(pixels, float(lowest), float(highest), full / pixels.size, level), ""
    plane = given if given.dtype.kind in "ui" else pixels
    lowest, highest = float(np.float32(plane.min())), float(np.float32(plane.max()))
    gaps = not (math.isfinite(lowest) and math.isfinite(highest))  # NaN makes both NaN
    if gaps:
        pixels = np.where(np.isfinite(pixels), pixels, np.float32(np.nan))
        lowest, highest = float(np.fmin.reduce(pixels, axis=None)), float(np.fmax.reduce(pixels, axis=None))
        if not math.isfinite(highest):
            return None, "no pixel of the image is a finite number"
    pixels, masked = mask_extremes(pixels, lowest, highest)
    if masked:
        lowest, highest = float(np.fmin.reduce(pixels, axis=None)), float(np.fmax.reduce(pixels, axis=None))
    if level is None:
        level = highest if highest > 0 else math.inf
    full = int(np.count_nonzero(pixels >= level)) if highest >= level else 0
    return Survey(pixels, lowest, highest, full / pixels.size, level, masked, gaps or masked > 0), ""


def says_saturated(share: float, level: float) -> str:
    """Reason text for a saturated image."""
    return f"{100 * share:.0f} % of the pixels are at or above {level:g}: saturated; shorten the exposure"
