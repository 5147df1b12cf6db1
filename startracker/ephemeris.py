"""Positions of Sun, Moon and planets: Skyfield with the JPL ephemeris DE421 of ``skyfield-data``.

Folkner, Williams & Boggs 2009, "The Planetary and Lunar Ephemeris DE 421", IPN Progress Report 42-178. Its axes are
the ICRF to 1 mas; it covers 1899-07-29 to 2053-10-09. Skyfield's TDB is accurate to 10 µs, in which the Earth moves
0.3 m.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from startracker.core import DAYS_PER_JULIAN_YEAR, J2000_JD_TT, FloatArray
from startracker.errors import InputError

DE421_NAME = {
    "Mercury": "mercury",
    "Venus": "venus",
    "Mars": "mars",
    "Jupiter": "jupiter barycenter",
    "Saturn": "saturn barycenter",
    "Uranus": "uranus barycenter",
    "Neptune": "neptune barycenter",
    "Moon": "moon",
    "Sun": "sun",
    "Earth": "earth",
}
"""Name of each body in the ephemeris. For Jupiter to Neptune it is the barycentre with the moons, within 0.1″ of the
planet."""

DE421_BARYCENTRES = {"Earth-Moon barycentre": "earth barycenter", "Pluto barycentre": "pluto barycenter"}
"""Points of the ephemeris that are not bodies, with their names in it."""

DE421_SPAN_JD = (2_414_864.5, 2_471_184.5)
"""First and last Julian date of the ephemeris."""


def de421_file() -> Path:
    """The file of the ephemeris."""
    return Path(str(files("skyfield_data") / "data" / "de421.bsp"))


def outside_ephemeris(jd: float) -> str:
    """Message about a date outside the ephemeris."""
    return (
        f"the ephemeris DE421 covers 1899-07-29 to 2053-10-09; Julian date {jd:.2f} (year "
        f"{2000 + (jd - J2000_JD_TT) / DAYS_PER_JULIAN_YEAR:.1f}) is outside: choose an epoch within"
    )


@functools.cache
def de421() -> Any:
    """The ephemeris as Skyfield's ``SpiceKernel``; memory-mapped, so that only the pages in use are read.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    from skyfield.jpllib import SpiceKernel

    path = de421_file()
    try:
        return SpiceKernel(str(path))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: the ephemeris cannot be read ({error}); reinstall skyfield-data") from error


@functools.cache
def timescale() -> Any:
    """Skyfield's time scale from the tables included in Skyfield: nothing is downloaded."""
    from skyfield.api import load

    return load.timescale(builtin=True)


def barycentric(body: str, time: Any) -> Any:
    """Skyfield's ``Barycentric`` position of a body of `DE421_NAME`, or of a point of `DE421_BARYCENTRES`.

    Raises
    ------
    InputError
        If a date is outside the ephemeris.
    """
    from skyfield.errors import EphemerisRangeError

    try:
        return de421()[(DE421_NAME | DE421_BARYCENTRES)[body]].at(time)
    except EphemerisRangeError:
        farthest = max(np.atleast_1d(time.tdb), key=lambda jd: abs(jd - J2000_JD_TT))
        raise InputError(outside_ephemeris(farthest)) from None


def astrometric_au(bodies: Iterable[str], time: Any, position_au: FloatArray) -> FloatArray:
    """Vectors from the observer to the positions of bodies at the times of light emission: Skyfield's ``observe``.

    Parameters
    ----------
    bodies : iterable of str
        N names of `DE421_NAME`.
    time : skyfield Time
        One, or T of them; within the ephemeris.
    position_au : array, shape (3,) or (T, 3)
        Barycentric position of the observer.

    Returns
    -------
    array, shape (N, 3) or (T, N, 3)
        ICRF axes, au.
    """
    from skyfield.positionlib import Barycentric

    here = Barycentric(position_au.T, np.zeros(position_au.T.shape), time)
    return np.stack([here.observe(de421()[DE421_NAME[name]]).xyz.au.T for name in bodies], axis=-2)
