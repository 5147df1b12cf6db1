"""Occupancy map of the sky: a quick proof that no guide star is near a direction.

Space is divided into cubic cells, and a hash of a cell's indices selects a bit. The bits of all cells near a guide star
are set. A bit that is not set proves that no guide star is within reach; one that is set may be another cell's, and the
stars themselves have to be searched.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.kernels import kernel, kernel_part

_BITS = 20
"""128 kB: with 9,000 guide stars and a reach of a milliradian every tenth direction is in an occupied cell."""
_REACHES_PER_CELL = 3.0
_LEAST_REACH, _ROUNDING = 1e-6, 1e-9


class Occupancy(NamedTuple):
    """Bits of all cells with a point within reach of a guide star.

    Parameters
    ----------
    words : uint32 (2^20 / 32,)
        The bits.
    per_unit : float
        Cells per unit of length.
    reach2 : float
        Square of the reach; negative: there is no map.
    share : float
        Fraction of the bits that are set: of random directions, those that the map cannot exclude.
    """

    words: NDArray[np.uint32]
    per_unit: float
    reach2: float
    share: float


@kernel_part
def _bit(i: int, j: int, k: int) -> np.uint64:
    """Bit of a cell: products with large primes (Teschner et al. 2003); unsigned, as no index counts from the end."""
    return np.uint64((i * 73856093 ^ j * 19349663 ^ k * 83492791) & ((1 << _BITS) - 1))


NO_OCCUPANCY = Occupancy(np.empty(0, np.uint32), 0.0, -1.0, 1.0)
"""In place of a map: nothing is excluded."""


@kernel
def occupancy_map(directions: FloatArray, reach: float) -> Occupancy:
    """Map of all cells that have a point within `reach` of one of the directions (G, 3)."""
    words, reach = np.zeros(1 << (_BITS - 5), np.uint32), max(reach, _LEAST_REACH)
    per_unit, beyond = 1.0 / (_REACHES_PER_CELL * reach), reach + _ROUNDING
    low, high, count = np.empty(3, np.int64), np.empty(3, np.int64), 0
    for star in range(len(directions)):
        for axis in range(3):  # + 2: integers are truncated in the same direction on both sides of 0
            low[axis] = int((directions[star, axis] + 2.0 - beyond) * per_unit)
            high[axis] = int((directions[star, axis] + 2.0 + beyond) * per_unit)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    bit = _bit(i, j, k)
                    word, mark = words[bit >> np.uint64(5)], np.uint32(1) << np.uint32(bit & np.uint64(31))
                    count += (word & mark) == 0
                    words[bit >> np.uint64(5)] = word | mark
    return Occupancy(words, per_unit, reach * reach, count / 2**_BITS)


@kernel_part
def is_occupied(x: float, y: float, z: float, occupancy: Occupancy) -> bool:
    """Whether a direction could be within reach of a guide star."""
    scale = occupancy.per_unit
    bit = _bit(int((x + 2.0) * scale), int((y + 2.0) * scale), int((z + 2.0) * scale))
    occupied: bool = ((occupancy.words[bit >> np.uint64(5)] >> np.uint32(bit & np.uint64(31))) & np.uint32(1)) != 0
    return occupied
