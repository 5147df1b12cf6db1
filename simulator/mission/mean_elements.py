"""Mean elements of two-line elements and orbit mean-elements messages, propagated by SGP4."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import erfa
import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.clock import SECONDS_PER_DAY, Clock
from simulator.mission.frames import teme, to_gcrs
from simulator.mission.trajectory import refuse_outside
from startracker.core import FloatArray
from startracker.errors import InputError

SGP4_EPOCH_JD = 2_433_281.5
"""Julian date from which SGP4 counts days: 1949-12-31 00:00 UTC."""


class MeanElements(NamedTuple):
    """One set of elements in the units of SGP4 (radians, radians per minute, days), axes of TEME."""

    name: str
    """Name of the object; may be empty."""
    number: str
    """Catalogue number."""
    position: str
    """File and line, for messages."""
    epoch_jd: tuple[float, float]
    """Two-part Julian date UTC."""
    bstar: float
    """Drag term, 1/Earth radii."""
    eccentricity: float
    periapsis_rad: float
    inclination_rad: float
    mean_anomaly_rad: float
    mean_motion_rad_min: float
    """Kozai's mean motion."""
    node_rad: float
    designator: str = ""
    """International designator, such as ``1998-067A``; empty where the set has none."""


@dataclass(frozen=True)
class MeanElementsOrbit:
    """Orbit of mean elements, propagated by SGP4 (SDP4 for periods above 225 minutes; Vallado et al. 2006; python-sgp4
    with the constants of WGS 72) and rotated from TEME to GCRS.

    In a low orbit the error is about 1 km at the epoch and grows by 1 to 3 km per day (Vallado et al. 2006). Times are
    therefore limited to `max_age_days` from the epoch of the elements."""

    elements: MeanElements
    """The set of elements."""
    clock: Clock
    """Epoch of the times, which may differ from that of the elements."""
    max_age_days: float
    """Longest time from the epoch of the elements."""

    centre = "Earth"

    @property
    def object_id(self) -> str:
        """International designator of the object; empty where the elements have none."""
        return self.elements.designator

    @functools.cached_property
    def _epoch_s(self) -> float:
        return epoch_s(self.elements, self.clock)

    @property
    def span_s(self) -> tuple[float, float]:
        """`max_age_days` before and after the epoch of the elements."""
        age_s = self.max_age_days * SECONDS_PER_DAY
        return self._epoch_s - age_s, self._epoch_s + age_s

    @property
    def period_s(self) -> float:
        """Nodal period from SGP4's secular rates of mean anomaly and perigee."""
        satellite = _satellite(self.elements)
        return 60.0 * 2.0 * math.pi / float(satellite.mdot + satellite.argpdot)

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, in GCRS at seconds since the clock's epoch, shape (...).

        Raises
        ------
        InputError
            Outside the span, or if SGP4 reports an error (a decayed orbit, diverging elements).
        """
        t = np.asarray(t_s, dtype=float)
        what = f"{self.elements.position}: the set of elements with orbit.max_age_days = {self.max_age_days:g}"
        refuse_outside(self.clock, t, self.span_s, what)
        try:
            return sgp4_state(_satellite(self.elements), self.clock, t, self._epoch_s)
        except InputError as error:
            raise InputError(f"{self.elements.position}: SGP4 stops: {error}") from None


def epoch_s(elements: MeanElements, clock: Clock) -> float:
    """Epoch of a set of elements, SI seconds after the clock's epoch."""
    # Elements count days of 86,400 s, whereas ERFA's quasi Julian date stretches a day that has a leap second, so
    # TAI − UTC is added explicitly. A leap second itself has a day fraction of 1 or more, and belongs to the day it
    # ends.
    day, part = elements.epoch_jd
    year, month, date, _, _ = erfa.ufunc.jd2cal(day, 0.0)
    leap_s, _ = erfa.ufunc.dat(year, month, date, min(part, 1.0))
    tt1, tt2, _ = erfa.ufunc.taitt(day, part + leap_s / SECONDS_PER_DAY)
    first1, first2 = clock.tt_jd(0.0)
    return float(((tt1 - first1) + (tt2 - first2)) * SECONDS_PER_DAY)


@functools.lru_cache(maxsize=64)
def _satellite(elements: MeanElements) -> Any:
    """SGP4's record. It is cached here and not in the orbit because it cannot be pickled."""
    return sgp4_record(elements)


def sgp4_record(elements: MeanElements) -> Any:
    """SGP4's record of a set of elements, python-sgp4's ``Satrec``."""
    day, part = elements.epoch_jd
    return sgp4_satellite(
        "WGS72",
        (day - SGP4_EPOCH_JD) + part,
        mean_motion_rad_min=elements.mean_motion_rad_min,
        inclination_rad=elements.inclination_rad,
        node_rad=elements.node_rad,
        mean_anomaly_rad=elements.mean_anomaly_rad,
        eccentricity=elements.eccentricity,
        periapsis_rad=elements.periapsis_rad,
        bstar=elements.bstar,
    )


def sgp4_satellite(
    gravity: str,
    epoch_days: float,
    *,
    mean_motion_rad_min: float,
    inclination_rad: float,
    node_rad: float,
    mean_anomaly_rad: float,
    eccentricity: float = 0.0,
    periapsis_rad: float = 0.0,
    bstar: float = 0.0,
) -> Any:
    """SGP4's record of elements as in `MeanElements`, circular and without drag by default.

    Parameters
    ----------
    gravity : str
        The constants: ``WGS72``, with which published elements are made, or ``WGS84``.
    epoch_days : float
        Epoch of the elements, days after `SGP4_EPOCH_JD`.
    """
    from sgp4 import api

    satellite = api.Satrec()
    satellite.sgp4init(
        getattr(api, gravity),
        "i",  # SGP4's improved mode of operation
        0,  # catalogue number, which has no effect on the propagation
        epoch_days,
        bstar,
        0.0,  # first and second derivative of the mean motion, which SGP4 does not use
        0.0,
        eccentricity,
        periapsis_rad,
        inclination_rad,
        mean_anomaly_rad,
        mean_motion_rad_min,
        node_rad,
    )
    return satellite


def sgp4_state(satellite: Any, clock: Clock, t_s: FloatArray, epoch_s: float) -> tuple[FloatArray, FloatArray]:
    """Position (..., 3), km, and velocity (..., 3), km/s, in GCRS at seconds `t_s` of the clock.

    Parameters
    ----------
    satellite : sgp4.api.Satrec
        SGP4's record.
    clock : Clock
        Gives the rotation from TEME.
    t_s : array
        Times, seconds after the clock's epoch.
    epoch_s : float
        Epoch of the elements, seconds after the clock's epoch.

    Raises
    ------
    InputError
        SGP4's reason, if it stops (a decayed orbit, diverging elements).
    """
    # SGP4 subtracts the epoch of the elements again, so only elapsed SI seconds matter, and leap seconds do not.
    days = satellite.jdsatepochF + (t_s.ravel() - epoch_s) / SECONDS_PER_DAY
    error, position, velocity = satellite.sgp4_array(np.full(days.shape, satellite.jdsatepoch), days)
    if error.any():
        from sgp4.api import SGP4_ERRORS

        raise InputError(SGP4_ERRORS[int(error[error != 0][0])])
    matrix = teme(clock, t_s)
    return to_gcrs(matrix, position.reshape(*t_s.shape, 3)), to_gcrs(matrix, velocity.reshape(*t_s.shape, 3))
