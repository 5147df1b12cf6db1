"""Light deflection by the Sun, and aberration, by ERFA."""

from __future__ import annotations

import math

import erfa
import numpy as np

from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray


def bend_by_sun(directions: FloatArray, from_sun_au: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) of distant sources with light deflection by the Sun; ERFA's ``eraLdsun``.

    The deflection is 4.07 mas at 90° from the Sun and 1.75″ at its limb; inside the disk the formula is limited so that
    it stays finite.

    Parameters
    ----------
    directions : float array, shape (N, 3)
        Unit vectors from the observer, before deflection.
    from_sun_au : float array, shape (3,)
        From the Sun to the observer, au.
    """
    distance = math.sqrt(from_sun_au @ from_sun_au)
    return np.asarray(erfa.ufunc.ldsun(directions, from_sun_au / distance, distance))


def aberrated(directions: FloatArray, velocity_km_s: FloatArray) -> FloatArray:
    """Apparent unit vectors (..., 3) for a moving observer; ERFA's ``eraAb`` without the Sun's potential (below
    0.5 µas), which `startracker.observer.aberrate` of the tracker neglects as well. The shapes are broadcast."""
    beta = velocity_km_s / SPEED_OF_LIGHT_KM_S
    inverse_gamma = np.sqrt(1.0 - np.add.reduce(beta * beta, axis=-1))
    return np.asarray(erfa.ufunc.ab(directions, beta, np.inf, inverse_gamma))
