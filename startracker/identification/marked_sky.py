"""Where no guide star is near, told at once: cells of space near any guide star leave marks in a table.

The cells are cubes, and a hash of a cell's numbers says which bit is its mark. A bit that is not set is proof that no
guide star is within reach; one that is set may be another cell's, and the stars themselves have to be looked at.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.kernels import kernel, kernel_with

__all__ = ["Marks", "is_marked", "mark_sky", "no_marks"]

FloatArray = NDArray[np.float64]

_BITS = 20
"""128 kB: of 9,000 guide stars and a reach of a milliradian every tenth direction is near a mark."""
_REACHES_PER_CELL = 3.0
_LEAST_REACH, _ROUNDING = 1e-6, 1e-9


class Marks(NamedTuple):
    """Marks of all cells with a point within reach of a guide star.

    Parameters
    ----------
    words : uint32 (2^20 / 32,)
        The bits.
    per_unit : float
        Cells to a unit of length.
    reach2 : float
        Square of the reach; negative where nothing is marked and nothing can be told.
    share : float
        Of the bits that are set, which is that of random directions that cannot be excluded at once.
    """

    words: NDArray[np.uint32]
    per_unit: float
    reach2: float
    share: float


@kernel_with(inline="always")
def _bit(i: int, j: int, k: int) -> np.uint64:
    """Mark of a cell: products with large primes (Teschner et al. 2003); unsigned, as no index counts from the end."""
    return np.uint64((i * 73856093 ^ j * 19349663 ^ k * 83492791) & ((1 << _BITS) - 1))


def no_marks() -> Marks:
    """Before anything is marked."""
    return Marks(np.empty(0, np.uint32), 0.0, -1.0, 1.0)


@kernel
def mark_sky(directions: FloatArray, reach: float) -> Marks:
    """Marks of all cells that have a point within `reach` of one of the directions (G, 3)."""
    words, reach = np.zeros(1 << (_BITS - 5), np.uint32), max(reach, _LEAST_REACH)
    per_unit, beyond = 1.0 / (_REACHES_PER_CELL * reach), reach + _ROUNDING
    low, high, count = np.empty(3, np.int64), np.empty(3, np.int64), 0
    for star in range(len(directions)):
        for axis in range(3):  # 2: whole numbers are cut off the same way on both sides of 0
            low[axis] = int((directions[star, axis] + 2.0 - beyond) * per_unit)
            high[axis] = int((directions[star, axis] + 2.0 + beyond) * per_unit)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    bit = _bit(i, j, k)
                    word, mark = words[bit >> np.uint64(5)], np.uint32(1) << np.uint32(bit & np.uint64(31))
                    count += (word & mark) == 0
                    words[bit >> np.uint64(5)] = word | mark
    return Marks(words, per_unit, reach * reach, count / 2**_BITS)


@kernel_with(inline="always")
def is_marked(x: float, y: float, z: float, marks: Marks) -> bool:
    """Whether a direction could be within reach of a guide star."""
    bit = _bit(int((x + 2.0) * marks.per_unit), int((y + 2.0) * marks.per_unit), int((z + 2.0) * marks.per_unit))
    marked: bool = ((marks.words[bit >> np.uint64(5)] >> np.uint32(bit & np.uint64(31))) & np.uint32(1)) != 0
    return marked
