"""Sun, Moon and planets as the spacecraft sees them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import erfa
import numpy as np
from numpy.typing import NDArray

from simulator.sky.ephemeris import SUN, TARGETS, position_au, tdb_jd
from simulator.sky.magnitudes import moon_v, planet_v, sun_v
from startracker.constants import AU_KM, SPEED_OF_LIGHT_KM_S
from startracker.errors import InputError
from startracker.observer import Observer, aberrate

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
    here, sun = observer.position_au, position_au(SUN, jd)
    seen = np.array([_geometric(target, jd, here) for target in TARGETS.values()])
    distance = np.linalg.norm(seen, axis=1)
    direction = seen / distance[:, None]
    from_sun = seen + here - sun

    v_mag = np.empty(len(TARGETS))
    lit = np.ones(len(TARGETS))
    for k, name in enumerate(TARGETS):
        if name == "Sun":
            v_mag[k] = sun_v(float(distance[k]))
            continue
        r = float(np.linalg.norm(from_sun[k]))
        cosine = float(np.clip(from_sun[k] @ direction[k] / r, -1.0, 1.0))
        lit[k] = (1.0 + cosine) / 2.0
        if name == "Moon":
            v_mag[k] = moon_v(r, float(distance[k]), math.degrees(math.acos(cosine)))
        else:
            v_mag[k] = planet_v(name, from_sun[k], seen[k], observer.epoch_jyear)

    if section.light_deflection:
        direction = _bend(direction, from_sun, here - sun, np.array([name != "Sun" for name in TARGETS]))
    if section.aberration and observer.velocity_km_s is not None:
        direction = aberrate(direction, observer.velocity_km_s)
    radius_au = np.array([RADIUS_KM[name] for name in TARGETS]) / AU_KM
    return Bodies(
        name=np.array(list(TARGETS)),
        direction=direction,
        distance_au=distance,
        v_mag=v_mag,
        angular_radius_rad=np.arcsin(np.minimum(radius_au / distance, 1.0)),
        illuminated_fraction=lit,
        b_v=np.array([B_V[name] for name in TARGETS]),
    )


def _geometric(target: int, jd: tuple[float, float], observer_au: FloatArray) -> FloatArray:
    """Vector (3,), au, from the observer now to the body when the light left it."""
    vector = position_au(target, jd) - observer_au
    for _ in range(_LIGHT_TIME_STEPS):
        delay = math.sqrt(float(vector @ vector)) * _AU_LIGHT_TIME_DAY
        vector = position_au(target, (jd[0], jd[1] - delay)) - observer_au
    return vector


def _bend(direction: FloatArray, from_sun: FloatArray, observer_from_sun: FloatArray, bent: FloatArray) -> FloatArray:
    """Directions (N, 3) with the Sun's deflection where `bent`."""
    out = direction.copy()
    em = math.sqrt(float(observer_from_sun @ observer_from_sun))
    for k in np.flatnonzero(bent):
        q = from_sun[k] / np.linalg.norm(from_sun[k])
        out[k] = erfa.ufunc.ld(1.0, direction[k], q, observer_from_sun / em, em, _DEFLECTION_LIMIT)
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True), dtype=np.float64)
