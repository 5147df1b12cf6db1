"""True attitude of the body over a sequence of frames.

The body rotates relative to a reference (the local level, which rotates with the orbit; the axes of a free spin or of
an attitude law; or an inertial attitude) at a rate that is a piecewise linear function of time in body axes:
``pointing.rate_deg_s``, plus ``sequence.rates``, plus the trapezoid of ``sequence.slew``. With S the rotation relative
to the reference, C the rotation of the body at the start (offset and random error) and L the reference,

    A_body(t) = S(t) C L(t),    dS/dt = −[ω_rel(t) ×] S,    ω_body = S C ω_L + ω_rel.

S is integrated by Magnus' series to the fourth order, which is exact if the direction of ω_rel is constant.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simulator.mission.attitude_law import AttitudeLaw, law_attitude, law_rate_rad_s
from simulator.mission.parameters import PointingParameters, SequenceMotion, Slew, Spin
from simulator.mission.pointing import Pointing, local_level
from simulator.mission.slews import trapezoid
from simulator.mission.spin import spin_attitude, spin_rate_rad_s
from simulator.mission.trajectory import Trajectory
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.geometry.attitude import Attitude

_LARGEST_TURN_RAD = 0.02
"""Maximum rotation in one step of the integration."""
_LONGEST_STEP_S = 0.1
"""Maximum length of a step: the next term of the series, ω ω'² h⁵ / 240, is below 1e-12 rad at 2°/s and 2°/s²."""
_LEVEL_STEP_S = 1.0
"""Half of the interval of the numerical derivative of the local level; the relative error is (n t)² / 6."""


@dataclass(frozen=True, eq=False)
class MotionState:
    """The body at one instant."""

    t_s: float
    """Seconds after the scenario's epoch."""
    camera: Attitude
    """ICRS to camera."""
    rate_camera_rad_s: FloatArray
    """(3,): Inertial angular velocity, camera axes."""

    __repr__ = fields_repr


@dataclass(frozen=True, eq=False)
class RateProfile:
    """Piecewise linear rate, constant before the first and after the last point."""

    t_s: FloatArray
    """(N,): Seconds after the first frame, ascending."""
    rate_rad_s: FloatArray
    """(N, 3): Body axes."""

    __repr__ = fields_repr

    def at(self, t_s: float) -> FloatArray:
        """Rate (3,) at a time."""
        return np.array([np.interp(t_s, self.t_s, column) for column in self.rate_rad_s.T])

    def turn(self, start_s: float, end_s: float) -> Attitude:
        """Rotation (body → body) from one time to a later one.

        Magnus' series for dS/dt = −[ω×] S with two Gauss points per step h (Iserles & Nørsett 1999; Blanes et al. 2009,
        Physics Reports 470, 151, eq. 253): the rotation vector is h (ω₁ + ω₂)/2 + √3 h² (ω₁ × ω₂)/12.
        """
        # The rate is smooth only between its corners, so no step may cross one. `from_rotation_vector` is a rotation
        # of the axes, which has the sign of −[ω×].
        inner = self.t_s[(self.t_s > start_s) & (self.t_s < end_s)]
        turned = Attitude(np.array([0.0, 0.0, 0.0, 1.0]), "body", "body")
        corners = [start_s, *inner, end_s]
        for low, high in pairwise(corners):
            ends = self.at(low), self.at(high)
            steps = 1  # one step is exact for a constant rate
            if (ends[0] != ends[1]).any():
                fastest = max(float(np.linalg.norm(rate)) for rate in ends)  # the rate is linear between the ends
                steps = math.ceil((high - low) * max(fastest / _LARGEST_TURN_RAD, 1.0 / _LONGEST_STEP_S))
            h = (high - low) / steps
            for k in range(steps):
                middle, gauss = low + (k + 0.5) * h, h / (2.0 * math.sqrt(3.0))
                first, second = self.at(middle - gauss), self.at(middle + gauss)
                vector = 0.5 * h * (first + second) + math.sqrt(3.0) / 12.0 * h**2 * np.cross(first, second)
                turned = Attitude.from_rotation_vector(vector, "body", "body") @ turned
        return turned


def rate_profile(pointing: PointingParameters, sequence: SequenceMotion) -> RateProfile:
    """Rate of the body relative to its reference over a sequence: sum of constant rate, profile and slew."""
    # The sum of piecewise linear functions is linear between the union of their corners.
    points = np.array([p.at_s for p in sequence.rates])
    corners, speeds = _trapezoid(sequence.slew)
    times = np.unique(np.concatenate([[0.0], points, corners]))
    rate = np.tile(np.radians(pointing.rate_deg_s), (len(times), 1))
    if len(points):
        given = np.radians([[p.roll_deg_s, p.pitch_deg_s, p.yaw_deg_s] for p in sequence.rates])
        rate += np.stack([np.interp(times, points, column) for column in given.T], axis=1)
    if len(corners):
        axis = np.array(sequence.slew.turn_deg) / np.linalg.norm(sequence.slew.turn_deg)
        rate += np.interp(times, corners, speeds)[:, None] * axis
    return RateProfile(times, rate)


def _trapezoid(slew: Slew) -> tuple[FloatArray, FloatArray]:
    """Corners of a slew's speed profile after the first frame, s and rad/s."""
    turn = math.radians(math.hypot(*slew.turn_deg))
    corners, speeds = trapezoid(turn, slew.max_rate_deg_s, slew.acceleration_deg_s2)
    return slew.start_s + corners, speeds


class BodyMotion:
    """Attitude and rate of the body, integrated from one instant to the next.

    Parameters
    ----------
    pointing, sequence : sections
        As in the scenario. The reference is, with ``pointing.target``, the inertially fixed initial attitude; with
        ``pointing.spin``, the spinning principal axes; with an attitude law, its axes; otherwise the local level.
    orbit : Trajectory
        The trajectory; the local level refers to its centre.
    start : Pointing
        Attitude at the first frame, without jitter.
    law : AttitudeLaw, optional
        That of the section (`simulator.mission.attitudes`).
    """

    def __init__(
        self,
        pointing: PointingParameters,
        sequence: SequenceMotion,
        orbit: Trajectory,
        start: Pointing,
        law: AttitudeLaw | None = None,
    ) -> None:
        self.profile = rate_profile(pointing, sequence)
        if pointing.target is not None:
            self._reference, self._rate_of = _inertial(start)
        elif pointing.spin.rate_deg_s:
            self._reference, self._rate_of = _spinning(pointing.spin)
        elif law is not None:
            self._reference, self._rate_of = (
                functools.partial(law_attitude, law),
                functools.partial(law_rate_rad_s, law),
            )
        else:
            self._reference, self._rate_of = _level(orbit)
        # C of the module's docstring, the rotation from the reference to the body at the start, and S, which starts as
        # the identity.
        self._start, self._start_s = start, sequence.start_s
        self._at_start = start.body @ self._reference(sequence.start_s).inverse
        self._turned = Attitude(np.array([0.0, 0.0, 0.0, 1.0]), "body", "body")
        self._before_s = 0.0

    def at(self, now_s: float) -> MotionState:
        """State without jitter at a time, s after the first frame, and not before the time of the last call."""
        if now_s > self._before_s:
            self._turned = self.profile.turn(self._before_s, now_s) @ self._turned
        self._before_s, t_s = now_s, self._start_s + now_s
        in_reference = self._turned @ self._at_start
        rate_body = in_reference.apply(self._rate_of(t_s)) + self.profile.at(now_s)
        camera = self._start.mounting @ in_reference @ self._reference(t_s)
        return MotionState(t_s, camera, self._start.mounting.apply(rate_body))

    def add_rate(self, rate_rad_s: FloatArray) -> None:
        """Add a rate (3,), rad/s in body axes, from the time of the last call of `at`."""
        self.profile = RateProfile(self.profile.t_s, self.profile.rate_rad_s + rate_rad_s)


def motion(
    pointing: PointingParameters,
    sequence: SequenceMotion,
    orbit: Trajectory,
    start: Pointing,
    since_s: Sequence[float],
    law: AttitudeLaw | None = None,
) -> list[MotionState]:
    """True states of a `BodyMotion` at the times of a sequence.

    Parameters
    ----------
    pointing, sequence, orbit, start, law
        As for `BodyMotion`.
    since_s : sequence of float
        Times after the first frame in ascending order, from 0.
    """
    body = BodyMotion(pointing, sequence, orbit, start, law)
    return [body.at(now_s) for now_s in since_s]


def on_mounting(state: MotionState, rotation_rad: FloatArray | None) -> MotionState:
    """Motion of a camera whose mounting is rotated by a vector (3,) in camera axes; the rate of this rotation is
    neglected."""
    if rotation_rad is None:
        return state
    turn = Attitude.from_rotation_vector(rotation_rad, "camera", "camera")
    return MotionState(state.t_s, turn @ state.camera, turn.apply(state.rate_camera_rad_s))


def _inertial(start: Pointing) -> tuple[Callable[[float], Attitude], Callable[[float], FloatArray]]:
    """Inertially fixed reference: the initial attitude of the body."""
    return lambda t_s: start.body, lambda t_s: np.zeros(3)


def _spinning(spin: Spin) -> tuple[Callable[[float], Attitude], Callable[[float], FloatArray]]:
    """The principal axes of a freely spinning body, and their inertial rate in their own axes."""
    return lambda t_s: spin_attitude(spin, t_s), lambda t_s: spin_rate_rad_s(spin, t_s)


def _level(orbit: Trajectory) -> tuple[Callable[[float], Attitude], Callable[[float], FloatArray]]:
    """The local level, and its inertial rate in its own axes: (0, −n, 0) and the precession of the orbit's plane."""

    def level(t_s: float) -> Attitude:
        return local_level(*orbit.state(t_s))

    def rate(t_s: float) -> FloatArray:
        first, last = orbit.span_s  # near an end of the trajectory the difference is one-sided
        low, high = max(t_s - _LEVEL_STEP_S, first), min(t_s + _LEVEL_STEP_S, last)
        return level(low).rotation_vector_to(level(high)) / (high - low)

    return level, rate
