"""Positions of the spacecraft and of Sun, Moon and planets as it sees them, at a block of instants, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import erfa
import numpy as np
from numpy.typing import NDArray

from simulator.constants import RADIUS_KM
from simulator.mission.frames import argument_of_latitude_deg, ground_track_deg
from simulator.mission.trajectory import Trajectory, from_earth
from simulator.sky.apparent import aberrated
from simulator.sky.ephemeris import barycentric_position_au, barycentric_state, is_sunlit, sky_time
from simulator.sky.magnitudes import moon_v, planet_v, sun_v
from startracker.core import AU_KM, FloatArray
from startracker.display import fields_repr
from startracker.ephemeris import astrometric_au, barycentric
from startracker.errors import InputError
from startracker.observer import Observer

if TYPE_CHECKING:
    from simulator.mission.clock import Clock
    from simulator.sky.parameters import Sky

B_V = {
    "Mercury": 0.93,
    "Venus": 0.82,
    "Mars": 1.36,
    "Jupiter": 0.83,
    "Saturn": 1.04,
    "Uranus": 0.56,
    "Neptune": 0.41,
    "Earth": 0.20,
    "Moon": 0.92,
    "Sun": 0.65,
}
"""Colours, as in Cox 2000, *Allen's Astrophysical Quantities*, sections 12 and 14; spectra are in
`simulator.sky.albedo`."""

EARTH_DISK_KM = 1.0e6
"""Distance beyond which the Earth is one of the bodies, with magnitude and phase; its angular radius is then at most
0.37°. Nearer than this, `simulator.sky.earth` renders its surface and limb."""

_DEFLECTION_LIMIT = 1e-9
"""Limiter of ERFA's ``eraLd``: deflection is limited within 9″ of the Sun's centre, behind its disk."""

_ALL = tuple(RADIUS_KM)  # `bodies_seen_from` relies on the Moon and the Sun being the last two


@dataclass(frozen=True, eq=False)
class Bodies:
    """Sun, Moon and planets as columns.

    At one instant the columns have N rows; for a block of T instants those that change with time have a leading axis
    of T, and `at` gives the bodies of one of them."""

    name: NDArray[np.str_]
    """(N,): English name."""
    direction: FloatArray
    """(N, 3): Apparent unit vector of the centre, GCRS axes."""
    distance_au: FloatArray
    """(N,): Distance at the time of light emission."""
    v_mag: FloatArray
    """(N,): Apparent V of the whole disk, including its phase."""
    angular_radius_rad: FloatArray
    """(N,): Apparent equatorial radius."""
    illuminated_fraction: FloatArray
    """(N,): Illuminated fraction of the disk, 0 to 1."""
    b_v: FloatArray
    """(N,): B − V."""

    __repr__ = fields_repr

    def __len__(self) -> int:
        return len(self.name)

    def select(self, rows: NDArray[np.int64]) -> Bodies:
        """Selection of bodies by index array."""
        return Bodies(*(getattr(self, column.name)[rows] for column in fields(self)))

    def at(self, instant: int) -> Bodies:
        """The bodies at one instant of a block."""
        return Bodies(
            self.name,
            self.direction[instant],
            self.distance_au[instant],
            self.v_mag[instant],
            self.angular_radius_rad[instant],
            self.illuminated_fraction[instant],
            self.b_v,
        )


def sun_position_au(clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Barycentric position (3,) or (N, 3) of the Sun's centre, au, ICRF axes; `InputError` outside DE421."""
    return barycentric_position_au("Sun", clock, t_s)


def solar_system(clock: Clock, t_s: float, observer: Observer, sky: Sky) -> Bodies:
    """Apparent positions and photometry of Mercury to Neptune, Moon and Sun at one instant.

    Parameters
    ----------
    clock : Clock
        The scenario's clock.
    t_s : float
        Seconds since its epoch.
    observer : Observer
        From `observe`, at the same instant.
    sky : Sky
        As in `bodies_seen_from`.

    Raises
    ------
    InputError
        If the observer has no position, or the date is outside DE421.
    """
    if sky.planets and observer.position_au is None:
        raise InputError("the planets need the observer's barycentric position; create the observer with observe()")
    position = np.zeros(3) if observer.position_au is None else observer.position_au
    return bodies_seen_from(clock, t_s, position, observer.velocity_km_s, sky)


def bodies_seen_from(
    clock: Clock,
    t_s: float | FloatArray,
    position_au: FloatArray,
    velocity_km_s: FloatArray | None,
    sky: Sky,
) -> Bodies:
    """Apparent positions and photometry of Mercury to Neptune, Moon and Sun, and beyond `EARTH_DISK_KM` of the Earth,
    from DE421 by Skyfield and ERFA. In a block with instants on both sides of that distance the Earth is included.

    Positions include light time (Skyfield's ``observe``), light deflection by the Sun for the other bodies (``eraLd``
    for a source at finite distance, Klioner 2003) and aberration (``eraAb``). Skyfield's ``apparent`` is not used,
    because it cannot omit single effects as `Sky` can. Jupiter and the outer planets are represented by the barycentres
    of their systems (0.1″).

    Parameters
    ----------
    clock : Clock
        The scenario's clock.
    t_s : float or array, shape (T,)
        Seconds since its epoch.
    position_au, velocity_km_s : array, shape (3,) or (T, 3)
        Barycentric state of the observer; without a velocity there is no aberration.
    sky : Sky
        Its switches `light_deflection` and `aberration` also apply to bodies; without `planets` there are none, without
        `earth` no Earth.

    Raises
    ------
    InputError
        If a date is outside DE421.
    """
    if not sky.planets:
        nothing = np.zeros((*np.shape(t_s), 0))  # no bodies, with the leading axis of a block
        return Bodies(np.array(_ALL[:0]), np.zeros((*nothing.shape, 3)), *(nothing,) * 4, np.empty(0))
    time = sky_time(clock, t_s)
    earth_is_far = sky.earth and bool(is_far(position_au - barycentric("Earth", time).xyz.au.T).any())
    names = [name for name in _ALL if earth_is_far or name != "Earth"]
    sun = barycentric("Sun", time).xyz.au.T
    seen = astrometric_au(names, time, position_au)
    distance = np.linalg.norm(seen, axis=-1)
    direction = seen / distance[..., None]
    # Heliocentric vectors of all bodies but the Sun, which is the last one.
    from_sun = seen[..., :-1, :] + (position_au - sun)[..., None, :]
    sun_distance = np.linalg.norm(from_sun, axis=-1)
    cosine = np.clip(np.sum(from_sun * direction[..., :-1, :], axis=-1) / sun_distance, -1.0, 1.0)  # of the phase angle
    lit = np.ones(distance.shape)
    lit[..., :-1] = (1.0 + cosine) / 2.0
    if sky.light_deflection:
        unit = from_sun / sun_distance[..., None]
        direction[..., :-1, :] = _deflected(direction[..., :-1, :], unit, position_au - sun)
    if sky.aberration and velocity_km_s is not None:
        direction = aberrated(direction, velocity_km_s[..., None, :])
    year, planets = clock.jyear(t_s), names[:-2]
    columns = [planet_v(name, from_sun[..., k, :], seen[..., k, :], year) for k, name in enumerate(planets)]
    phase_deg = np.degrees(np.arccos(cosine[..., -1]))
    columns += [moon_v(sun_distance[..., -1], distance[..., -2], phase_deg), sun_v(distance[..., -1])]
    radius = np.arcsin(np.minimum(np.array([RADIUS_KM[name] for name in names]) / AU_KM / distance, 1.0))
    arrays = (direction, distance, np.stack(columns, axis=-1), radius, lit)
    for array in arrays:  # all frames of a block share these arrays
        array.flags.writeable = False
    return Bodies(np.array(names), *arrays, np.array([B_V[name] for name in names]))


def is_far(from_earth_au: FloatArray) -> NDArray[np.bool_]:
    """Whether the Earth is one of the bodies, at positions (..., 3) of the observer relative to it."""
    return np.asarray(np.linalg.norm(from_earth_au, axis=-1) * AU_KM >= EARTH_DISK_KM)


def _deflected(direction: FloatArray, from_sun: FloatArray, observer_au: FloatArray) -> FloatArray:
    """Directions (..., N, 3) of bodies deflected by the Sun, from their directions (..., N, 3) as seen from the Sun and
    the position (..., 3) of the observer relative to it."""
    distance = np.linalg.norm(observer_au, axis=-1, keepdims=True)[..., None]
    away = observer_au[..., None, :] / distance
    # eraLd takes the mass of the deflector in solar masses, and the directions from it to the source and the observer.
    bent = erfa.ufunc.ld(1.0, direction, from_sun, away, distance[..., 0], _DEFLECTION_LIMIT)
    return np.asarray(bent / np.linalg.norm(bent, axis=-1, keepdims=True))


@dataclass(frozen=True, eq=False)
class Instant:
    """One row of `Instants`, in the same units."""

    t_s: float
    r_km: FloatArray
    v_km_s: FloatArray
    r_centre_km: FloatArray
    v_centre_km_s: FloatArray
    observer: Observer
    sun_au: FloatArray
    bodies: Bodies
    orbit_argument_deg: float
    latitude_deg: float
    longitude_deg: float
    sunlit: bool


@dataclass(frozen=True, eq=False)
class Instants:
    """Ephemerides of a mission at T instants, computed together, because Skyfield and ERFA take about 50 µs per instant
    of a block but milliseconds for a single one."""

    t_s: FloatArray
    """(T,): Seconds after the epoch."""
    epoch_jyear: FloatArray
    """(T,): Julian epochs, TT."""
    r_km: FloatArray
    """(T, 3): Geocentric position, GCRS."""
    v_km_s: FloatArray
    """(T, 3): Geocentric velocity, GCRS."""
    r_centre_km: FloatArray
    """(T, 3): Position relative to the centre of the trajectory, to which the local level refers; identical to `r_km`
    for an orbit around the Earth."""
    v_centre_km_s: FloatArray
    """(T, 3): Velocity relative to that centre."""
    position_au: FloatArray
    """(T, 3): Barycentric position, ICRS."""
    velocity_km_s: FloatArray
    """(T, 3): Barycentric velocity, ICRS."""
    sun_au: FloatArray
    """(T, 3): Barycentric position of the Sun."""
    bodies: Bodies
    """Sun, Moon and planets, with a leading axis of T."""
    orbit_argument_deg: FloatArray
    """(T,): Argument of latitude: from the true equator of date around the Earth, otherwise from the ecliptic."""
    latitude_deg: FloatArray
    """(T,): Geodetic latitude of the point below the spacecraft."""
    longitude_deg: FloatArray
    """(T,): East longitude of that point, in [−180, 180]."""
    sunlit: NDArray[np.bool_]
    """(T,): Whether the spacecraft is outside the shadow of the Earth and of the trajectory's centre."""

    @classmethod
    def of(cls, orbit: Trajectory, t_s: FloatArray, sky: Sky) -> Instants:
        """Ephemerides along a trajectory; `InputError` if a time is outside it, or a date outside DE421."""
        clock = orbit.clock
        centred = orbit.state(t_s)
        r_km, v_km_s = from_earth(orbit, t_s, *centred)
        position_au, velocity_km_s = barycentric_state(clock, t_s, r_km, v_km_s)
        sun_au = sun_position_au(clock, t_s)
        # Arguments of latitude refer to the plane in which orbits around the centre are usually described.
        plane = "equator_of_date" if orbit.centre == "Earth" else "ecliptic"
        return cls(
            t_s,
            clock.jyear(t_s),
            r_km,
            v_km_s,
            *centred,
            position_au,
            velocity_km_s,
            sun_au,
            bodies_seen_from(clock, t_s, position_au, velocity_km_s, sky),
            argument_of_latitude_deg(clock, t_s, *centred, plane),
            *ground_track_deg(clock, t_s, r_km),
            is_sunlit(clock, t_s, r_km) & ~_in_shadow(orbit.centre, centred[0], (sun_au - position_au) * AU_KM),
        )

    def _bodies_at(self, k: int) -> Bodies:
        """Bodies at instant `k`."""
        # In a block the Earth is included at every instant if it is far at any; near it is rendered by `sky.earth`.
        bodies = self.bodies.at(k)
        earth = bodies.name == "Earth"
        return bodies if not earth.any() or is_far(self.r_km[k] / AU_KM) else bodies.select(np.flatnonzero(~earth))

    def at(self, k: int) -> Instant:
        """Instant `k`."""
        return Instant(
            float(self.t_s[k]),
            self.r_km[k],
            self.v_km_s[k],
            self.r_centre_km[k],
            self.v_centre_km_s[k],
            Observer(float(self.epoch_jyear[k]), self.velocity_km_s[k], self.position_au[k]),
            self.sun_au[k],
            self._bodies_at(k),
            float(self.orbit_argument_deg[k]),
            float(self.latitude_deg[k]),
            float(self.longitude_deg[k]),
            bool(self.sunlit[k]),
        )


def _in_shadow(centre: str, r_km: FloatArray, to_sun_km: FloatArray) -> NDArray[np.bool_]:
    """Whether the central body of a trajectory, a sphere, hides the centre of the Sun from positions (T, 3) relative to
    it; False for the Sun itself and for the Earth, which `is_sunlit` treats."""
    if centre in ("Earth", "Sun") or centre not in RADIUS_KM:
        return np.zeros(len(r_km), dtype=bool)
    sun = to_sun_km / np.linalg.norm(to_sun_km, axis=-1, keepdims=True)
    # In shadow, the ray towards the Sun passes the centre ahead (`along` > 0) at less than the radius.
    along = -np.sum(r_km * sun, axis=-1)
    passes = np.linalg.norm(r_km + along[:, None] * sun, axis=-1)
    return np.asarray((along > 0.0) & (passes < RADIUS_KM[centre]))
