"""Guide stars as an observer sees them at a time: proper motion since the epoch of the tables, and aberration.

The C is ``tracker_apparent`` of `c/tracker_directions.c`. Left out is the annual parallax, 0.75″ for the nearest star.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.catalog.guide import GuideDatabase
from startracker.errors import InputError
from startracker.fixed_point.formats import Integers
from startracker.flight.directions import FASTEST, aberrated
from startracker.observer import Observer

EPOCH_BITS, MOTION_BITS = 16, 29
"""Fraction bits of years, and of motions in unit vectors a year: steps of 0.4 mas, up to 12.6″ on an axis."""
MOST_YEARS = 100
"""Between a frame and the tables."""
_SPAN_YEARS = 5.0


class FlightObserver(NamedTuple):
    """Observer of a frame.

    Parameters
    ----------
    velocity : int array, shape (3,)
        Over that of light, ICRS axes, 2.30; components up to 2⁻¹⁰.
    years : int
        Since the epoch of the tables, 16 fraction bits.
    """

    velocity: Integers
    years: int = 0


def epoch_of(epoch_jyear: float) -> int:
    """A Julian epoch, years of 16 fraction bits."""
    return round(epoch_jyear * (1 << EPOCH_BITS))


def flight_observer(velocity: ArrayLike | None, epoch: int | None, tables_epoch: int) -> FlightObserver:
    """Observer of a velocity (None: at rest) and an epoch (None or 0: that of the tables), for tables of an epoch.

    Raises
    ------
    InputError
        For a velocity or an epoch out of range.
    """
    beta = np.zeros(3, np.int64) if velocity is None else np.asarray(velocity, dtype=np.int64).reshape(3)
    if np.abs(beta).max() > FASTEST:
        raise InputError("velocities over that of light are at most 2**-10 on each axis, as integers 2**20")
    years = int(epoch) - tables_epoch if epoch else 0
    if abs(years) > MOST_YEARS << EPOCH_BITS:
        raise InputError(
            f"a flight build takes frames within {MOST_YEARS} years of its tables, this one is "
            f"{years / (1 << EPOCH_BITS):.1f} years from them; epochs are Julian years times 65536"
        )
    return FlightObserver(beta, years)


def guide_motion(guide: GuideDatabase) -> Integers:
    """Motion (G, 3) of guide stars per year about their epoch, unit vectors of 29 fraction bits.

    Raises
    ------
    InputError
        For a star that moves by more than 12.6″ a year.
    """
    before, after = (guide.apparent_to(Observer(guide.epoch_jyear + years)) for years in (-_SPAN_YEARS, _SPAN_YEARS))
    yearly = (after.directions - before.directions) / (2.0 * _SPAN_YEARS)
    motion = np.rint(yearly * (1 << MOTION_BITS)).astype(np.int64)
    if len(motion) and np.abs(motion).max() > np.iinfo(np.int16).max:
        fastest = guide.catalog.id[np.abs(motion).max(axis=1).argmax()]
        raise InputError(f"guide star {fastest} moves by more than 12.6″ a year, a flight build does not hold that")
    return motion


def apparent(directions: Integers, motion: Integers, observer: FlightObserver) -> Integers:
    """Apparent directions (N, 3) of 2.30 of guide stars of these directions and motions (N, 3)."""
    moved = directions + ((motion * observer.years) >> (EPOCH_BITS + MOTION_BITS - 30))
    return aberrated(moved, observer.velocity) if observer.velocity.any() else moved
