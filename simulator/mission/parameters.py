"""Plain parameters of orbit, pointing and motion, as the mission's physics takes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class OrbitParameters:
    """Circular orbit: height above the equatorial radius, inclination (``auto``: sun-synchronous), node by right
    ascension or by local mean solar time, angle from the node at the epoch, name of the propagator."""

    altitude_km: float = 800.0
    inclination_deg: float | Literal["auto"] = "auto"
    ltan_h: float | None = None
    raan_deg: float | None = None
    argument_of_latitude_deg: float = 0.0
    propagator: str = "j2"


@dataclass(frozen=True)
class Spin:
    """Free spin about body +Z (rate 0: none), whose axis cones about a direction (right ascension, declination)."""

    rate_deg_s: float = 0.0
    axis_deg: tuple[float, float] = (0.0, 90.0)
    phase_deg: float = 0.0
    cone_deg: float = 0.0
    cone_phase_deg: float = 0.0
    inertia_ratio: float = 0.1


@dataclass(frozen=True)
class PointingParameters:
    """How the camera is mounted (name or quaternion, body to camera) and what the body holds.

    Parameters
    ----------
    mounting : str or (float, float, float, float)
        Key of `simulator.mission.pointing.MOUNTINGS`, or a quaternion (x, y, z, w).
    target, target_offset_deg, target_roll_deg
        Direction (right ascension, declination, roll) or name to hold in place of the local level, where in the image
        it stands, and the camera's roll.
    offset_deg, rate_deg_s : (float, float, float)
        Fixed offset (roll, pitch, yaw) from the local level, and body rate on top of its own.
    error_deg : float
        Half width of the random offset about each axis.
    spin : Spin
        In place of the local level; off without its rate.
    """

    mounting: str | tuple[float, float, float, float] = "orbit_normal"
    target: str | Vector | None = None
    target_offset_deg: tuple[float, float] = (0.0, 0.0)
    target_roll_deg: float = 0.0
    offset_deg: Vector = (0.0, 0.0, 0.0)
    error_deg: float = 1.0
    rate_deg_s: Vector = (0.0, 0.0, 0.0)
    spin: Spin = Spin()


@dataclass(frozen=True)
class RatePoint:
    """Body rate at a time after the first frame."""

    at_s: float
    roll_deg_s: float = 0.0
    pitch_deg_s: float = 0.0
    yaw_deg_s: float = 0.0


@dataclass(frozen=True)
class Slew:
    """Turn about a fixed body axis with a trapezoid of speed."""

    turn_deg: Vector = (0.0, 0.0, 0.0)
    max_rate_deg_s: float = 2.0
    acceleration_deg_s2: float = 0.2
    start_s: float = 10.0


@dataclass(frozen=True)
class SequenceMotion:
    """Start after the epoch, step between frames, rate profile and slew of a sequence."""

    start_s: float = 0.0
    step_s: float = 0.5
    rates: tuple[RatePoint, ...] = ()
    slew: Slew = Slew()


@dataclass(frozen=True)
class Gyro:
    """Noise of a three-axis gyro in the terms of IEEE Std 952-1997."""

    angle_random_walk_deg_sqrt_h: float = 0.05
    bias_deg_h: float = 10.0
    bias_instability_deg_h: float = 0.5
    bias_time_s: float = 300.0
    scale_factor_ppm: float = 0.0
