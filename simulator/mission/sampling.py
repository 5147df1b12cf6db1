"""Times of the trials of a study: a pure function of seed and trial index.

The times do not depend on the number of trials or workers, so that any trial can be reproduced on its own.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from simulator.constants import TROPICAL_YEAR_S
from simulator.randomness import stream
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError

_GOLDEN = 0.618_033_988_749_894_9
"""(√5 − 1)/2: multiples of it modulo 1 are the most evenly spaced sequence of points."""


def trial_time_s(
    sampling: str, seed: int, index: IntArray, period_s: float, span_s: tuple[float, float] = (0.0, math.inf)
) -> FloatArray:
    """Seconds after the epoch of the trials `index`, of the shape of `index`.

    ``mission_year``, ``orbit`` and ``span`` distribute the trials over a year, over one period `period_s`, or over the
    part of the trajectory's span `span_s` after the epoch, by the golden-ratio sequence with a random start: the first
    n trials are evenly distributed for any n (a sequence of lowest discrepancy in one dimension, Niederreiter 1992,
    chapter 3). For ``sky`` all times are the epoch.

    Raises
    ------
    InputError
        For ``orbit`` with a trajectory that is not closed, or ``span`` with one that has no end, or ends before the
        epoch.
    """
    if sampling == "sky":
        return np.zeros(np.shape(index))
    # A span begins at the epoch, or later if the trajectory does.
    start_s = max(span_s[0], 0.0) if sampling == "span" else 0.0
    length_s = {"mission_year": TROPICAL_YEAR_S, "orbit": period_s, "span": span_s[1] - start_s}[sampling]
    if not 0.0 < length_s < math.inf:
        reason = {
            "orbit": "the trajectory is not a closed orbit; use mission_year or span",
            "span": "the trajectory ends before the epoch; change the epoch"
            if length_s <= 0.0
            else "the trajectory has no end; use mission_year or orbit",
        }
        raise InputError(f"study.sampling: {sampling}: {reason[sampling]}")
    return np.asarray(start_s + ((_start(seed) + np.asarray(index) * _GOLDEN) % 1.0) * length_s)


@functools.lru_cache(maxsize=64)
def _start(seed: int) -> float:
    return float(stream(seed, "sampling").random())
