"""Running centroids in integers, updated pixel by pixel (Yee 1999, sections 2.2 and 4.2.4.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simulator.theses.yee1999.fixed_point.formats import CENTROID, Format, integers
from startracker.flight.integers import Integers

_SIGNAL = Format(32, 0)


def running_centroid(x: ArrayLike, y: ArrayLike, signal: ArrayLike) -> Integers:
    """Centroid (2,) of 10.22 of the pixels of a cluster, accumulated one by one.

    c ← (c S + x f) / (S + f), S ← S + f: eqs. 2.1 and 2.2 as a running mean. The product of two 32-bit words has 64
    bits, for which Yee recommends a 64-bit processor. Each quotient is truncated towards zero, which after n pixels
    gives an error of less than n × 2⁻²² towards the origin.

    Parameters
    ----------
    x, y : array_like of int, shape (N,)
        Pixel coordinates from the image centre.
    signal : array_like of int, shape (N,)
        DN of each pixel, not negative; the first is positive.

    Raises
    ------
    FixedPointOverflow
        A pixel outside 10.22, or a sum of signals of 2³¹ or more.
    ValueError
        No pixels, or a first pixel without signal.
    """
    dn = _SIGNAL.check(signal, "signal")
    if dn.size == 0 or dn.flat[0] <= 0 or dn.min() < 0:
        raise ValueError("the first pixel of a cluster must have a signal, and no signal may be negative")
    _SIGNAL.check(dn.sum(), "sum of the signals")
    points = np.stack([CENTROID.from_integer(integers(x)), CENTROID.from_integer(integers(y))], axis=1)
    centre, total = [0, 0], 0
    for point, added in zip(points.tolist(), dn.tolist(), strict=True):
        total += added
        for axis in range(2):
            moment = centre[axis] * (total - added) + point[axis] * added
            quotient = abs(moment) // total
            centre[axis] = quotient if moment >= 0 else -quotient
    return np.array(centre)
