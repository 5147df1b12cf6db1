"""Epochs and proper motions of guide stars as integers.

``tracker_apparent`` of `c/tracker_directions.c` moves guide stars from the epoch of the tables to that of a frame, and
adds aberration. Left out is the annual parallax, 0.75″ for the nearest star.
"""

from __future__ import annotations

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.errors import InputError
from startracker.flight.integers import Integers, rounded
from startracker.observer import Observer

EPOCH_BITS, MOTION_BITS = 16, 29
"""Fraction bits of years, and of motions in unit vectors a year: steps of 0.4 mas, up to 12.6″ on an axis."""
MOST_YEARS = 100
"""Between a frame and the tables."""
_SPAN_YEARS = 5.0


def epoch_of(epoch_jyear: float) -> int:
    """A Julian epoch, years of 16 fraction bits."""
    return round(epoch_jyear * (1 << EPOCH_BITS))


def guide_motion(guide: GuideDatabase) -> Integers:
    """Motion (G, 3) of guide stars per year about their epoch, unit vectors of 29 fraction bits.

    Raises
    ------
    InputError
        For a star that moves by more than 12.6″ a year.
    """
    before, after = (guide.apparent_to(Observer(guide.epoch_jyear + years)) for years in (-_SPAN_YEARS, _SPAN_YEARS))
    yearly = (after.directions - before.directions) / (2.0 * _SPAN_YEARS)
    motion = rounded(yearly, MOTION_BITS)
    if len(motion) and np.abs(motion).max() > np.iinfo(np.int16).max:
        fastest = guide.catalog.id[np.abs(motion).max(axis=1).argmax()]
        raise InputError(f"guide star {fastest} moves by more than 12.6″ a year, a flight build does not hold that")
    return motion
