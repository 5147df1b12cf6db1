"""Reference frames relative to GCRS (precession and nutation IAU 2006/2000A through ERFA), and local mean solar
time."""

from __future__ import annotations

import functools
import math

import erfa
import numpy as np

from simulator.mission.clock import Clock
from startracker.core import J2000_JD_TT, FloatArray
from startracker.ephemeris import timescale


def true_of_date(clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) from GCRS into the true equator and equinox of date; read-only.

    Frame bias, precession and nutation, IAU 2006/2000A (ERFA's ``pnm06a``); the neglected free core nutation is below
    0.4 mas, 1.5 cm at 800 km.
    """
    # Arrays cannot be keys of a cache, but their bytes and shape can.
    jd1, jd2 = clock.tt_jd(np.asarray(t_s, dtype=float))
    return _of_dates(jd1, np.shape(jd2), np.asarray(jd2).tobytes())


@functools.lru_cache(maxsize=8)  # takes 50 µs per instant, and orbit, node and frames need the same instants
def _of_dates(jd1: float, shape: tuple[int, ...], jd2: bytes) -> FloatArray:
    matrices = np.asarray(erfa.ufunc.pnm06a(jd1, np.frombuffer(jd2).reshape(shape)))
    matrices.flags.writeable = False
    return matrices


ECLIPTIC_OBLIQUITY_RAD = math.radians(84_381.448 / 3600.0)
"""Obliquity of the ecliptic at J2000, IAU 1976: the ecliptic of SPICE's frame ECLIPJ2000 and of JPL's Horizons."""


EARTH_RATE_RAD_S = 2.0 * math.pi * 1.002_737_811_911_354_48 / 86_400.0
"""Rate of the Earth rotation angle; IERS Conventions 2010, eq. 5.15."""


def to_frame(frame: str, clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Matrices from ICRF (GCRS) axes into named axes, (3, 3), or (..., 3, 3) for axes of date.

    Parameters
    ----------
    frame : str
        ``icrf``; ``equator_of_date``: true equator and equinox; ``ecliptic``: mean ecliptic and equinox of J2000;
        ``eme2000``: mean equator and equinox of J2000, 23 mas from ICRF (IAU 2006 frame bias); ``mean_of_date``: mean
        equator and equinox of date (IAU 2006, ERFA's ``pmat06``); ``teme``: SGP4's;
        ``itrf``: ITRS, from the true equator of date by Greenwich apparent sidereal time (IAU 2006/2000A, ERFA's
        ``gst06``), UT1 from Skyfield's table, without polar motion (0.6″, 19 m at the surface).
    clock, t_s
        The instants.
    """
    of_date = {
        "equator_of_date": true_of_date,
        "mean_of_date": _mean_of_date,
        "teme": teme,
        "itrf": _earth_fixed,
    }
    if frame in of_date:
        return of_date[frame](clock, t_s)
    if frame == "ecliptic":
        return np.asarray(erfa.ufunc.rx(ECLIPTIC_OBLIQUITY_RAD, np.eye(3)))
    if frame == "eme2000":
        return np.asarray(erfa.ufunc.bp06(J2000_JD_TT, 0.0)[0])
    return np.eye(3)


def _mean_of_date(clock: Clock, t_s: float | FloatArray) -> FloatArray:
    return np.asarray(erfa.ufunc.pmat06(*clock.tt_jd(t_s)))


def _earth_fixed(clock: Clock, t_s: float | FloatArray) -> FloatArray:
    # The nutation matrix gives gst06 the equation of the equinoxes; a rotation by GAST about the pole then leads from
    # the true equinox to the meridian of Greenwich.
    time = timescale().tt_jd(*clock.tt_jd(t_s))
    of_date = true_of_date(clock, t_s)
    gast = erfa.ufunc.gst06(time.whole, time.ut1_fraction, *clock.tt_jd(t_s), of_date)
    return np.asarray(erfa.ufunc.rz(gast, of_date))


def to_gcrs(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (..., 3) rotated to GCRS by the inverse of matrices (..., 3, 3) from GCRS."""
    # A row vector times a matrix is the transposed, that is the inverse matrix times the vector.
    rotated: FloatArray = (vectors[..., None, :] @ matrix)[..., 0, :]
    return rotated


def states_to_gcrs(
    frame: str, clock: Clock, t_s: FloatArray, r_km: FloatArray, v_km_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Positions and velocities (N, 3) in named axes at times (N,) rotated to ICRF (GCRS) axes.

    Parameters
    ----------
    frame : str
        As for `to_frame`. Axes of date are treated as inertial at each instant; to velocities in the Earth-fixed axes
        ``itrf`` the velocity of rotation ω × r is added.
    clock, t_s
        The instants.
    r_km, v_km_s : array, shape (N, 3)
        States.
    """
    if frame != "itrf":
        matrix = to_frame(frame, clock, t_s)
        return to_gcrs(matrix, r_km), to_gcrs(matrix, v_km_s)
    matrix = to_frame("itrf", clock, t_s)
    # ω × r in the Earth-fixed axes, whose z axis is the axis of rotation as polar motion is neglected.
    turning = np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r_km)
    return to_gcrs(matrix, r_km), to_gcrs(matrix, v_km_s + turning)


def equation_of_equinoxes(clock: Clock, t_s: float | FloatArray, matrix: FloatArray) -> FloatArray:
    """Equation of the equinoxes, radians: apparent minus mean sidereal time.

    Parameters
    ----------
    clock, t_s
        The instants.
    matrix : array, shape (..., 3, 3)
        Their `true_of_date`.

    Notes
    -----
    Mean sidereal time is the model of 1982, as in SGP4 (Vallado et al. 2006, AIAA 2006-6753, appendix C). The Earth's
    rotation cancels in the difference, so TT replaces UT1.
    """
    jd1, jd2 = clock.tt_jd(t_s)
    difference: FloatArray = erfa.anpm(erfa.gst06(jd1, jd2, jd1, jd2, matrix) - erfa.gmst82(jd1, jd2))
    return difference


def teme(clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) from GCRS into SGP4's true equator, mean equinox of date."""
    matrix = true_of_date(clock, t_s)
    rotated: FloatArray = erfa.rz(equation_of_equinoxes(clock, t_s, matrix), matrix)
    return rotated


def raan_of_local_time(clock: Clock, local_time_h: float, t_s: float = 0.0) -> float:
    """Right ascension, radians in [0, 2π), true equinox of date, of the meridian with a local *mean* solar time.

    Local mean solar time is UT1 + east longitude, and longitude is right ascension minus Greenwich apparent sidereal
    time (IAU 2006/2000A, ERFA's ``gst06a``; Urban & Seidelmann 2013, *Explanatory Supplement*, section 3.2):

        α = GAST + 15° (local time − UT1)

    UTC replaces UT1: they differ by less than 0.9 s, an error of 0.04″ in the position of the mean Sun.
    """
    utc1, utc2 = clock.utc_jd(t_s)
    midnight_fraction = (utc1 - 0.5) % 1.0 + utc2  # Julian days begin at noon
    gast = float(erfa.gst06a(utc1, utc2, *clock.tt_jd(t_s)))
    return float(erfa.anp(gast + 2.0 * math.pi * (local_time_h / 24.0 - midnight_fraction)))


def argument_of_latitude_deg(
    clock: Clock, t_s: float | FloatArray, r_km: FloatArray, v_km_s: FloatArray, frame: str = "equator_of_date"
) -> FloatArray:
    """Angle along the orbit from its ascending node on the reference plane of a frame, degrees in [0, 360).

    With h = r × v and n = z × h towards the node, u = atan2((h × n)·r / |h|, n·r) (Vallado 2013, section 2.5). For an
    equatorial orbit the angle is measured from the equinox.

    Parameters
    ----------
    clock, t_s
        The instants, a number or an array (N,).
    r_km, v_km_s : array, shape (3,) or (N, 3)
        States in GCRS.
    frame : str
        As for `to_frame`.
    """
    of_date = to_frame(frame, clock, t_s)
    r, v = ((of_date @ vector[..., None])[..., 0] for vector in (r_km, v_km_s))
    momentum = np.cross(r, v)
    node = np.stack([-momentum[..., 1], momentum[..., 0], np.zeros(momentum.shape[:-1])], axis=-1)
    # n = z × h has no direction for an equatorial orbit.
    node[~node.any(axis=-1)] = [1.0, 0.0, 0.0]
    ahead = np.sum(np.cross(momentum, node) * r, axis=-1) / np.linalg.norm(momentum, axis=-1)
    return np.asarray(np.degrees(np.arctan2(ahead, np.sum(node * r, axis=-1))) % 360.0)


def itrs_km(clock: Clock, t_s: float | FloatArray, r_km: FloatArray) -> FloatArray:
    """Positions in the rotating frame of the Earth, km, shape of `r_km`: ``itrf`` of `to_frame`.

    Parameters
    ----------
    clock, t_s
        The instants, a number or an array (N,).
    r_km : array, shape (3,) or (N, 3)
        Positions in GCRS.
    """
    return np.asarray((to_frame("itrf", clock, t_s) @ r_km[..., None])[..., 0])


def ground_track_deg(clock: Clock, t_s: float | FloatArray, r_km: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Geodetic latitude and east longitude in [−180, 180], degrees, WGS 84, of the point below the spacecraft, by
    `itrs_km` and ERFA's ``gc2gd``; parameters as there."""
    longitude, latitude, _, _ = erfa.ufunc.gc2gd(1, itrs_km(clock, t_s, r_km) * 1e3)  # 1: WGS 84
    return np.degrees(latitude), np.degrees(longitude)
