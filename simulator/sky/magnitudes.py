"""V magnitudes of Sun, Moon and planets.

Planets: Mallama & Hilton 2018, "Computing apparent planetary magnitudes for The Astronomical Almanac", Astronomy and
Computing 25, 10 (arXiv:1808.01973), whose equation numbers are given. With r and Δ the distances from Sun and observer
in au, α the phase angle in degrees, V = 5 log₁₀(r Δ) + V₁(α, …). Good to 0.1 mag or better; Mars without its
rotation and seasons is off by up to 0.06 mag.

Every formula is plain arithmetic that kernels take in (`register_jitable`) and Python calls as it is.
"""

from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

__all__ = ["PLANETS", "SATURN_POLE", "URANUS_AXES_SQUARED", "URANUS_POLE", "moon_v", "planet_v", "sun_v"]

FloatArray = NDArray[np.float64]

PLANETS = ("Mercury", "Venus", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune")
"""Planets in the order of their numbers in `planet_v_by_number`."""

SATURN_POLE = np.array([0.08547883, 0.07323576, 0.99364475])
"""North pole of Saturn, ICRF: RA 40.589°, Dec 83.537° (IAU working group, Archinal et al. 2018)."""
URANUS_POLE = np.array([-0.21199958, -0.94155916, -0.26176809])
"""North pole of Uranus, ICRF: RA 257.311°, Dec −15.175° (Archinal et al. 2018)."""
URANUS_AXES_SQUARED = (24973.0 / 25559.0) ** 2
"""Squared ratio of the polar to the equatorial radius (Archinal et al. 2018)."""

_MOON_MEAN_DISTANCE_AU = 384_400.0 / 149_597_870.7


@register_jitable
def sun_v(distance_au: float) -> float:
    """V of the Sun: −26.74 at 1 au (Cox 2000, *Allen's Astrophysical Quantities*, table 14.2)."""
    return -26.74 + 5.0 * math.log10(distance_au)


@register_jitable
def moon_v(r_au: float, delta_au: float, phase_deg: float) -> float:
    """V of the Moon, −12.73 at mean full Moon.

    V = −12.73 + 0.026 α + 4·10⁻⁹ α⁴ + 5 log₁₀(r Δ / 384,400 km) (Allen 1976; Krisciunas & Schaefer 1991, PASP 103,
    1033, eq. 9). Good to some 0.2 mag up to α = 150°; without the opposition surge (a third brighter at α < 1°), and
    with no difference between waxing and waning.
    """
    law = -12.73 + 0.026 * phase_deg + 4e-9 * phase_deg**4
    return law + 5.0 * math.log10(r_au * delta_au / _MOON_MEAN_DISTANCE_AU)


def planet_v(name: str, from_sun_au: FloatArray, from_observer_au: FloatArray, epoch_jyear: float) -> float:
    """V of a planet.

    Parameters
    ----------
    name : str
        ``Mercury`` … ``Neptune`` but the Earth.
    from_sun_au, from_observer_au : float array, shape (3,)
        Vectors to the planet, ICRF axes.
    epoch_jyear : float
        Julian year: Neptune has grown brighter since 1980.

    Notes
    -----
    Outside the ranges of phase angle that were observed (Mercury 2° to 170°, Venus 2° to 179°, Saturn to 6.5°) the
    formulae are continued; a spacecraft near the Earth sees no others but those two planets close to the Sun.
    """
    return float(planet_v_by_number(PLANETS.index(name), from_sun_au, from_observer_au, epoch_jyear))


@register_jitable
def planet_v_by_number(number: int, from_sun_au: FloatArray, from_observer_au: FloatArray, epoch_jyear: float) -> float:
    """`planet_v` by the planet's place in `PLANETS`."""
    sx, sy, sz = from_sun_au[0], from_sun_au[1], from_sun_au[2]
    ox, oy, oz = from_observer_au[0], from_observer_au[1], from_observer_au[2]
    r, delta = math.sqrt(sx * sx + sy * sy + sz * sz), math.sqrt(ox * ox + oy * oy + oz * oz)
    sx, sy, sz = sx / r, sy / r, sz / r
    ox, oy, oz = ox / delta, oy / delta, oz / delta
    cx, cy, cz = sy * oz - sz * oy, sz * ox - sx * oz, sx * oy - sy * ox
    alpha = math.degrees(math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), sx * ox + sy * oy + sz * oz))
    at_1_au: float
    if number == 0:
        at_1_au = _mercury(alpha)
    elif number == 1:
        at_1_au = _venus(alpha)
    elif number == 2:
        at_1_au = _mars(alpha)
    elif number == 3:
        at_1_au = _jupiter(alpha)
    elif number == 4:
        at_1_au = _saturn(alpha, _latitude(SATURN_POLE, sx, sy, sz), _latitude(SATURN_POLE, ox, oy, oz))
    elif number == 5:
        at_1_au = _uranus(alpha, _latitude(URANUS_POLE, sx, sy, sz), _latitude(URANUS_POLE, ox, oy, oz))
    else:
        at_1_au = _neptune(alpha, epoch_jyear)
    return 5.0 * math.log10(r * delta) + at_1_au


@register_jitable
def _latitude(pole: FloatArray, x: float, y: float, z: float) -> float:
    """Planetocentric latitude, degrees, of the point under a source whose rays run along (x, y, z) to the planet."""
    return math.degrees(math.asin(-(pole[0] * x + pole[1] * y + pole[2] * z)))


@register_jitable
def _polynomial(alpha: float, coefficients: tuple[float, ...]) -> float:
    value = 0.0
    for k in range(len(coefficients) - 1, -1, -1):
        value = value * alpha + coefficients[k]
    return value


@register_jitable
def _mercury(alpha: float) -> float:  # eq. 2
    return float(_polynomial(alpha, (-0.613, 6.3280e-2, -1.6336e-3, 3.3644e-5, -3.4265e-7, 1.6893e-9, -3.0334e-12)))


@register_jitable
def _venus(alpha: float) -> float:  # eq. 3 and 4
    if alpha <= 163.7:
        return float(_polynomial(alpha, (-4.384, -1.044e-3, 3.687e-4, -2.814e-6, 8.938e-9)))
    return float(_polynomial(alpha, (236.05828, -2.81914, 8.39034e-3)))


@register_jitable
def _mars(alpha: float) -> float:  # eq. 6 and 7, means over rotation and orbit
    if alpha <= 50.0:
        return float(_polynomial(alpha, (-1.601, 2.267e-2, -1.302e-4)))
    return float(_polynomial(alpha, (-0.367, -0.02573, 3.445e-4)))


@register_jitable
def _jupiter(alpha: float) -> float:  # eq. 8 and 9
    if alpha <= 12.0:
        return float(_polynomial(alpha, (-9.395, -3.7e-4, 6.16e-4)))
    return -9.428 - 2.5 * math.log10(_polynomial(alpha / 180.0, (1.0, -1.507, -0.363, -0.062, 2.809, -1.876)))


@register_jitable
def _saturn(alpha: float, sun_latitude: float, observer_latitude: float) -> float:  # eq. 10, globe and rings
    product = sun_latitude * observer_latitude
    sine = math.sin(math.radians(math.sqrt(product))) if product > 0.0 else 0.0
    return -8.914 - 1.825 * sine + 0.026 * alpha - 0.378 * sine * math.exp(-2.25 * alpha)


@register_jitable
def _uranus(alpha: float, sun_latitude: float, observer_latitude: float) -> float:  # eq. 13 to 15
    mean_latitude: float = (_planetographic(sun_latitude) + _planetographic(observer_latitude)) / 2.0
    phase = 6.587e-3 * alpha + 1.045e-4 * alpha**2 if alpha > 3.1 else 0.0
    return -7.110 - 0.00084 * mean_latitude + phase


@register_jitable
def _planetographic(latitude_deg: float) -> float:
    """Size of the planetographic latitude of Uranus, degrees, of a planetocentric one."""
    return abs(math.degrees(math.atan(math.tan(math.radians(latitude_deg)) / URANUS_AXES_SQUARED)))


@register_jitable
def _neptune(alpha: float, epoch_jyear: float) -> float:  # eq. 16 and 17
    at_opposition = min(max(-6.89 - 0.0054 * (epoch_jyear - 1980.0), -7.00), -6.89)
    return at_opposition + (7.944e-3 * alpha + 9.617e-5 * alpha**2 if alpha > 1.9 else 0.0)
