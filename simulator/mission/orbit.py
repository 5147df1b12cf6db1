"""Circular orbits around the Earth, by an analytic J2 model or by SGP4.

Elements refer to the true equator and equinox of date, because the Earth's oblateness makes the orbit precess about the
true pole; states are converted to GCRS by precession and nutation (`simulator.mission.frames`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from simulator.constants import EARTH_J2, EARTH_RADIUS_KM
from simulator.mission.clock import SECONDS_PER_DAY, Clock
from simulator.mission.frames import equation_of_equinoxes, raan_of_local_time, to_gcrs, true_of_date
from simulator.mission.mean_elements import sgp4_satellite, sgp4_state
from simulator.mission.parameters import OrbitParameters
from simulator.mission.secular import (
    CircularElements,
    latitude_rate,
    mean_motion,
    nodal_rate,
    sun_synchronous_inclination,
)
from simulator.mission.trajectory import UNLIMITED, Trajectory
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.settings.registry import lookup

DEFAULT_LTAN_H = 22.5
"""Local mean solar time of the ascending node if the section gives no node: 22:30 (descending node at 10:30), within 3°
of Sunsat's node (Greyling 1995, Table 3.2: Ω = 155° at the vernal equinox)."""

SPHERE_OF_INFLUENCE_KM = 925_000.0
"""Radius of the Earth's sphere of influence, a⊕ (m⊕/m☉)^(2/5); beyond it the Sun dominates."""

SMALLEST_RADIUS_EARTHS = 0.5
"""Minimum radius, in Earth radii, for which the J2 expansion is meaningful. The scenario's own limit is the surface,
which `allow_unphysical` lifts."""


@runtime_checkable
class Orbit(Trajectory, Protocol):
    """Circular orbit around the Earth, the result of a propagator; `period_s` is the mean nodal period."""

    @property
    def inclination_rad(self) -> float:
        """Mean inclination to the true equator of date."""
        ...

    @property
    def nodal_rate_rad_s(self) -> float:
        """Secular rate of the ascending node, positive to the east."""
        ...

    def raan_rad(self, t_s: ArrayLike) -> Any:
        """Mean right ascension of the ascending node in [0, 2π), true equator and equinox of date, shape of `t_s`."""
        ...


@dataclass(frozen=True)
class J2Orbit:
    """Analytic circular orbit whose node and argument of latitude advance at their secular J2 rates.

    With P towards the node, Q 90° ahead of it in the orbital plane, u = u₀ + u̇ t and Ω = Ω₀ + Ω̇ t:

        r = a (P cos u + Q sin u),   v = a (u̇ + Ω̇ cos i) (−P sin u + Q cos u)

    v is the derivative of r without the cross-track term Ω̇ sin i cos u · a (1.4 m/s at 800 km). That term is neglected
    together with the short-period terms of J2, which are of the same size, so that the plane of r and v is the mean
    plane. Also neglected: the mean radius' own J2 offset (+4.3 km at 800 km), the eccentricity of 1e-3 forced by J3,
    J4, drag, Sun and Moon. The position is therefore accurate to about 20 km near the epoch, the attitude of the local
    level to 0.1°."""

    elements: CircularElements
    """Mean elements at the epoch."""
    clock: Clock
    """Epoch."""

    centre, span_s = "Earth", UNLIMITED

    @functools.cached_property
    def _latitude_rate(self) -> float:
        return latitude_rate(self.elements.semi_major_axis_km, self.elements.inclination_rad)

    @property
    def period_s(self) -> float:
        """Nodal period; at 800 km 0.12 % longer than the Keplerian period, which is often the one published."""
        return 2.0 * math.pi / self._latitude_rate

    @property
    def inclination_rad(self) -> float:
        """Inclination to the true equator of date, constant."""
        return self.elements.inclination_rad

    @functools.cached_property
    def nodal_rate_rad_s(self) -> float:
        """Secular rate of the ascending node, positive to the east."""
        return nodal_rate(self.elements.semi_major_axis_km, self.elements.inclination_rad)

    def raan_rad(self, t_s: ArrayLike) -> Any:
        """Right ascension of the ascending node in [0, 2π), true equator and equinox of date, shape of `t_s`."""
        return _wrapped(self.elements.raan_rad + self.nodal_rate_rad_s * np.asarray(t_s, dtype=float))

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, in GCRS at seconds since the epoch, shape (...)."""
        t = np.asarray(t_s, dtype=float)
        cos_i, sin_i = math.cos(self.inclination_rad), math.sin(self.inclination_rad)
        node = self.elements.raan_rad + self.nodal_rate_rad_s * t
        u = (self.elements.argument_of_latitude_rad + self._latitude_rate * t)[..., None]
        to_node = np.stack([np.cos(node), np.sin(node), np.zeros(t.shape)], axis=-1)
        ahead = np.stack([-np.sin(node) * cos_i, np.cos(node) * cos_i, np.full(t.shape, sin_i)], axis=-1)
        radius = self.elements.semi_major_axis_km
        # In the plane the velocity has the rate of the argument of latitude plus that of the node, projected onto it.
        speed = radius * (self._latitude_rate + self.nodal_rate_rad_s * cos_i)
        matrix = true_of_date(self.clock, t)
        r_km = to_gcrs(matrix, radius * (np.cos(u) * to_node + np.sin(u) * ahead))
        return r_km, to_gcrs(matrix, speed * (np.cos(u) * ahead - np.sin(u) * to_node))


@dataclass(frozen=True)
class Sgp4Orbit:
    """Circular orbit from the same mean elements by SGP4 (Vallado et al. 2006; python-sgp4) without drag, rotated from
    TEME to GCRS.

    SGP4 adds to `J2Orbit` the short-period terms of J2 (about 1 km, and 4 km of radius), the eccentricity forced by J3
    (1e-3: 7 km in radius, 15 km along the orbit), and the secular rates of J2² and J4 (1 to 2 km per day along the
    orbit; the node of a sun-synchronous orbit drifts by about 1° per year relative to the mean Sun). For periods above
    225 minutes SDP4 is used, with Sun and Moon."""

    elements: CircularElements
    """Mean elements at the epoch. SGP4's input is Kozai's mean motion, from which it recovers Brouwer's; here the
    conversion is inverted, so that the semi-major axis is Brouwer's in both propagators."""
    clock: Clock
    """Epoch."""

    centre, span_s = "Earth", UNLIMITED

    @property
    def period_s(self) -> float:
        """Nodal period from SGP4's secular rates of mean anomaly and perigee."""
        satellite = _satellite(self.elements, self.clock)
        return 60.0 * 2.0 * math.pi / float(satellite.mdot + satellite.argpdot)

    @property
    def inclination_rad(self) -> float:
        """Mean inclination to the true equator of date."""
        return self.elements.inclination_rad

    @property
    def nodal_rate_rad_s(self) -> float:
        """Secular rate of the ascending node, positive to the east."""
        return float(_satellite(self.elements, self.clock).nodedot) / 60.0

    def raan_rad(self, t_s: ArrayLike) -> Any:
        """Mean right ascension of the ascending node in [0, 2π), true equator and equinox of date, shape of `t_s`."""
        t = np.asarray(t_s, dtype=float)
        equinoxes = equation_of_equinoxes(self.clock, t, true_of_date(self.clock, t))
        return _wrapped(float(_satellite(self.elements, self.clock).nodeo) + self.nodal_rate_rad_s * t + equinoxes)

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, in GCRS at seconds since the epoch, shape (...).

        `InputError` if SGP4 reports an error (an orbit below the surface, diverging elements).
        """
        t = np.asarray(t_s, dtype=float)
        try:
            return sgp4_state(_satellite(self.elements, self.clock), self.clock, t, 0.0)
        except InputError as error:
            raise InputError(
                f"orbit: SGP4 cannot propagate this orbit ({error}); change orbit.altitude_km or set "
                "orbit.propagator: j2"
            ) from None


PROPAGATORS: dict[str, Callable[[CircularElements, Clock], Orbit]] = {"j2": J2Orbit, "sgp4": Sgp4Orbit}
"""Propagators of circular orbits by name; each creates an `Orbit` from mean elements and a clock."""


def build_orbit(section: OrbitParameters, epoch: datetime) -> Orbit:
    """Circular orbit of a scenario's section.

    Parameters
    ----------
    section : OrbitParameters
        Altitude above the equatorial radius, inclination or ``auto`` (sun-synchronous), node by right ascension or by
        local mean solar time (22.5 h if neither is given), argument of latitude, propagator; with ``numerical`` this is
        the orbit from whose state at the epoch the integration starts.
    epoch : datetime
        With a time zone.

    Raises
    ------
    InputError
        For both node keys at once, an altitude outside the range of the model or without a sun-synchronous inclination,
        or an unknown propagator.
    """
    # These are the limits of the model. Limits of plausibility, such as the surface, are rules of the scenario, which
    # `allow_unphysical` can lift.
    radius = EARTH_RADIUS_KM + section.altitude_km
    if not SMALLEST_RADIUS_EARTHS * EARTH_RADIUS_KM <= radius <= SPHERE_OF_INFLUENCE_KM:
        raise InputError(
            f"orbit.altitude_km: no orbit around the Earth at {section.altitude_km:g} km; "
            f"use at most {SPHERE_OF_INFLUENCE_KM - EARTH_RADIUS_KM:.0f} km"
        )
    if section.raan_deg is not None and section.ltan_h is not None:
        raise InputError("orbit: raan_deg and ltan_h both define the node; remove one of them")
    clock = Clock(epoch)
    if section.raan_deg is not None:
        raan_rad = math.radians(section.raan_deg % 360.0)
    else:
        raan_rad = raan_of_local_time(clock, DEFAULT_LTAN_H if section.ltan_h is None else section.ltan_h)
    inclination = section.inclination_deg
    elements = CircularElements(
        semi_major_axis_km=radius,
        inclination_rad=sun_synchronous_inclination(radius) if inclination == "auto" else math.radians(inclination),
        raan_rad=raan_rad,
        argument_of_latitude_rad=math.radians(section.argument_of_latitude_deg % 360.0),
    )
    name = "j2" if section.propagator in ("auto", "numerical") else section.propagator
    return lookup("propagators", PROPAGATORS, name)(elements, clock)


def _wrapped(angle: FloatArray) -> Any:
    """Angle in [0, 2π); a float for a scalar."""
    wrapped = np.mod(angle, 2.0 * np.pi)
    return float(wrapped) if np.ndim(wrapped) == 0 else wrapped


def _kozai_mean_motion(elements: CircularElements) -> float:
    """Kozai's mean motion, rad/s, from Brouwer's: the inverse of SGP4's first step (Hoots & Roehrich 1980, section
    6)."""
    brouwer = mean_motion(elements.semi_major_axis_km)
    d1 = 0.75 * EARTH_J2 * (3.0 * math.cos(elements.inclination_rad) ** 2 - 1.0)
    a1 = elements.semi_major_axis_km / EARTH_RADIUS_KM
    kozai = brouwer
    # SGP4 recovers Brouwer's mean motion from Kozai's by a series in δ; here the same series is inverted by fixed-point
    # iteration, each step of which gains three digits.
    for _ in range(20):
        ak = a1 * (brouwer / kozai) ** (2.0 / 3.0)
        delta = d1 / ak**2
        adel = ak * (1.0 - delta * (1.0 / 3.0 + delta * (1.0 + 134.0 / 81.0 * delta)))
        kozai = brouwer * (1.0 + d1 / adel**2)
    return kozai


@functools.lru_cache(maxsize=64)
def _satellite(elements: CircularElements, clock: Clock) -> Any:
    """SGP4's record of an orbit, cached here because it cannot be pickled."""
    # TEME measures the node from the mean equinox, the elements from the true one.
    node = elements.raan_rad - float(equation_of_equinoxes(clock, 0.0, true_of_date(clock, 0.0)))
    return sgp4_satellite(
        "WGS84",
        (clock.epoch - datetime(1949, 12, 31, tzinfo=UTC)).total_seconds() / SECONDS_PER_DAY,
        mean_motion_rad_min=60.0 * _kozai_mean_motion(elements),
        inclination_rad=elements.inclination_rad,
        node_rad=node % (2.0 * math.pi),
        mean_anomaly_rad=elements.argument_of_latitude_rad,  # from the node, as the argument of perigee is 0
    )
