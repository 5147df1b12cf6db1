"""Properties of a pixel's value for kernels, for every type of image: converters give 16-bit integers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import ArrayLike, NDArray

from startracker._compiled import kernel
from startracker.errors import InputError

Image = NDArray[np.float32] | NDArray[np.uint16]
"""Images that kernels read: float32, possibly with values that are not finite, or uint16."""


def as_image(image: ArrayLike) -> NDArray[np.float32]:
    """Image as a C-contiguous float32 array (H, W); `InputError` when it is not two-dimensional and numeric."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(_checked(image), dtype=np.float32)


def as_pixels(image: ArrayLike) -> Image:
    """`as_image`, but uint16 is not converted, which halves the memory to read and needs no tests for finite values."""
    array = _checked(image)
    return np.ascontiguousarray(array) if array.dtype == np.uint16 else as_image(array)


def _checked(image: ArrayLike) -> NDArray[Any]:
    try:
        array = np.asarray(image)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"an image must be an array: {' '.join(str(error).split())}") from None
    if array.ndim != 2:
        raise InputError(f"an image must have two dimensions (rows, columns); got the shape {array.shape}")
    if array.dtype.kind not in "buif":
        raise InputError(f"an image must hold real numbers; got the type {array.dtype}")
    return array


def is_value(pixel: float) -> bool:
    """Whether a pixel's value is a finite number."""
    return bool(abs(pixel) < np.inf)


@overload(is_value)
def _is_value(pixel: Any) -> Callable[[Any], bool]:
    def always(pixel: Any) -> bool:  # argument and annotation as above: numba compares them
        return True

    def finite(pixel: Any) -> bool:
        return bool(abs(pixel) < np.inf)

    return always if isinstance(pixel, types.Integer) else finite


def is_integer(image: Image) -> bool:
    """Whether an image holds integers; kernels know it when they are compiled."""
    return image.dtype.kind in "ui"


@overload(is_integer)
def _is_integer(image: Any) -> Callable[[Any], bool]:
    whole = isinstance(image.dtype, types.Integer)

    def found(image: Any) -> bool:
        return whole

    return found


@kernel
def whole_range(image: NDArray[np.uint16], least: int) -> tuple[int, int, int]:
    """Lowest and highest value of an image of integers, and how many are at least `least`, in one pass."""
    lowest, highest, count = image[0, 0], image[0, 0], 0
    for y in range(image.shape[0]):
        row, top = image[y], image[y, 0]
        for x in range(len(row)):
            lowest, top = min(lowest, row[x]), max(top, row[x])
        highest = max(highest, top)
        if top >= least:  # few rows have such values
            for x in range(len(row)):
                count += int(row[x] >= least)
    return int(lowest), int(highest), count
