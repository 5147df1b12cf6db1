"""What the spacecraft knows of itself when the frame is taken: when it was, where it is, how fast it goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.constants import SPEED_OF_LIGHT_KM_S

FloatArray = NDArray[np.float64]


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
