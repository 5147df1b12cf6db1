"""V magnitudes of Sun, Moon and planets.

Planets: Mallama & Hilton 2018, "Computing apparent planetary magnitudes for The Astronomical Almanac", Astronomy and
Computing 25, 10 (arXiv:1808.01973), whose equation numbers are given. With r and Δ the distances from Sun and observer
in au, α the phase angle in degrees, V = 5 log₁₀(r Δ) + V₁(α, …). Accurate to 0.1 mag or better; the error for Mars,
whose rotation and seasons are neglected, is up to 0.06 mag.

All functions take arrays. Skyfield's ``planetary_magnitude`` has the same formulae, but uses the barycentre instead of
the Sun (0.04 mag for Mercury) and returns NaN where the paper has no observations.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike

from startracker.core import FloatArray

PLANETS = ("Mercury", "Venus", "Earth", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune")

SATURN_POLE = np.array([0.08547883, 0.07323576, 0.99364475])
"""North pole of Saturn, ICRF: RA 40.589°, Dec 83.537° (IAU working group, Archinal et al. 2018)."""
URANUS_POLE = np.array([-0.21199958, -0.94155916, -0.26176809])
"""North pole of Uranus, ICRF: RA 257.311°, Dec −15.175° (Archinal et al. 2018)."""
URANUS_AXES_SQUARED = (24973.0 / 25559.0) ** 2
"""Squared ratio of the polar to the equatorial radius (Archinal et al. 2018)."""

_MOON_MEAN_DISTANCE_AU = 384_400.0 / 149_597_870.7


def sun_v(distance_au: ArrayLike) -> FloatArray:
    """V of the Sun: −26.74 at 1 au (Cox 2000, *Allen's Astrophysical Quantities*, table 14.2)."""
    return np.asarray(-26.74 + 5.0 * np.log10(distance_au))


def moon_v(r_au: ArrayLike, delta_au: ArrayLike, phase_deg: ArrayLike) -> FloatArray:
    """V of the Moon, −12.73 at mean full Moon.

    V = −12.73 + 0.026 α + 4·10⁻⁹ α⁴ + 5 log₁₀(r Δ / 384,400 km) (Allen 1976; Krisciunas & Schaefer 1991, PASP 103,
    1033, eq. 9). Accurate to about 0.2 mag up to α = 150°; without the opposition surge (a third brighter at
    α < 1°), and without a difference between waxing and waning Moon.
    """
    alpha = np.asarray(phase_deg, dtype=float)
    distance = np.asarray(r_au, dtype=float) * delta_au / _MOON_MEAN_DISTANCE_AU
    return np.asarray(-12.73 + 0.026 * alpha + 4e-9 * alpha**4 + 5.0 * np.log10(distance))


def planet_v(name: str, from_sun_au: FloatArray, from_observer_au: FloatArray, epoch_jyear: ArrayLike) -> FloatArray:
    """V of a planet.

    Parameters
    ----------
    name : str
        One of `PLANETS`.
    from_sun_au, from_observer_au : float array, shape (..., 3)
        Vectors to the planet, ICRF axes.
    epoch_jyear : float or array, shape (...)
        Julian year; Neptune has become brighter since 1980.

    Returns
    -------
    array, shape (...)

    Notes
    -----
    Outside the observed ranges of phase angle (Mercury 2° to 170°, Venus 2° to 179°, Saturn to 6.5°) the formulae are
    extrapolated; near the Earth this only occurs for the two inner planets close to the Sun. From elsewhere outer
    planets are seen at phases that do not occur from the Earth, where their magnitudes are extrapolated.
    """
    r, delta = np.linalg.norm(from_sun_au, axis=-1), np.linalg.norm(from_observer_au, axis=-1)
    sun_ray, sight = from_sun_au / r[..., None], from_observer_au / delta[..., None]
    # The phase angle is that between the ray from the Sun and the line of sight; atan2 is accurate at all angles.
    sine = np.linalg.norm(np.cross(sun_ray, sight), axis=-1)
    alpha = np.degrees(np.arctan2(sine, np.sum(sun_ray * sight, axis=-1)))
    if name in _PHASE_CURVES:
        at_1_au = _PHASE_CURVES[name](alpha)
    elif name == "Saturn":
        at_1_au = _saturn(alpha, _latitude(SATURN_POLE, sun_ray), _latitude(SATURN_POLE, sight))
    elif name == "Uranus":
        at_1_au = _uranus(alpha, _latitude(URANUS_POLE, sun_ray), _latitude(URANUS_POLE, sight))
    else:
        at_1_au = _neptune(alpha, np.asarray(epoch_jyear, dtype=float))
    return np.asarray(5.0 * np.log10(r * delta) + at_1_au)


def _polynomial(alpha: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """Polynomial of the phase angle, lowest power first."""
    return np.asarray(polynomial.polyval(alpha, coefficients), dtype=float)


def _latitude(pole: FloatArray, ray: FloatArray) -> FloatArray:
    """Planetocentric latitude, degrees, of the point from which a source is in the zenith; `ray` (..., 3) is the
    direction from the source to the planet."""
    return np.asarray(np.degrees(np.arcsin(-np.sum(pole * ray, axis=-1))))


def _mercury(alpha: FloatArray) -> FloatArray:  # eq. 2
    return _polynomial(alpha, (-0.613, 6.3280e-2, -1.6336e-3, 3.3644e-5, -3.4265e-7, 1.6893e-9, -3.0334e-12))


def _venus(alpha: FloatArray) -> FloatArray:  # eq. 3 and 4
    return np.where(
        alpha <= 163.7,
        _polynomial(alpha, (-4.384, -1.044e-3, 3.687e-4, -2.814e-6, 8.938e-9)),
        _polynomial(alpha, (236.05828, -2.81914, 8.39034e-3)),
    )


def _earth(alpha: FloatArray) -> FloatArray:  # eq. 5
    return _polynomial(alpha, (-3.99, -1.060e-3, 2.054e-4))


def _mars(alpha: FloatArray) -> FloatArray:  # eq. 6 and 7, means over rotation and orbit
    near, far = _polynomial(alpha, (-1.601, 2.267e-2, -1.302e-4)), _polynomial(alpha, (-0.367, -0.02573, 3.445e-4))
    return np.where(alpha <= 50.0, near, far)


def _jupiter(alpha: FloatArray) -> FloatArray:  # eq. 8 and 9
    light = _polynomial(alpha / 180.0, (1.0, -1.507, -0.363, -0.062, 2.809, -1.876))
    return np.where(alpha <= 12.0, _polynomial(alpha, (-9.395, -3.7e-4, 6.16e-4)), -9.428 - 2.5 * np.log10(light))


_PHASE_CURVES = {"Mercury": _mercury, "Venus": _venus, "Earth": _earth, "Mars": _mars, "Jupiter": _jupiter}
"""V at 1 au from Sun and observer, as a function of the phase angle in degrees."""


def _saturn(alpha: FloatArray, sun_latitude: FloatArray, latitude: FloatArray) -> FloatArray:  # eq. 10, globe and rings
    # The rings are seen lit only if Sun and observer are on the same side of them; the effective latitude is the
    # geometric mean of both.
    sine = np.sin(np.radians(np.sqrt(np.maximum(sun_latitude * latitude, 0.0))))
    return np.asarray(-8.914 - 1.825 * sine + 0.026 * alpha - 0.378 * sine * np.exp(-2.25 * alpha))


def _uranus(alpha: FloatArray, sun_latitude: FloatArray, latitude: FloatArray) -> FloatArray:  # eq. 13 to 15
    # The paper's latitude is the mean of the absolute planetographic sub-solar and sub-observer latitudes.
    mean_latitude = (_planetographic(sun_latitude) + _planetographic(latitude)) / 2.0
    phase = np.where(alpha > 3.1, _polynomial(alpha, (0.0, 6.587e-3, 1.045e-4)), 0.0)
    return np.asarray(-7.110 - 0.00084 * mean_latitude + phase)


def _planetographic(latitude_deg: FloatArray) -> FloatArray:
    """Absolute planetographic latitude of Uranus, degrees, from the planetocentric latitude."""
    return np.asarray(np.abs(np.degrees(np.arctan(np.tan(np.radians(latitude_deg)) / URANUS_AXES_SQUARED))))


def _neptune(alpha: FloatArray, epoch_jyear: FloatArray) -> FloatArray:  # eq. 16 and 17
    at_opposition = np.clip(-6.89 - 0.0054 * (epoch_jyear - 1980.0), -7.00, -6.89)
    return np.asarray(at_opposition + np.where(alpha > 1.9, _polynomial(alpha, (0.0, 7.944e-3, 9.617e-5)), 0.0))
