"""Level comparators as a converter: one more output value than levels, with arbitrary levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arrays import FloatArray
from startracker.errors import InputError


def compare_levels(signal: ArrayLike, levels: ArrayLike) -> NDArray[np.uint16]:
    """Number of the ascending levels (N,) reached by each signal, in the same unit: 0 … N.

    The prototype of Greyling 1995 (section 6.2.3) has three comparators with manually set levels: 2 bits.

    Raises
    ------
    InputError
        If the levels are not ascending.
    """
    limits = np.asarray(levels, dtype=float)
    if limits.ndim != 1 or not len(limits) or not (np.diff(limits) > 0.0).all():
        raise InputError(f"the levels of comparators must be ascending; got {limits.tolist()}")
    return np.searchsorted(limits, np.asarray(signal, dtype=float), side="right").astype(np.uint16)


def even_levels(bits: int, full: float) -> FloatArray:
    """Levels (2^bits − 1,) of a converter that rounds to the nearest of 2^bits values from 0 to `full`."""
    top = 2**bits - 1
    return np.asarray((np.arange(top) + 0.5) * (full / top))


def geometric_levels(lowest: float, highest: float) -> FloatArray:
    """Three levels of equal ratio: closer together at low signals."""
    return np.geomspace(lowest, highest, 3)
