"""A block of instants of a mission: positions of the spacecraft, the Sun, the Moon and the planets, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.mission.frames import argument_of_latitude_deg, ground_track_deg
from simulator.mission.orbit import Orbit
from simulator.sky.observer import barycentric_state, is_sunlit
from simulator.sky.solar_system import Bodies, bodies_seen_from, sun_position_au
from startracker.observer import Observer

if TYPE_CHECKING:
    from simulator.sky.parameters import Sky

__all__ = ["Instant", "Instants"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Instant:
    """One row of `Instants`, in the same units."""

    t_s: float
    r_km: FloatArray
    v_km_s: FloatArray
    observer: Observer
    sun_au: FloatArray
    bodies: Bodies
    orbit_argument_deg: float
    latitude_deg: float
    longitude_deg: float
    sunlit: bool


@dataclass(frozen=True, eq=False)
class Instants:
    """Ephemerides of a mission at T instants, computed together: Skyfield and ERFA take about 50 µs per instant in a
    block, and milliseconds for a single one."""

    t_s: FloatArray
    """(T,): Seconds after the epoch."""
    epoch_jyear: FloatArray
    """(T,): Julian epochs, TT."""
    r_km: FloatArray
    v_km_s: FloatArray
    """(T, 3): Geocentric state, GCRS."""
    position_au: FloatArray
    velocity_km_s: FloatArray
    """(T, 3): Barycentric state, ICRS."""
    sun_au: FloatArray
    """(T, 3): Barycentric position of the Sun."""
    bodies: Bodies
    """Bodies at T instants."""
    orbit_argument_deg: FloatArray
    """(T,): Argument of latitude."""
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    """(T,): Ground track: geodetic latitude, east longitude in [−180, 180]."""
    sunlit: NDArray[np.bool_]
    """(T,): Whether the spacecraft is outside the Earth's shadow."""

    @classmethod
    def of(cls, orbit: Orbit, t_s: FloatArray, sky: Sky) -> Instants:
        """Ephemerides along an orbit; `InputError` if a date is outside DE421."""
        clock = orbit.clock
        r_km, v_km_s = orbit.state(t_s)
        position_au, velocity_km_s = barycentric_state(clock, t_s, r_km, v_km_s)
        return cls(
            t_s,
            clock.jyear(t_s),
            r_km,
            v_km_s,
            position_au,
            velocity_km_s,
            sun_position_au(clock, t_s),
            bodies_seen_from(clock, t_s, position_au, velocity_km_s, sky),
            argument_of_latitude_deg(clock, t_s, r_km, v_km_s),
            *ground_track_deg(clock, t_s, r_km),
            is_sunlit(clock, t_s, r_km),
        )

    def at(self, k: int) -> Instant:
        """Instant `k`."""
        return Instant(
            float(self.t_s[k]),
            self.r_km[k],
            self.v_km_s[k],
            Observer(float(self.epoch_jyear[k]), self.velocity_km_s[k], self.position_au[k]),
            self.sun_au[k],
            self.bodies.at(k),
            float(self.orbit_argument_deg[k]),
            float(self.latitude_deg[k]),
            float(self.longitude_deg[k]),
            bool(self.sunlit[k]),
        )
