"""Where the Sun, the Moon and the planets are: the JPL ephemeris DE421 that comes with ``skyfield-data``.

Folkner, Williams & Boggs 2009, "The Planetary and Lunar Ephemeris DE 421", IPN Progress Report 42-178. Its axes are
the ICRF to 1 mas; it covers 1899-07-29 to 2053-10-09.
"""

from __future__ import annotations

import functools
import math
import mmap
from importlib.resources import files
from typing import NamedTuple

import erfa
import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.interpolation import Nodes
from startracker.constants import AU_KM
from startracker.errors import InputError

__all__ = ["EARTH", "MOON", "SUN", "TARGETS", "Ephemeris", "ephemeris", "position", "position_au", "state", "tdb_jd"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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


_SECONDS_PER_DAY = 86_400.0
_J2000_JD = 2_451_545.0


class Ephemeris(NamedTuple):
    """DE421 as its kernels take it.

    Parameters
    ----------
    words : float array
        The whole file in words of eight bytes, read-only.
    segments : float array, shape (S, 5)
        Of each segment the word where it starts, the number of its records, the words of a record, the seconds from
        J2000 to the start of the first, and the seconds that each covers.
    routes : dict
        Rows of `segments`, shape (2,), from the barycentre to each body; −1 where one is enough.
    first_jd, last_jd : float
        Julian dates, TDB, that it covers.
    """

    words: FloatArray
    segments: FloatArray
    routes: dict[int, IntArray]
    first_jd: float
    last_jd: float


@functools.lru_cache(maxsize=4)  # all that asks for one instant asks for it in turn
def tdb_jd(tt_jd1: float, tt_jd2: float) -> tuple[float, float]:
    """Two-part Julian date TDB of one in TT.

    ERFA's ``eraDtdb`` (Fairhead & Bretagnon 1990) for the geocentre, interpolated (`simulator.interpolation`): good to
    3 ns; what the spacecraft's place adds, up to 2 µs, moves the Moon by 2 mm.
    """
    return tt_jd1, tt_jd2 + float(_TDB_LESS_TT_S.at(tt_jd1, tt_jd2)[0]) / _SECONDS_PER_DAY


_TDB_LESS_TT_S = Nodes(lambda jd1, jd2: np.array([erfa.ufunc.dtdb(jd1, jd2, 0.0, 0.0, 0.0, 0.0)]))


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
    de421 = ephemeris(*jd)
    both = np.empty((2, 3))
    _state(de421.words, de421.segments, de421.routes[target], jd[0], jd[1], both)
    return both[0], both[1]


def position_au(target: int, jd: tuple[float, float]) -> FloatArray:
    """Barycentric position (3,) of a body, au; arguments and errors as for `state`."""
    de421 = ephemeris(*jd)
    place = np.empty(3)
    position(de421.words, de421.segments, de421.routes[target], jd[0], jd[1], place)
    return place / AU_KM


def ephemeris(jd1: float, jd2: float, light_time_day: float = 0.0) -> Ephemeris:
    """DE421 for kernels, at a two-part date TDB and up to `light_time_day` before; `InputError` outside of it."""
    de421 = _de421()
    date = jd1 + jd2
    if not (de421.first_jd <= date - light_time_day and date <= de421.last_jd):
        raise InputError(
            f"the ephemeris DE421 covers the years 1899 to 2053; Julian date {date:.2f} (year "
            f"{2000 + (date - 2451545) / 365.25:.1f}) is outside: choose an epoch within"
        )
    return de421


@njit(cache=True, error_model="numpy")
def position(
    words: FloatArray, segments: FloatArray, route: IntArray, jd1: float, jd2: float, place: FloatArray
) -> None:
    """Kernel: barycentric position, km, into `place` (3,)."""
    place[:] = 0.0
    for leg in range(2):
        if route[leg] >= 0:
            first, count, s, _ = _record(segments[route[leg]], jd1, jd2)
            for axis in range(3):
                start = first + axis * count
                w0 = w1 = 0.0
                for k in range(count - 1, 0, -1):
                    w0, w1 = words[start + k] + (2.0 * s * w0 - w1), w0
                place[axis] += words[start] + (s * w0 - w1)


@njit(cache=True, error_model="numpy")
def _state(words: FloatArray, segments: FloatArray, route: IntArray, jd1: float, jd2: float, both: FloatArray) -> None:
    """Kernel: barycentric position, km, and velocity, km/s, into `both` (2, 3)."""
    both[:] = 0.0
    for leg in range(2):
        if route[leg] >= 0:
            first, count, s, length_s = _record(segments[route[leg]], jd1, jd2)
            for axis in range(3):
                start = first + axis * count
                w0 = w1 = dw0 = dw1 = 0.0
                for k in range(count - 1, 0, -1):
                    dw0, dw1 = 2.0 * w0 + (2.0 * s * dw0 - dw1), dw0
                    w0, w1 = words[start + k] + (2.0 * s * w0 - w1), w0
                both[0, axis] += words[start] + (s * w0 - w1)
                both[1, axis] += (w0 + s * dw0 - dw1) * 2.0 / length_s


@njit(cache=True, error_model="numpy")
def _record(segment: FloatArray, jd1: float, jd2: float) -> tuple[int, int, float, float]:
    """Where the coefficients of a date start, how many an axis has, the argument of the polynomials in −1 to 1, and
    the seconds that they span: Chebyshev series of position, SPK type 2 (NAIF, *SPK Required Reading*)."""
    length_s = segment[4]
    whole = (jd1 - _J2000_JD) * _SECONDS_PER_DAY - segment[3]
    part = jd2 * _SECONDS_PER_DAY
    index = math.floor(whole / length_s)
    offset = whole - index * length_s
    more = math.floor((offset + part) / length_s)
    index, offset = index + more, offset - more * length_s + part  # whole seconds first: they are exact
    last = int(segment[1]) - 1
    if index > last:  # the last instant belongs to the last record
        index, offset = last, offset + length_s
    size = int(segment[2])
    return int(segment[0]) + index * size + 2, (size - 2) // 3, 2.0 * offset / length_s - 1.0, length_s


@functools.cache
def _de421() -> Ephemeris:
    """The file, mapped into memory: of its 17 MB only the pages are read that a mission's dates need."""
    from jplephem.daf import DAF
    from jplephem.spk import SPK

    path = files("skyfield_data") / "data" / "de421.bsp"
    try:
        with path.open("rb") as file:
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        kernel = SPK(DAF(content))
        words = np.frombuffer(content, dtype=kernel.daf.endian + "f8").astype(np.float64, copy=False)
        rows: list[list[float]] = []
        routes: dict[int, IntArray] = {}
        for target, pairs in _ROUTES.items():
            routes[target] = np.full(2, -1)
            for leg, pair in enumerate(pairs):
                segment = kernel[pair]
                if segment.data_type != 2:
                    raise ValueError(f"segment {pair} is of type {segment.data_type}, not 2")
                start_s, length_s, size, count = words[segment.end_i - 4 : segment.end_i]
                routes[target][leg] = len(rows)
                rows.append([segment.start_i - 1, count, size, start_s, length_s])
        covered = kernel[_ROUTES[SUN][0]]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: the ephemeris cannot be read ({error}); install skyfield-data anew") from error
    return Ephemeris(words, np.array(rows), routes, covered.start_jd, covered.end_jd)
