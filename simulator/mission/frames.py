"""Frames of date against GCRS, and the mean Sun: precession-nutation IAU 2006/2000A through ERFA."""

from __future__ import annotations

import functools
import math

import erfa
import numpy as np
from numpy.typing import NDArray

from simulator.interpolation import Nodes
from simulator.mission.clock import Clock

FloatArray = NDArray[np.float64]


def true_of_date(clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) from GCRS into the true equator and equinox of date.

    Frame bias, precession and nutation, IAU 2006/2000A (ERFA's ``pnm06a``); what the model leaves out of the pole's
    motion (free core nutation) is below 0.4 mas, 1.5 cm at 800 km. The matrix of a single instant is interpolated to
    1e-3 µas (`simulator.interpolation`), and read-only.
    """
    if np.ndim(t_s) == 0:
        return _matrix(*clock.tt_jd(float(t_s)))
    matrices: FloatArray = erfa.pnm06a(*clock.tt_jd(t_s))
    return matrices


@functools.lru_cache(maxsize=4)  # orbit and statistics ask for the same instant in turn
def _matrix(jd1: float, jd2: float) -> FloatArray:
    matrix: FloatArray = _PRECESSION_NUTATION.at(jd1, jd2).reshape(3, 3)
    matrix.flags.writeable = False
    return matrix


_PRECESSION_NUTATION = Nodes(lambda jd1, jd2: erfa.ufunc.pnm06a(jd1, jd2).ravel())


def equation_of_equinoxes(clock: Clock, t_s: float | FloatArray, matrix: FloatArray) -> FloatArray:
    """Right ascension, radians, of SGP4's mean equinox short of the true one: apparent minus mean sidereal time.

    Parameters
    ----------
    clock, t_s
        The instants.
    matrix : array, shape (..., 3, 3)
        Their `true_of_date`.

    Notes
    -----
    The mean sidereal time is that of 1982, to which SGP4 belongs (Vallado et al. 2006, AIAA 2006-6753, appendix C).
    Earth rotation drops out of the difference, so TT serves for UT1.
    """
    jd1, jd2 = clock.tt_jd(t_s)
    difference: FloatArray = erfa.anpm(erfa.gst06(jd1, jd2, jd1, jd2, matrix) - erfa.gmst82(jd1, jd2))
    return difference


def teme(clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) from GCRS into SGP4's true equator, mean equinox of date."""
    matrix = true_of_date(clock, t_s)
    turned: FloatArray = erfa.rz(equation_of_equinoxes(clock, t_s, matrix), matrix)
    return turned


def raan_of_local_time(clock: Clock, local_time_h: float, t_s: float = 0.0) -> float:
    """Right ascension, radians in [0, 2π), true equinox of date, of the meridian with a local *mean* solar time.

    Local mean solar time is UT1 + east longitude, and longitude is right ascension less Greenwich apparent sidereal
    time (IAU 2006/2000A, ERFA's ``gst06a``; Urban & Seidelmann 2013, *Explanatory Supplement*, section 3.2):

        α = GAST + 15° (local time − UT1)

    UTC serves for UT1: they differ by under 0.9 s, of which the mean Sun's motion leaves 0.04″ here.
    """
    utc1, utc2 = clock.utc_jd(t_s)
    midnight_fraction = (utc1 - 0.5) % 1.0 + utc2
    gast = float(erfa.gst06a(utc1, utc2, *clock.tt_jd(t_s)))
    return float(erfa.anp(gast + 2.0 * math.pi * (local_time_h / 24.0 - midnight_fraction)))


def local_time_of_raan(clock: Clock, raan_rad: float, t_s: float = 0.0) -> float:
    """Local mean solar time, hours in [0, 24), of a right ascension; undoes `raan_of_local_time`."""
    return (raan_rad - raan_of_local_time(clock, 0.0, t_s)) % (2.0 * math.pi) * 12.0 / math.pi % 24.0
