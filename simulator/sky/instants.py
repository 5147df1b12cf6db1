"""Ephemerides of the spacecraft, the Sun, the Moon and the planets at a block of instants, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.constants import RADIUS_KM
from simulator.mission.frames import argument_of_latitude_deg, ground_track_deg
from simulator.mission.trajectory import Trajectory, from_earth
from simulator.sky.ephemeris import barycentric_state, is_sunlit
from simulator.sky.solar_system import Bodies, bodies_seen_from, is_far, sun_position_au
from startracker.core import AU_KM, FloatArray
from startracker.observer import Observer

if TYPE_CHECKING:
    from simulator.sky.parameters import Sky


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
