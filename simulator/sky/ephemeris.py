"""Where the Sun, the Moon and the planets are: the JPL ephemeris DE421 that comes with ``skyfield-data``.

Folkner, Williams & Boggs 2009, "The Planetary and Lunar Ephemeris DE 421", IPN Progress Report 42-178. Its axes are
the ICRF to 1 mas; it covers 1899-07-29 to 2053-10-09.
"""

from __future__ import annotations

import functools
import io
from importlib.resources import files
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from startracker.constants import AU_KM
from startracker.errors import InputError

__all__ = ["EARTH", "MOON", "SUN", "TARGETS", "position_au", "state", "tdb_jd"]

FloatArray = NDArray[np.float64]

SUN, EARTH, MOON = 10, 399, 301

TARGETS = {
    "Mercury": 199,
    "Venus": 299,
    "Mars": 499,
    "Jupiter": 5,
    "Saturn": 6,
    "Uranus": 7,
    "Neptune": 8,
    "Moon": MOON,
    "Sun": SUN,
}
"""NAIF number of each body. Jupiter to Neptune: the centre of mass with the moons, within 0.1″ of the planet's own."""

_ROUTES = {
    SUN: ((0, 10),),
    EARTH: ((0, 3), (3, 399)),
    MOON: ((0, 3), (3, 301)),
    199: ((0, 1), (1, 199)),
    299: ((0, 2), (2, 299)),
    499: ((0, 4), (4, 499)),
    5: ((0, 5),),
    6: ((0, 6),),
    7: ((0, 7),),
    8: ((0, 8),),
}
"""Segments (centre, target) from the barycentre of the solar system to each body."""


def tdb_jd(tt_jd1: float, tt_jd2: float) -> tuple[float, float]:
    """Two-part Julian date TDB of one in TT.

    ERFA's ``eraDtdb`` (Fairhead & Bretagnon 1990) for the geocentre: good to 3 ns; what the spacecraft's place adds,
    up to 2 µs, moves the Moon by 2 mm.
    """
    return tt_jd1, tt_jd2 + float(erfa.ufunc.dtdb(tt_jd1, tt_jd2, 0.0, 0.0, 0.0, 0.0)) / 86_400.0


def state(target: int, jd: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Barycentric position (3,), km, and velocity (3,), km/s, of a body, ICRF axes.

    Parameters
    ----------
    target : int
        NAIF number, one of `TARGETS` or 399 (Earth).
    jd : tuple of float
        Two-part Julian date, TDB.

    Raises
    ------
    InputError
        When the date lies outside the ephemeris.
    """
    position, velocity = np.zeros(3), np.zeros(3)
    for segment in _route(target, jd):
        r_km, v_km_day = segment.compute_and_differentiate(*jd)
        position += r_km
        velocity += v_km_day
    return position, velocity / 86_400.0


def position_au(target: int, jd: tuple[float, float]) -> FloatArray:
    """Barycentric position (3,) of a body, au; arguments and errors as for `state`."""
    position = np.zeros(3)
    for segment in _route(target, jd):
        position += segment.compute(*jd)
    return position / AU_KM


def _route(target: int, jd: tuple[float, float]) -> list[Any]:
    kernel = _kernel()
    segments = [kernel[pair] for pair in _ROUTES[target]]
    first, last = segments[0].start_jd, segments[0].end_jd
    date = jd[0] + jd[1]
    if not first <= date <= last:
        raise InputError(
            f"the ephemeris DE421 covers the years 1899 to 2053; Julian date {date:.2f} (year "
            f"{2000 + (date - 2451545) / 365.25:.1f}) is outside: choose an epoch within"
        )
    return segments


@functools.cache
def _kernel() -> Any:
    """DE421, read once a process: held in memory, so that forks share no file and none is left open."""
    from jplephem.daf import DAF
    from jplephem.spk import SPK

    path = files("skyfield_data") / "data" / "de421.bsp"
    try:
        return SPK(DAF(io.BytesIO(path.read_bytes())))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: the ephemeris cannot be read ({error}); install skyfield-data anew") from error
