"""Thermo-elastic motion of a camera's mounting around the orbit.

The structure between camera and body is heated and cooled once per orbit. Its deformation is modelled by the first
harmonic of the orbit angle u, with an amplitude A and a phase lag φ about each axis:

    θ(u) = A cos(u − φ)

Amplitudes and phases come from the thermal analysis of a spacecraft; there are no generally valid values.
"""

from __future__ import annotations

import math

import numpy as np

from simulator.mission.parameters import ThermoElastic
from startracker.core import ARCSEC_RAD, FloatArray


def angle_from_noon_rad(r_km: FloatArray, v_km_s: FloatArray, sun_direction: FloatArray) -> float:
    """Angle along the orbit from the point that is nearest to the Sun, radians in (−π, π].

    The middle of the eclipse is at π. If the Sun is along the normal of the orbit, all points are at the same distance,
    and the angle is arbitrary.

    Parameters
    ----------
    r_km, v_km_s : array, shape (3,)
        State relative to the centre of the orbit.
    sun_direction : array, shape (3,)
        Vector towards the Sun in the same axes, of any length.
    """
    normal = np.cross(r_km, v_km_s)
    normal = normal / np.linalg.norm(normal)
    return math.atan2(float(np.cross(sun_direction, r_km) @ normal), float(sun_direction @ r_km))


def mounting_rotation_rad(parameters: ThermoElastic, angle_rad: float) -> FloatArray:
    """Rotation vector (3,) of the camera from its nominal orientation, camera axes, at an orbit angle."""
    amplitude = np.array(parameters.amplitude_arcsec) * ARCSEC_RAD
    return np.asarray(amplitude * np.cos(angle_rad - np.radians(parameters.phase_deg)))
