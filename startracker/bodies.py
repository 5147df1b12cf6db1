"""Directions of the Sun, the Moon and the planets at an epoch, to mark them on a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.constants import DAYS_PER_JULIAN_YEAR, J2000_JD_TT
from startracker.ephemeris import DE421_NAME, astrometric_au, barycentric, timescale
from startracker.observer import Observer, aberrate

__all__ = ["body_directions"]

FloatArray = NDArray[np.float64]


def body_directions(observer: Observer) -> dict[str, FloatArray]:
    """Unit vectors (3,), ICRS, of the bodies seen by an observer, with light time.

    Aberration is included if the velocity is known, as in the directions that a tracker is given.
    Without a position the observer is at the Earth's centre, from which the Moon is up to 1° away from where it is seen
    on the ground; it is then left out.

    Raises
    ------
    InputError
        If the ephemeris (DE421: 1899-07-29 to 2053-10-09) does not cover the epoch.
    """
    time = timescale().tt_jd(J2000_JD_TT + DAYS_PER_JULIAN_YEAR * (observer.epoch_jyear - 2000.0))
    earth_au = barycentric("Earth", time).xyz.au
    unknown = {"Earth"} if observer.position_au is not None else {"Earth", "Moon"}
    names = [name for name in DE421_NAME if name not in unknown]
    offsets = astrometric_au(names, time, earth_au if observer.position_au is None else observer.position_au)
    directions = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    if observer.velocity_km_s is not None:
        directions = aberrate(directions, observer.velocity_km_s)
    return dict(zip(names, directions, strict=True))
