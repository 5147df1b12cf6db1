"""A freely spinning body: its axis of symmetry precesses about the angular momentum, which is inertially fixed.

With equal moments of inertia I across the axis of symmetry (body +Z) and r I about it, the torque-free Euler equations
are solved by uniform rotations (Goldstein, Poole & Safko 2002, *Classical Mechanics*, section 5.6). With ω the angular
velocity about +Z and θ the half angle of the cone, the axis precesses about the angular momentum at

    Ω = r ω / cos θ,

and the body rotates about its own axis relative to that motion at (1 − r) ω. The angular velocity is their sum.
"""

from __future__ import annotations

import math

import numpy as np

from simulator.mission.parameters import Spin
from startracker.core import FloatArray
from startracker.geometry.attitude import Attitude, radec_to_direction


def cone_rate_rad_s(spin: Spin) -> float:
    """Precession rate Ω of the axis about the angular momentum, right-handed, rad/s."""
    return spin.inertia_ratio * math.radians(spin.rate_deg_s) / math.cos(math.radians(spin.cone_deg))


def spin_attitude(spin: Spin, t_s: float) -> Attitude:
    """Attitude ICRS → principal axes, seconds after the epoch; these axes replace the local level.

    If all angles are zero, X, Y and Z point to the east, to the north and along the angular momentum. From there the
    body is tilted onto its cone by the smallest rotation, and rotated about +Z.
    """
    ra, dec = (math.radians(angle) for angle in spin.axis_deg)
    east = np.array([-math.sin(ra), math.cos(ra), 0.0])
    axis = radec_to_direction(ra, dec)
    still = Attitude.from_matrix(np.stack([east, np.cross(axis, east), axis]), "icrs", "local_level")
    # The position angle on the cone grows from north through east, which is left-handed about the axis, and so the
    # right-handed precession decreases it.
    on_cone = math.radians(spin.cone_phase_deg) - cone_rate_rad_s(spin) * t_s
    node = np.array([-math.cos(on_cone), math.sin(on_cone), 0.0])
    tilt = Attitude.from_rotation_vector(math.radians(spin.cone_deg) * node, "local_level", "local_level")
    # The tilt moves with the precession but does not turn about +Z, so Ω is part of the rotation about +Z as well.
    angle = math.radians(spin.phase_deg) + (_own_rate_rad_s(spin) + cone_rate_rad_s(spin)) * t_s
    turn = Attitude.from_rotation_vector([0.0, 0.0, math.remainder(angle, math.tau)], "local_level", "local_level")
    return turn @ tilt @ still


def spin_rate_rad_s(spin: Spin, t_s: float) -> FloatArray:
    """Inertial angular velocity (3,) in principal axes, seconds after the epoch: (1 − r) ω about +Z and Ω about the
    angular momentum; its component along +Z is `rate_deg_s`."""
    ra, dec = (math.radians(angle) for angle in spin.axis_deg)
    momentum = spin_attitude(spin, t_s).apply(radec_to_direction(ra, dec))
    return np.asarray(cone_rate_rad_s(spin) * momentum + np.array([0.0, 0.0, _own_rate_rad_s(spin)]))


def _own_rate_rad_s(spin: Spin) -> float:
    return (1.0 - spin.inertia_ratio) * math.radians(spin.rate_deg_s)
