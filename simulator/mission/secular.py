"""Circular orbits under the secular part of J2: rates of the node and of the argument of latitude, sun-synchronism."""

from __future__ import annotations

import math
from dataclasses import dataclass

from simulator.constants import EARTH_GM_KM3_S2, EARTH_J2, EARTH_RADIUS_KM, TROPICAL_YEAR_S
from startracker.errors import InputError

MEAN_SUN_RATE_RAD_S = 2.0 * math.pi / TROPICAL_YEAR_S
"""Motion of the mean Sun relative to the equinox of date: one revolution per tropical year."""


@dataclass(frozen=True)
class CircularElements:
    """Mean elements of a circular orbit at the epoch, in the true equator and equinox of date."""

    semi_major_axis_km: float
    """Brouwer's mean semi-major axis."""
    inclination_rad: float
    raan_rad: float
    """Right ascension of the ascending node."""
    argument_of_latitude_rad: float
    """Angle from the ascending node in the direction of motion."""


def mean_motion(semi_major_axis_km: float) -> float:
    """Keplerian mean motion, rad/s: n = √(μ / a³)."""
    return math.sqrt(EARTH_GM_KM3_S2 / semi_major_axis_km**3)


def nodal_rate(semi_major_axis_km: float, inclination_rad: float) -> float:
    """Secular rate of the ascending node, rad/s, positive to the east.

    Ω̇ = −(3/2) n J₂ (R/a)² cos i (Vallado 2013, *Fundamentals of Astrodynamics and Applications*, section 9.6; Wertz &
    Larson 1999, *Space Mission Analysis and Design*, eq. 6-19). The neglected J₂² and J₄ terms are 3e-3 of it at 800
    km, 1° per year. The node is measured from the equinox of date, as the mean Sun is; the motion of the equinox along
    the equator, 46″ per year, is smaller than the neglected terms.
    """
    oblateness = EARTH_J2 * (EARTH_RADIUS_KM / semi_major_axis_km) ** 2
    return -1.5 * oblateness * mean_motion(semi_major_axis_km) * math.cos(inclination_rad)


def latitude_rate(semi_major_axis_km: float, inclination_rad: float) -> float:
    """Secular rate of the argument of latitude u = ω + M, rad/s: 2π over the nodal period.

    u̇ = n [1 + (3/4) J₂ (R/a)² (6 − 8 sin² i)], the sum of Ṁ − n ∝ 2 − 3 sin² i and ω̇ ∝ 4 − 5 sin² i for e = 0
    (Vallado 2013, section 9.6, with Brouwer's mean semi-major axis).
    """
    oblateness = EARTH_J2 * (EARTH_RADIUS_KM / semi_major_axis_km) ** 2
    sin2 = math.sin(inclination_rad) ** 2
    return mean_motion(semi_major_axis_km) * (1.0 + 0.75 * oblateness * (6.0 - 8.0 * sin2))


def sun_synchronous_limit_km() -> float:
    """Maximum altitude of a circular sun-synchronous orbit, at which the nodal precession suffices at i = 180°.

    `nodal_rate` solved for a at 360° per tropical year: a^(7/2) = (3/2) J₂ R² √μ / Ω̇ (Vallado 2013, chapter 9).
    """
    rate = EARTH_J2 * EARTH_RADIUS_KM**2 * math.sqrt(EARTH_GM_KM3_S2) / MEAN_SUN_RATE_RAD_S
    a_km: float = (1.5 * rate) ** (2.0 / 7.0)
    return a_km - EARTH_RADIUS_KM


def sun_synchronous_inclination(semi_major_axis_km: float) -> float:
    """Inclination, radians, at which the node follows the mean Sun.

    Solves `nodal_rate` = 360° per tropical year: cos i = −(2/3) Ω̇ (a/R)² / (n J₂) (Wertz & Larson 1999, section 6.2).

    Raises
    ------
    InputError
        Above about 5,970 km, where even an equatorial retrograde orbit precesses too slowly.
    """
    # `nodal_rate` at i = 0 is the factor of cos i, and is negative; the inclination is therefore above 90°.
    cosine = MEAN_SUN_RATE_RAD_S / nodal_rate(semi_major_axis_km, 0.0)
    if cosine < -1.0:
        altitude = semi_major_axis_km - EARTH_RADIUS_KM
        raise InputError(
            f"orbit.inclination_deg: no sun-synchronous inclination at {altitude:g} km, the node precesses too slowly; "
            f"use an altitude below {sun_synchronous_limit_km():.0f} km or give orbit.inclination_deg in degrees"
        )
    return math.acos(cosine)
