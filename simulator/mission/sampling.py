"""Times of the trials of a study: a pure function of seed and trial index.

The times do not depend on the number of trials or workers, so that any trial can be reproduced on its own.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from simulator.randomness import stream

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TROPICAL_YEAR_S = 365.2422 * 86_400.0
"""Tropical year, in which a sun-synchronous node completes one revolution; Explanatory Supplement 2013."""

_GOLDEN = 0.618_033_988_749_894_9


def trial_time_s(sampling: str, seed: int, index: IntArray, period_s: float) -> FloatArray:
    """Seconds after the epoch of the trials `index`, of the shape of `index`.

    ``mission_year`` and ``orbit`` distribute the trials over a year or over one period `period_s` by the golden-ratio
    sequence with a random start: the first n trials are evenly distributed for any n (a sequence of lowest discrepancy
    in one dimension, Niederreiter 1992, chapter 3). For ``sky`` all times are the epoch.
    """
    if sampling == "sky":
        return np.zeros(np.shape(index))
    span = TROPICAL_YEAR_S if sampling == "mission_year" else period_s
    return np.asarray(((_start(seed) + np.asarray(index) * _GOLDEN) % 1.0) * span)


@functools.lru_cache(maxsize=64)
def _start(seed: int) -> float:
    return float(stream(seed, "sampling").random())
