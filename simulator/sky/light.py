"""What turns light on its way in, by ERFA: gravity of the Sun, and the observer's own motion."""

from __future__ import annotations

import erfa
import numpy as np
from numpy.typing import NDArray

from startracker.constants import SPEED_OF_LIGHT_KM_S

__all__ = ["aberrated", "bend_by_sun"]

FloatArray = NDArray[np.float64]


def bend_by_sun(directions: FloatArray, from_sun_au: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) of distant sources after the Sun's gravity has bent their light; ERFA's ``eraLdsun``.

    At right angles to the Sun the light is bent by 4.07 mas, at its limb by 1.75″; inside the disc the formula is held
    back, so that nothing grows without bound.

    Parameters
    ----------
    directions : float array, shape (N, 3)
        Unit vectors from the observer, before the bending.
    from_sun_au : float array, shape (3,)
        From the Sun to the observer, au.
    """
    distance = np.linalg.norm(from_sun_au)
    return np.asarray(erfa.ufunc.ldsun(directions, from_sun_au / distance, distance))


def aberrated(directions: FloatArray, velocity_km_s: FloatArray) -> FloatArray:
    """Unit vectors (..., 3) that a moving observer sees; ERFA's ``eraAb`` without the Sun's potential, below 0.5 µas,
    which the tracker's `startracker.observer.aberrate` leaves out too. The shapes are broadcast."""
    beta = velocity_km_s / SPEED_OF_LIGHT_KM_S
    inverse_gamma = np.sqrt(1.0 - np.sum(beta * beta, axis=-1))
    return np.asarray(erfa.ufunc.ab(directions, beta, np.inf, inverse_gamma))
