"""Slews between attitudes: about one axis with limited rate and acceleration, or along a spline of rotations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from simulator.mission.attitude_law import body_of
from simulator.mission.clock import Clock
from simulator.mission.parameters import Waypoints
from simulator.mission.trajectory import UNLIMITED, refuse_outside
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude


def trapezoid(turn_rad: float, max_rate_deg_s: float, acceleration_deg_s2: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the speed profile of the fastest slew from rest to rest within its limits, s and rad/s.

    The profile of bang-bang control about one axis is a trapezoid, or a triangle for a short slew, whose area is the
    angle. The arrays are empty for an angle of 0.
    """
    if turn_rad == 0.0:
        return np.empty(0), np.empty(0)
    acceleration = math.radians(acceleration_deg_s2)
    # A triangle of base 2 ω/a and height ω has the area ω²/a; if that is the whole angle, the maximum is not reached.
    top = min(math.radians(max_rate_deg_s), math.sqrt(turn_rad * acceleration))
    ramp, steady = top / acceleration, turn_rad / top - top / acceleration
    if steady <= 1e-9 * ramp:
        return np.array([0.0, ramp, 2.0 * ramp]), np.array([0.0, top, 0.0])
    return np.array([0.0, ramp, ramp + steady, 2.0 * ramp + steady]), np.array([0.0, top, top, 0.0])


@dataclass(frozen=True, eq=False)
class _Leg:
    """A slew about one axis of the camera."""

    start_s: float
    """Beginning of the slew, seconds after the epoch."""
    first: FloatArray
    """(4,): Quaternion ICRS → camera before the slew."""
    axis: FloatArray
    """(3,): Unit vector, camera axes."""
    corners_s: FloatArray
    """(C,): Corners of the speed profile after the beginning, from `trapezoid`."""
    speeds_rad_s: FloatArray
    """(C,): Speeds at the corners."""

    def angle_rad(self, t_s: FloatArray) -> FloatArray:
        """Rotation angle (T,) at times (T,): 0 before the slew, and the whole angle after it."""
        # The integral of the speed, summed over its linear parts; each contributes the time spent in it so far.
        since = t_s - self.start_s
        angle = np.zeros_like(since)
        for k in range(len(self.corners_s) - 1):
            length = self.corners_s[k + 1] - self.corners_s[k]
            share = np.clip(since - self.corners_s[k], 0.0, length)
            gain = (self.speeds_rad_s[k + 1] - self.speeds_rad_s[k]) / length
            angle += share * (self.speeds_rad_s[k] + 0.5 * gain * share)
        return angle


@dataclass(frozen=True, eq=False)
class SlewLaw:
    """Rest at the first attitude, and slews that end at the times of the others."""

    legs: tuple[_Leg, ...]
    """The slews in order of time."""
    first: FloatArray
    """(4,): First attitude of the camera."""
    mounting: FloatArray
    """(4,): Quaternion body → camera."""

    @property
    def span_s(self) -> tuple[float, float]:
        """Without limits: the body rests before and after."""
        return UNLIMITED

    def quaternions(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4) ICRS → body at times (T,)."""
        camera = np.tile(self.first, (len(t_s), 1))
        # Legs are in order of time, so the last leg that has begun overwrites the attitudes of those before.
        for leg in self.legs:
            begun = t_s > leg.start_s
            if begun.any():
                turned = Rotation.from_rotvec(leg.angle_rad(t_s[begun])[:, None] * leg.axis)
                camera[begun] = (Rotation.from_quat(leg.first) * turned).as_quat()
        return body_of(camera, self.mounting)


@dataclass(frozen=True, eq=False)
class SplineLaw:
    """A cubic spline of rotations with continuous angular acceleration, from the first attitude to the last."""

    clock: Clock
    """Epoch."""
    span_s: tuple[float, float]
    """Times of the first and last attitude."""
    along: RotationSpline
    """Attitudes of the camera."""
    mounting: FloatArray
    """(4,): Body → camera."""

    def quaternions(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4) ICRS → body at times (T,); `InputError` outside the span."""
        refuse_outside(self.clock, t_s, self.span_s, "pointing.waypoints")
        return body_of(self.along(t_s).as_quat(), self.mounting) if len(t_s) else np.empty((0, 4))


def build_slews(parameters: Waypoints, clock: Clock, mounting: FloatArray) -> SlewLaw | SplineLaw:
    """Law of a section.

    Parameters
    ----------
    parameters : Waypoints
        At least one attitude; for ``spline`` two.
    clock : Clock
        The scenario's clock.
    mounting : array, shape (4,)
        Quaternion body → camera.

    Raises
    ------
    InputError
        For times that do not ascend, a spline through one attitude, or a slew that takes longer than it has.
    """
    points = parameters.points
    for before, after in pairwise(points):
        if after.at_s <= before.at_s:
            raise InputError(
                f"pointing.waypoints: points must be in order of time; {after.at_s:g} s comes after {before.at_s:g} s"
            )
    times = [point.at_s for point in points]
    cameras = [Attitude.from_radec_roll(p.ra_deg, p.dec_deg, p.roll_deg).quat for p in points]
    if parameters.profile == "spline":
        if len(points) < 2:
            raise InputError("pointing.waypoints: a spline needs two points or more; use profile: eigenaxis for one")
        return SplineLaw(clock, (times[0], times[-1]), RotationSpline(times, Rotation.from_quat(cameras)), mounting)
    legs = [_leg(parameters, cameras[k], cameras[k + 1], times[k], times[k + 1]) for k in range(len(points) - 1)]
    return SlewLaw(tuple(leg for leg in legs if leg is not None), cameras[0], mounting)


def _leg(limits: Waypoints, first: FloatArray, last: FloatArray, free_s: float, end_s: float) -> _Leg | None:
    """Slew that ends at `end_s` and starts at `free_s` or later; None if the attitudes are the same."""
    # In this order the rotation vector is in the axes of the first attitude, to which `SlewLaw` applies it.
    turn = (Rotation.from_quat(first).inv() * Rotation.from_quat(last)).as_rotvec()
    angle = float(np.linalg.norm(turn))
    corners, speeds = trapezoid(angle, limits.max_rate_deg_s, limits.acceleration_deg_s2)
    if not len(corners):
        return None
    if corners[-1] > end_s - free_s:
        raise InputError(
            f"pointing.waypoints: the slew of {math.degrees(angle):.4g}° to the attitude at {end_s:g} s takes "
            f"{corners[-1]:.4g} s, and {end_s - free_s:g} s are left; give it more time, or raise max_rate_deg_s or "
            "acceleration_deg_s2"
        )
    return _Leg(end_s - float(corners[-1]), first, turn / angle, corners, speeds)
