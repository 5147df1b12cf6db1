"""Sun, Moon and planets as the spacecraft sees them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.sky.ephemeris import SUN, TARGETS, ephemeris, position, position_au, tdb_jd
from simulator.sky.light import aberrated, bent, unit
from simulator.sky.magnitudes import PLANETS, moon_v, planet_v_by_number, sun_v
from startracker.constants import AU_KM, SPEED_OF_LIGHT_KM_S
from startracker.errors import InputError
from startracker.observer import Observer

if TYPE_CHECKING:
    from simulator.mission.clock import Clock
    from simulator.scenario.schema import SkySection

__all__ = ["B_V", "RADIUS_KM", "Bodies", "solar_system", "sun_position_au"]

FloatArray = NDArray[np.float64]

RADIUS_KM = {
    "Mercury": 2440.53,
    "Venus": 6051.8,
    "Mars": 3396.19,
    "Jupiter": 71492.0,
    "Saturn": 60268.0,
    "Uranus": 25559.0,
    "Neptune": 24764.0,
    "Moon": 1737.4,
    "Sun": 695_700.0,
}
"""Equatorial radii: IAU working group (Archinal et al. 2018); Sun: IAU 2015 Resolution B3."""

B_V = {
    "Mercury": 0.93,
    "Venus": 0.82,
    "Mars": 1.36,
    "Jupiter": 0.83,
    "Saturn": 1.04,
    "Uranus": 0.56,
    "Neptune": 0.41,
    "Moon": 0.92,
    "Sun": 0.65,
}
"""Colours, as in Cox 2000, *Allen's Astrophysical Quantities*, sections 12 and 14."""

_AU_LIGHT_TIME_DAY = AU_KM / SPEED_OF_LIGHT_KM_S / 86_400.0
_LIGHT_TIME_STEPS = 3
"""Each step shrinks the error, at first v τ = 24,000 km for Mercury, by v/c = 1.6e-4: after three it is 0.1 mm."""
_LONGEST_LIGHT_TIME_DAY = 0.2
_DEFLECTION_LIMIT = 1e-9
"""ERFA's limiter of ``eraLd``: deflection is held back within 9″ of the Sun's centre, behind its disc."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Sun, Moon and planets as columns of equal length; every array is read-only.

    Parameters
    ----------
    name : str array
        English name.
    direction : float array, shape (N, 3)
        Apparent unit vector of the centre, GCRS axes.
    distance_au : float array
        Distance when the light left.
    v_mag : float array
        Apparent V of the whole disc.
    angular_radius_rad : float array
        Apparent equatorial radius.
    illuminated_fraction : float array
        Lit share of the disc, 0 to 1.
    b_v : float array
        B − V.
    """

    name: NDArray[np.str_]
    direction: FloatArray
    distance_au: FloatArray
    v_mag: FloatArray
    angular_radius_rad: FloatArray
    illuminated_fraction: FloatArray
    b_v: FloatArray

    def __post_init__(self) -> None:
        for column in fields(self):
            array = np.array(getattr(self, column.name))
            array.flags.writeable = False
            object.__setattr__(self, column.name, array)

    def __len__(self) -> int:
        return len(self.name)

    def select(self, rows: NDArray[np.int64]) -> Bodies:
        """Some of them, by index array."""
        return Bodies(*(getattr(self, column.name)[rows] for column in fields(self)))


def sun_position_au(clock: Clock, t_s: float) -> FloatArray:
    """Barycentric position (3,) of the Sun's centre at this instant, au, ICRF axes; `InputError` outside DE421."""
    return position_au(SUN, tdb_jd(*clock.tt_jd(t_s)))


def solar_system(clock: Clock, t_s: float, observer: Observer, section: SkySection) -> Bodies:
    """Apparent places and photometry of Mercury to Neptune, Moon and Sun, from DE421.

    A body is where it was when its light left (light time iterated); the Sun bends the light of the others
    (``eraLd`` for a source at finite distance, Klioner 2003); aberration comes last. Jupiter and the planets beyond it
    stand for their systems' centres of mass (0.1″).

    Parameters
    ----------
    clock : Clock
        The scenario's clock.
    t_s : float
        Seconds since its epoch.
    observer : Observer
        From `observe`, at the same instant.
    section : SkySection
        Its switches `light_deflection` and `aberration` hold for the bodies too; without `planets` there are none.

    Raises
    ------
    InputError
        When the observer has no position, or the date lies outside DE421.
    """
    if not section.planets:
        nothing = np.zeros(0)
        return Bodies(np.zeros(0, dtype=str), np.zeros((0, 3)), nothing, nothing, nothing, nothing, nothing)
    if observer.position_au is None:
        raise InputError("the planets' places need the observer's barycentric position; make the observer by observe()")
    jd = tdb_jd(*clock.tt_jd(t_s))
    de421 = ephemeris(*jd, _LONGEST_LIGHT_TIME_DAY)
    moves = section.aberration and observer.velocity_km_s is not None
    direction = np.empty((len(TARGETS), 3))
    columns = np.empty((4, len(TARGETS)))
    _view(
        de421.words,
        de421.segments,
        _routes(),
        *jd,
        observer.position_au,
        np.zeros(3) if observer.velocity_km_s is None else observer.velocity_km_s,
        observer.epoch_jyear,
        section.light_deflection,
        moves,
        direction,
        columns,
    )
    return Bodies(_NAMES, direction, columns[0], columns[1], columns[2], columns[3], _COLOURS)


_NAMES = np.array(list(TARGETS))
_COLOURS = np.array([B_V[name] for name in TARGETS])
_RADII_AU = np.array([RADIUS_KM[name] for name in TARGETS]) / AU_KM
_NUMBERS = np.array([PLANETS.index(name) if name in PLANETS else -1 for name in TARGETS])
_SUN, _MOON = list(TARGETS).index("Sun"), list(TARGETS).index("Moon")


@functools.cache
def _routes() -> NDArray[np.int64]:
    """Segments of the ephemeris that lead to each of `TARGETS`, (N, 2)."""
    date = 2_451_545.0
    return np.stack([ephemeris(date, 0.0).routes[target] for target in TARGETS.values()])


@njit(cache=True, error_model="numpy")
def _view(
    words: FloatArray,
    segments: FloatArray,
    routes: NDArray[np.int64],
    jd1: float,
    jd2: float,
    here: FloatArray,
    velocity_km_s: FloatArray,
    epoch_jyear: float,
    bends: bool,
    moves: bool,
    direction: FloatArray,
    columns: FloatArray,
) -> None:
    """Kernel of `solar_system`: apparent directions (N, 3), and `columns` (4, N): distance in au, V, angular radius,
    illuminated fraction."""
    place, sun = np.empty(3), np.empty(3)
    seen, from_sun = np.empty(3), np.empty(3)
    position(words, segments, routes[_SUN], jd1, jd2, sun)
    sun /= AU_KM
    ex, ey, ez = here[0] - sun[0], here[1] - sun[1], here[2] - sun[2]
    to_sun = math.sqrt(ex * ex + ey * ey + ez * ez)
    e = unit(ex, ey, ez)
    velocity = (velocity_km_s[0], velocity_km_s[1], velocity_km_s[2])
    for k in range(len(routes)):
        delay = 0.0
        for _ in range(_LIGHT_TIME_STEPS + 1):
            position(words, segments, routes[k], jd1, jd2 - delay, place)
            square = 0.0
            for axis in range(3):
                seen[axis] = place[axis] / AU_KM - here[axis]
                square += seen[axis] * seen[axis]
            distance = math.sqrt(square)
            delay = distance * _AU_LIGHT_TIME_DAY
        p = (seen[0] / distance, seen[1] / distance, seen[2] / distance)
        lit = 1.0
        if k == _SUN:
            v = sun_v(distance)
        else:
            for axis in range(3):
                from_sun[axis] = seen[axis] + here[axis] - sun[axis]
            r = math.sqrt(from_sun[0] ** 2 + from_sun[1] ** 2 + from_sun[2] ** 2)
            q = (from_sun[0] / r, from_sun[1] / r, from_sun[2] / r)
            cosine = min(max(q[0] * p[0] + q[1] * p[1] + q[2] * p[2], -1.0), 1.0)
            lit = (1.0 + cosine) / 2.0
            if k == _MOON:
                v = moon_v(r, distance, math.degrees(math.acos(cosine)))
            else:
                v = planet_v_by_number(_NUMBERS[k], from_sun, seen, epoch_jyear)
            if bends:
                x, y, z = bent(p, q, e, to_sun, _DEFLECTION_LIMIT)
                p = unit(x, y, z)
        if moves:
            p = aberrated(p, velocity)
        direction[k, 0], direction[k, 1], direction[k, 2] = p
        columns[0, k], columns[1, k], columns[3, k] = distance, v, lit
        columns[2, k] = math.asin(min(_RADII_AU[k] / distance, 1.0))
