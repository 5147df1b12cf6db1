"""Attitudes that follow a target: nadir, velocity, a point on the Earth, another spacecraft, a direction, or a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import erfa
import numpy as np
from numpy.typing import NDArray

from simulator.mission.attitude_law import common_span_s, from_matrices
from simulator.mission.clock import Clock
from simulator.mission.frames import states_to_gcrs
from simulator.mission.parameters import GroundTarget, Track
from simulator.mission.trajectory import States, Trajectory, centre_state, geocentric
from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, radec_to_direction

_LEAST_SINE = 1e-6
"""Minimum sine of the angle between target and second direction (0.2″), below which the roll is undetermined."""


class _Axes(NamedTuple):
    """Two body axes, which need not be unit vectors or perpendicular."""

    first: FloatArray
    second: FloatArray


@dataclass(frozen=True, eq=False)
class TrackingLaw:
    """Attitude law by two directions: one body axis points exactly along the first, another as closely as possible to
    the second (TRIAD; Shuster & Oh 1981, J. Guidance and Control 4, 70)."""

    track: Track
    """Target and second direction."""
    axes: _Axes
    """Body axes towards them."""
    orbit: Trajectory
    """Trajectory of the spacecraft."""
    other: Trajectory | None
    """Trajectory of the spacecraft that is followed; None for other targets."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds after the epoch."""
        return common_span_s(self.orbit.span_s, *([self.other.span_s] if self.other else []))

    def quaternions(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4) ICRS → body at times (T,).

        Raises
        ------
        InputError
            Outside the span, or where target and second direction are parallel.
        """
        own = self.orbit.state(t_s)
        target, second = self._target(t_s, States(*own)), self._second(t_s, States(*own))
        seen, close = _triads(target, second)
        if close.any():
            when = self.orbit.clock.isot(float(t_s[close][0]))
            raise InputError(
                f"pointing.track: at {when} UTC the target is along second_direction: {self.track.second_direction}, "
                "which leaves the rotation about it open; use another second_direction"
            )
        # Both matrices lead to the axes of the triad; ICRS → triad, then triad → body.
        body, _ = _triads(self.axes.first[None], self.axes.second[None])
        return from_matrices(np.swapaxes(body, -1, -2) @ seen)

    def _target(self, t_s: FloatArray, own: States) -> FloatArray:
        """Vectors (T, 3) towards the target, ICRS axes, any length."""
        # To first order only the velocity of the target relative to the spacecraft matters, so any common origin
        # serves: the Earth's centre for a point on the ground, the barycentre for the others.
        name, clock = self.track.target, self.orbit.clock
        if name == "nadir":
            return -own.r_km
        if name == "velocity":
            return own.v_km_s
        if name == "direction":
            return np.broadcast_to(radec_to_direction(*np.radians(self.track.direction_deg)), own.r_km.shape)
        if name == "ground":
            return apparent(ground_states(self.track.ground, clock, t_s), geocentric(self.orbit, t_s))
        if self.other is not None:
            return apparent(_barycentric(self.other, t_s), _barycentric(self.orbit, t_s))
        return apparent(centre_state(str(name), clock, t_s), _barycentric(self.orbit, t_s))

    def _second(self, t_s: FloatArray, own: States) -> FloatArray:
        """Vectors (T, 3) along the second direction, ICRS axes, any length."""
        name = self.track.second_direction
        if name == "Sun":
            return apparent(centre_state("Sun", self.orbit.clock, t_s), _barycentric(self.orbit, t_s))
        if name == "north":
            return np.broadcast_to([0.0, 0.0, 1.0], own.r_km.shape)
        return {"velocity": own.v_km_s, "zenith": own.r_km, "orbit_normal": np.cross(own.r_km, own.v_km_s)}[name]


def apparent(target: States, observer: States) -> FloatArray:
    """Vectors (T, 3) towards a target as an observer sees it, from states (T, 3) relative to the same origin.

    With d the distance vector and τ = |d|/c, the target is seen at its position at t − τ, displaced by the aberration
    of the observer's velocity: d + (v_observer − v_target) τ. The error of this first order in v/c and τ is 5 mas for
    planets. Light deflection is neglected.
    """
    away = target.r_km - observer.r_km
    light_s = np.linalg.norm(away, axis=-1, keepdims=True) / SPEED_OF_LIGHT_KM_S
    return np.asarray(away + (observer.v_km_s - target.v_km_s) * light_s)


def ground_states(point: GroundTarget, clock: Clock, t_s: FloatArray) -> States:
    """Geocentric states (T, 3) of a point on the Earth at times (T,), ICRF axes: WGS 84 by ERFA's ``gd2gc``, rotated as
    ITRF (`simulator.mission.frames.states_to_gcrs`)."""
    longitude, latitude = np.radians([point.longitude_deg, point.latitude_deg])
    fixed_m, _ = erfa.ufunc.gd2gc(1, longitude, latitude, point.height_km * 1e3)  # 1: WGS 84
    fixed_km = np.broadcast_to(fixed_m / 1e3, (len(t_s), 3))
    return States(*states_to_gcrs("itrf", clock, t_s, fixed_km, np.zeros_like(fixed_km)))


def build_tracking(track: Track, orbit: Trajectory, other: Trajectory | None, mounting: Attitude) -> TrackingLaw:
    """Law of a section.

    Parameters
    ----------
    track : Track
        Target and axes.
    orbit, other : Trajectory
        Trajectories of the spacecraft, and of that which it follows.
    mounting : Attitude
        Body → camera.

    Raises
    ------
    InputError
        For axes that are parallel or zero.
    """
    # By default the camera's boresight follows the target and its up axis, −y, the second direction.
    boresight, up = mounting.boresight, mounting.inverse.apply([0.0, -1.0, 0.0])
    first, second = (
        np.asarray(given if given is not None else own, dtype=float)
        for given, own in ((track.axis, boresight), (track.second_axis, up))
    )
    _, close = _triads(first[None], second[None])
    if close.any():
        raise InputError(
            f"pointing.track: axis {first.tolist()} and second_axis {second.tolist()} are parallel or zero; give two "
            "body axes"
        )
    return TrackingLaw(track, _Axes(first, second), orbit, other)


def _barycentric(trajectory: Trajectory, t_s: FloatArray) -> States:
    """Barycentric states (T, 3) of a trajectory at times (T,)."""
    r_km, v_km_s = trajectory.state(t_s)
    centre = centre_state(trajectory.centre, trajectory.clock, t_s)
    return States(r_km + centre.r_km, v_km_s + centre.v_km_s)


def _triads(first: FloatArray, second: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Matrices (T, 3, 3) whose rows are the unit vectors along a, a × b and a × (a × b) for vectors a and b (T, 3), and
    a mask (T,) of those that are parallel or zero."""
    lengths = np.linalg.norm(first, axis=-1), np.linalg.norm(second, axis=-1)
    normal = np.cross(first, second)
    sine = np.linalg.norm(normal, axis=-1)
    close = ~(sine > _LEAST_SINE * lengths[0] * lengths[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        a, b = first / lengths[0][..., None], normal / sine[..., None]
    return np.stack([a, b, np.cross(a, b)], axis=-2), close
