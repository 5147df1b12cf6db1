"""Appendix A of the thesis: the camera's matrix as printed, as it should be, and from its elementary turns."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["camera_to_celestial", "departure_from_rotation", "printed_matrix"]

FloatArray = NDArray[np.float64]

_LEVEL_FROM_FOV = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
"""(A.9): field of view (x right, y up, z against the boresight) to local level."""

FOV_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
"""From this product's camera axes (x right, y down, z along the boresight) to the thesis' of the field of view."""


def turn_z(angle_rad: float) -> FloatArray:
    """(A.1): turn of the axes about z."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def turn_y(angle_rad: float) -> FloatArray:
    """(A.2): turn of the axes about y."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def turn_x(angle_rad: float) -> FloatArray:
    """(A.3): turn of the axes about x."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def printed_matrix(u_rad: float, inclination_rad: float, gamma_rad: float, *, corrected: bool) -> FloatArray:
    """M_Total of (3.3) and (A.19), field of view to Earth axes, letter by letter or with element (3,1) corrected.

    Parameters
    ----------
    u_rad, inclination_rad : float
        Angle from the ascending node, inclination.
    gamma_rad : float
        β + π/2 − Ω.
    corrected : bool
        Element (3,1) as −cos(u + π/2) sin(π/2 − i), without which no row or column through it is a unit vector; printed
        is −cos(u + π/2) cos(π/2 − i) sin γ.
    """
    su, cu = math.sin(u_rad + math.pi / 2), math.cos(u_rad + math.pi / 2)
    si, ci = math.sin(math.pi / 2 - inclination_rad), math.cos(math.pi / 2 - inclination_rad)
    sg, cg = math.sin(gamma_rad), math.cos(gamma_rad)
    return np.array(
        [
            [-cu * ci * cg + su * sg, si * cg, -su * ci * cg - cu * sg],
            [cu * ci * sg + su * cg, -si * sg, su * ci * sg - cu * cg],
            [-cu * si if corrected else -cu * ci * sg, -ci, -su * si],
        ]
    )


def camera_to_celestial(u_rad: float, inclination_rad: float, raan_rad: float) -> FloatArray:
    """Camera to celestial axes from the turns that the text of Appendix A names, in their order.

    Local level to Earth: by u + π/2 about y, by π/2 − i about x, by −Ω about z. The printed factors (A.12) and (A.13)
    have the first about z and the second about y.
    """
    earth_from_level = turn_z(-raan_rad) @ turn_x(math.pi / 2 - inclination_rad) @ turn_y(u_rad + math.pi / 2)
    return np.asarray(earth_from_level @ _LEVEL_FROM_FOV @ FOV_FROM_CAMERA)


def departure_from_rotation(matrix: FloatArray) -> float:
    """Greatest element of |M Mᵀ − I|; 0 for a rotation."""
    return float(np.abs(matrix @ matrix.T - np.eye(3)).max())
