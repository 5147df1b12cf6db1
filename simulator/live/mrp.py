"""Modified Rodrigues parameters and Euler parameters in the conventions of Basilisk.

Basilisk's σ_BN = e tan(Φ/4) is that of the matrix [BN], which transforms coordinates from N to B: e and Φ are the axis
and the angle by which the frame B is rotated from N (Schaub & Junkins, *Analytical Mechanics of Space Systems*, section
3.5). Its quaternions are Euler parameters of the same matrix, scalar first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

__all__ = ["attitude_of_mrp", "euler_parameters", "mrp_of_attitude"]


def attitude_of_mrp(sigma: ArrayLike, source: str = "inertial", target: str = "body") -> Attitude:
    """Attitude of the modified Rodrigues parameters σ (3,), of either set.

    β = (1 − σ², 2 σ)/(1 + σ²), scalar first.

    Raises
    ------
    InputError
        For anything but three finite numbers.
    """
    s = np.array(sigma, dtype=float)
    if s.shape != (3,) or not np.isfinite(s).all():
        raise InputError(f"modified Rodrigues parameters are three finite numbers; got {sigma!r}")
    return Attitude(np.append(2.0 * s, 1.0 - float(s @ s)), source, target)


def mrp_of_attitude(attitude: Attitude) -> FloatArray:
    """Modified Rodrigues parameters (3,) of an attitude: the set with |σ| ≤ 1."""
    return np.asarray(attitude.quat[:3] / (1.0 + attitude.quat[3]))


def euler_parameters(attitude: Attitude) -> FloatArray:
    """Euler parameters (4,), scalar first and not negative."""
    return np.roll(attitude.quat, 1)
