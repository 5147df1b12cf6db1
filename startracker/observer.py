"""Observer: epoch, position and velocity of the spacecraft when the frame was taken."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from startracker._compiled import kernel_part
from startracker.arguments import is_time, julian_year, of_kind, plain, real_array, real_number
from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray
from startracker.display import described
from startracker.ephemeris import barycentric, timescale
from startracker.errors import InputError

EARTH_KM_S, ORBIT_KM_S = 29.8, 7.6
"""Orbital speeds of the Earth, and of a satellite in a low Earth orbit, km/s."""
_OBLIQUITY_RAD = math.radians(23.4393)
_POLE_Y, _POLE_Z = -math.sin(_OBLIQUITY_RAD), math.cos(_OBLIQUITY_RAD)
"""Components of the ecliptic pole; its x is 0."""
_EARTH_PART, _ORBIT_PART = (EARTH_KM_S / SPEED_OF_LIGHT_KM_S) ** 2 / 2.0, (ORBIT_KM_S / SPEED_OF_LIGHT_KM_S) ** 2 / 3.0
ABERRATION_SCALE_SIGMA = math.sqrt(_EARTH_PART + _ORBIT_PART)
"""Standard deviation of the relative change of a field's scale by unknown aberration, for a field in the ecliptic."""
_FASTEST_KM_S, _FARTHEST_AU, _LONGEST_YEARS = 1000.0, 1000.0, 10_000
"""Upper limits for plausibility: the fastest spacecraft passed the Sun at 192 km/s, the most distant is at 170 au."""


@dataclass(frozen=True, eq=False)
class Observer:
    """Epoch, and barycentric position and velocity if they are known.

    Parameters
    ----------
    epoch_jyear : float or astropy Time
        Julian epoch (TT) of mid-exposure, for space motion. Stored as a float.
    velocity_km_s : array or astropy Quantity, shape (3,), optional
        Barycentric velocity, ICRS, for the aberration of light. Stored in km/s. None if unknown; aberration is then not
        corrected, and covariances include it. An observer at rest at the barycentre has the velocity (0, 0, 0).
    position_au : array or astropy Quantity, shape (3,)
        Barycentric position, ICRS, for the annual parallax. Stored in au.

    Raises
    ------
    InputError
        For an invalid or impossible epoch, velocity or position.
    """

    epoch_jyear: float = 2000.0
    velocity_km_s: FloatArray | None = None
    position_au: FloatArray | None = None

    def __post_init__(self) -> None:
        given = julian_year(self.epoch_jyear)
        if is_time(given):
            raise InputError("epoch_jyear must be a number of years or an astropy Time of one instant")
        epoch = real_number("epoch_jyear", given, what="a number of years or an astropy Time", finite=False)
        if not abs(epoch - 2000.0) <= _LONGEST_YEARS:
            raise InputError(f"epoch_jyear is {epoch:g}; it must be a Julian year within {_LONGEST_YEARS} of 2000")
        object.__setattr__(self, "epoch_jyear", epoch)
        self._check("velocity_km_s", _FASTEST_KM_S, "km/s", "m/s")
        self._check("position_au", _FARTHEST_AU, "au", "km")

    @classmethod
    def on_earth(cls, time: Any, location: Any = None) -> Observer:
        """Observer on the ground, by ERFA's ``apco13``.

        UT1 is approximated by UTC, and the pole is fixed: errors of 5 cm/s and 0.5 km. No file is downloaded. Without a
        location the observer moves with the Earth's centre (DE421): aberration to 0.3″, position unknown.

        Parameters
        ----------
        time : astropy Time
            Middle of the exposure.
        location : astropy EarthLocation, optional
            For example ``EarthLocation.from_geodetic(lon=18.9 * u.deg, lat=-33.9 * u.deg, height=120 * u.m)``.

        Raises
        ------
        InputError
            For anything but one time and at most one location, or, without one, a date outside DE421.
        """
        sited = location is None or (hasattr(location, "geodetic") and location.isscalar)
        if not (is_time(time) and time.isscalar and sited):
            raise InputError(
                "an observer on the Earth needs one astropy Time and one astropy EarthLocation, or no location"
            )
        if location is None:
            return cls(time, barycentric("Earth", timescale().from_astropy(time)).velocity.km_per_s)
        import erfa

        geodetic = location.geodetic
        site = geodetic.lon.to_value("rad"), geodetic.lat.to_value("rad"), geodetic.height.to_value("m")
        # the ufunc, because its wrapper warns of dates after the table of leap seconds; air, polar motion: none
        astrom, *_ = erfa.ufunc.apco13(time.utc.jd1, time.utc.jd2, 0.0, *site, *[0.0] * 5, 0.55)
        return cls(time, astrom["v"] * SPEED_OF_LIGHT_KM_S, astrom["eb"])

    @property
    def time(self) -> Any:
        """The epoch as an astropy ``Time``, TT."""
        from astropy.time import Time

        return Time(self.epoch_jyear, format="jyear", scale="tt")

    def __repr__(self) -> str:
        velocity, position = self.velocity_km_s, self.position_au
        speed = "velocity unknown" if velocity is None else f"{math.hypot(*velocity.tolist()):.2f} km/s"
        distance = "" if position is None else f"{math.hypot(*position.tolist()):.4f} au"
        return described("Observer", f"epoch {self.epoch_jyear:.5f}", speed, distance)

    def _check(self, name: str, most: float, unit: str, other: str) -> None:
        """Convert one of the vectors to an array and check its length.

        Raises
        ------
        InputError
            With the name of the vector.
        """
        given = plain(getattr(self, name), {"km/s": "km/s", "au": "AU"}[unit], name)
        if given is None:
            return
        vector = real_array(f"{name}, three numbers in {unit},", given, finite=False).copy()
        if vector.shape != (3,):
            raise InputError(f"{name} must be three numbers, {unit}; got the shape {vector.shape}")
        length = math.hypot(*vector.tolist())  # no square overflows
        if not length <= most:  # NaN too
            raise InputError(
                f"{name} has the length {length:g} {unit}; at most {most:g} is possible (is it in {other}?)"
            )
        object.__setattr__(self, name, vector)


@kernel_part
def aberrated(x: float, y: float, z: float, beta: tuple[float, float, float]) -> tuple[float, float, float]:
    """`aberrate` for one vector of any length in kernels, for a velocity in units of that of light."""
    inverse_gamma = math.sqrt(1.0 - beta[0] * beta[0] - beta[1] * beta[1] - beta[2] * beta[2])
    # The relativistic formula maps a unit vector u to a vector of length 1 + u·β, hence the division by it.
    length, along = math.sqrt(x * x + y * y + z * z), x * beta[0] + y * beta[1] + z * beta[2]
    shrink = 1.0 / (length + along)
    forward, kept = (length + along * (1.0 / (1.0 + inverse_gamma))) * shrink, inverse_gamma * shrink
    return x * kept + beta[0] * forward, y * kept + beta[1] * forward, z * kept + beta[2] * forward


def aberrate(directions: FloatArray, velocity_km_s: FloatArray) -> FloatArray:
    """Apparent directions (N, 3) for a moving observer: full special-relativistic aberration.

    u' = [u/γ + β (1 + (u·β) / (1 + 1/γ))] / (1 + u·β), with β = v/c
    (Explanatory Supplement to the Astronomical Almanac, 3rd ed., eq. 7.40; ERFA's ``eraAb`` without its
    gravitational term, which is below 0.5 µas).
    """
    beta = np.asarray(velocity_km_s, dtype=float) / SPEED_OF_LIGHT_KM_S
    inverse_gamma = math.sqrt(1.0 - float(beta @ beta))
    along = directions @ beta
    out: FloatArray = directions * inverse_gamma + beta * (1.0 + along / (1.0 + inverse_gamma))[:, None]
    out /= np.sqrt(np.add.reduce(out * out, axis=1, keepdims=True))
    return out


def unknown_aberration(matrix: FloatArray) -> FloatArray:
    """Covariance (3, 3), rad², that an unknown velocity of the observer adds to an attitude matrix (3, 3), ICRS to
    camera.

    To first order in β, aberration rotates the field around the boresight b by θ = b × β, up to 20.5″ from the Earth's
    motion. Its direction in the ecliptic is unknown: the covariance of β is (β_E²/2) (I − n nᵀ), with the ecliptic pole
    n. An Earth orbit adds (β_o²/3) I.
    """
    (_, a, b), (_, c, d), _ = matrix.tolist()
    x, y = a * _POLE_Y + b * _POLE_Z, c * _POLE_Y + d * _POLE_Z
    total, out = _EARTH_PART + _ORBIT_PART, np.zeros((3, 3))
    out[0, 0], out[1, 1] = total - _EARTH_PART * (y * y), total - _EARTH_PART * (x * x)
    out[0, 1] = out[1, 0] = _EARTH_PART * (x * y)
    return out


def corrects_aberration(observer: Observer | None) -> bool:
    """Whether an observer's velocity is known, so that aberration can be corrected."""
    return observer is not None and observer.velocity_km_s is not None


def observer_of(observer: Observer | None, time: Any) -> Observer | None:
    """The observer of an image: the given one, or one with only its epoch known; None if neither is given.

    Raises
    ------
    InputError
        If both are given, as an observer has an epoch.
    """
    of_kind(
        "observer", observer, (Observer, type(None)), "startracker.Observer(epoch_jyear, velocity_km_s, position_au)"
    )
    if time is None:
        return observer
    if observer is not None:
        raise InputError("observer and time both give the epoch; omit time")
    return Observer(epoch_jyear=time)
