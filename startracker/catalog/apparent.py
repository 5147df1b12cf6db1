"""Kernel: apparent directions of catalogue stars for an observer at a given epoch, position and velocity."""

from __future__ import annotations

import numpy as np

from startracker.core import FloatArray
from startracker.kernels import pixel_kernel
from startracker.observer import aberrated


@pixel_kernel
def apparent_directions(
    start: FloatArray, motion: FloatArray, parallax: FloatArray, years: float, position_au: FloatArray, beta: FloatArray
) -> FloatArray:
    """Unit vectors (N, 3), ICRS axes, with space motion, annual parallax and aberration of light.

    Equivalent to `StarCatalog.directions` followed by `startracker.observer.aberrate`, which state the equations.

    Parameters
    ----------
    start, motion : (3, N)
        Unit vectors at the catalogue's epoch, and their space motion per Julian year (`StarCatalog.space_motion`). One
        axis per row allows vectorisation over eight stars.
    parallax : (N,)
        Radians.
    years : float
        Time since the catalogue's epoch.
    position_au, beta : (3,)
        The observer's barycentric position (zero: no parallax) and velocity divided by the speed of light (zero: no
        aberration).
    """
    out = np.empty((start.shape[1], 3))
    velocity = (beta[0], beta[1], beta[2])
    for i in range(start.shape[1]):
        p = parallax[i]
        x = start[0, i] + years * motion[0, i] - p * position_au[0]
        y = start[1, i] + years * motion[1, i] - p * position_au[1]
        z = start[2, i] + years * motion[2, i] - p * position_au[2]
        out[i, 0], out[i, 1], out[i, 2] = aberrated(x, y, z, velocity)
    return out
