"""What the spacecraft knows of itself when the frame is taken: when it was, where it is, how fast it goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.constants import SPEED_OF_LIGHT_KM_S

FloatArray = NDArray[np.float64]

EARTH_KM_S, ORBIT_KM_S = 29.8, 7.6
"""Speed of the Earth about the Sun, and of a satellite in a low orbit about the Earth."""
_OBLIQUITY_RAD = np.radians(23.4393)
_ECLIPTIC_POLE = np.array([0.0, -np.sin(_OBLIQUITY_RAD), np.cos(_OBLIQUITY_RAD)])


@dataclass(frozen=True, eq=False)
class Observer:
    """Epoch and barycentric state; the defaults are a barycentric observer at J2000.

    Parameters
    ----------
    epoch_jyear : float
        Julian epoch (TT) of mid-exposure; stars are moved to it.
    velocity_km_s : array, shape (3,)
        Barycentric velocity, ICRS; the tracker takes the aberration of light from it.
    position_au : array, shape (3,)
        Barycentric position, ICRS; annual parallax.
    """

    epoch_jyear: float = 2000.0
    velocity_km_s: FloatArray | None = None
    position_au: FloatArray | None = None


def aberrate(directions: FloatArray, velocity_km_s: FloatArray) -> FloatArray:
    """Directions (N, 3) as a moving observer sees them: the full special-relativistic aberration.

    u' = [u/γ + β (1 + (u·β) / (1 + 1/γ))] / (1 + u·β), with β = v/c
    (Explanatory Supplement to the Astronomical Almanac, 3rd ed., eq. 7.40; ERFA's ``eraAb`` without its
    gravitational term, which is below 0.5 µas).
    """
    beta = np.asarray(velocity_km_s, dtype=float) / SPEED_OF_LIGHT_KM_S
    inverse_gamma = float(np.sqrt(1.0 - beta @ beta))
    along = directions @ beta
    out = directions * inverse_gamma + beta * (1.0 + along / (1.0 + inverse_gamma))[:, None]
    return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


def unknown_aberration(matrix: FloatArray) -> FloatArray:
    """Covariance (3, 3), rad², of an attitude (3, 3) ICRS to camera whose observer's velocity is not known.

    To first order in β the aberration turns the field about the boresight b by θ = b × β, up to 20.5″ by the Earth's
    motion, which has any direction in the ecliptic: the covariance of β is (β_E²/2) (I − n nᵀ), n being the pole of the
    ecliptic. An orbit about the Earth adds (β_o²/3) I.
    """
    pole = matrix @ _ECLIPTIC_POLE
    earth, orbit = (EARTH_KM_S / SPEED_OF_LIGHT_KM_S) ** 2 / 2.0, (ORBIT_KM_S / SPEED_OF_LIGHT_KM_S) ** 2 / 3.0
    beta = (earth + orbit) * np.eye(3) - earth * np.outer(pole, pole)
    across = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # of b = (0, 0, 1)
    return np.asarray(across @ beta @ across.T)
