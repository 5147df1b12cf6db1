"""Kernel: where an observer sees the stars of a catalogue, at one epoch, from one place, at one speed."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["seen_directions"]

FloatArray = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def seen_directions(
    start: FloatArray, motion: FloatArray, parallax: FloatArray, years: float, place_au: FloatArray, beta: FloatArray
) -> FloatArray:
    """Unit vectors (N, 3), ICRS axes: space motion, annual parallax and aberration of light in one pass.

    The same as `StarCatalog.directions` and then `startracker.observer.aberrate`, which state the equations.

    Parameters
    ----------
    start, motion : (N, 3)
        Unit vectors at the catalogue's epoch, and their space motion a Julian year (`StarCatalog.space_motion`).
    parallax : (N,)
        Radians.
    years : float
        Since the catalogue's epoch.
    place_au, beta : (3,)
        The observer's barycentric position (zero: no parallax) and velocity over that of light (zero: no aberration).
    """
    out = np.empty_like(start)
    inverse_gamma = math.sqrt(1.0 - beta[0] ** 2 - beta[1] ** 2 - beta[2] ** 2)
    for i in range(len(start)):
        p = parallax[i]
        x = start[i, 0] + years * motion[i, 0] - p * place_au[0]
        y = start[i, 1] + years * motion[i, 1] - p * place_au[1]
        z = start[i, 2] + years * motion[i, 2] - p * place_au[2]
        shrink = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * shrink, y * shrink, z * shrink
        forward = 1.0 + (x * beta[0] + y * beta[1] + z * beta[2]) / (1.0 + inverse_gamma)
        x = x * inverse_gamma + beta[0] * forward
        y = y * inverse_gamma + beta[1] * forward
        z = z * inverse_gamma + beta[2] * forward
        shrink = 1.0 / math.sqrt(x * x + y * y + z * z)
        out[i, 0], out[i, 1], out[i, 2] = x * shrink, y * shrink, z * shrink
    return out
