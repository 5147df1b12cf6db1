"""Few of many: where in a run of numbers those are that a kernel has left to a slower way.

A loop that asks each number whether it is one of them keeps the compiler from computing many at once. Blocks of `BLOCK`
numbers are counted, which it does, and only those blocks looked through that hold one.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

BLOCK = 64


@numba.njit(cache=True, error_model="numpy")
def outside(number: NDArray[Any], low: float, high: float) -> int:
    """How many of the numbers (N,) do not lie in low … high; NaN lies nowhere."""
    count = np.int32(0)
    for i in range(number.size):
        count = np.int32(count + np.int32(not ((number[i] >= low) & (number[i] <= high))))
    return int(count)
