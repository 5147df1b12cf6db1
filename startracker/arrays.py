"""Types of arrays in annotations; shapes and units stand in the docstrings."""

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
