"""When, and for ``sky`` how, the trials of a study look: a pure function of seed and trial index.

The times do not depend on the number of trials or workers, so that any trial can be made again alone.
"""

from __future__ import annotations

import functools

from simulator.randomness import stream

TROPICAL_YEAR_S = 365.2422 * 86_400.0
"""One turn of the seasons, and of a sun-synchronous node; Explanatory Supplement 2013."""

_GOLDEN = 0.618_033_988_749_894_9


def trial_time_s(sampling: str, seed: int, index: int, period_s: float) -> float:
    """Seconds after the epoch of trial `index`.

    ``mission_year`` and ``orbit`` spread the trials over a year or over one round, an orbit of `period_s`, by the
    golden-ratio sequence from a random start: the first n trials are always evenly spread, whatever n (a lattice of
    lowest discrepancy in one dimension, Niederreiter 1992, chapter 3). ``sky`` stays at the epoch.
    """
    if sampling == "sky":
        return 0.0
    span = TROPICAL_YEAR_S if sampling == "mission_year" else period_s
    return ((_start(seed) + index * _GOLDEN) % 1.0) * span


@functools.lru_cache(maxsize=64)
def _start(seed: int) -> float:
    return float(stream(seed, "sampling").random())
