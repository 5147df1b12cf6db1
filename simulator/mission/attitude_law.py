"""Attitude of a body as a function of time, which replaces the local level as the reference of pointing."""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation

from startracker.core import FloatArray
from startracker.geometry.attitude import Attitude

_STEP_S = 0.01
"""Half of the interval h of the numerical derivative. The truncation error of a constant rate is (ω h)²/6 of it; a
smaller interval would suffer from the rounding of times, 4e-8 s after a year."""


@runtime_checkable
class AttitudeLaw(Protocol):
    """Attitude of the body over time; immutable and picklable."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds after the epoch; infinite where the law has no limit of its own."""
        ...

    def quaternions(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4), scalar last, that transform coordinates from ICRS to body axes, at times (T,),
        seconds after the epoch; `InputError` outside the span."""
        ...


def law_attitude(law: AttitudeLaw, t_s: float) -> Attitude:
    """Attitude ICRS → the axes that replace the local level, seconds after the epoch."""
    return Attitude(law.quaternions(np.array([t_s]))[0], "icrs", "local_level")


def law_rate_rad_s(law: AttitudeLaw, t_s: float) -> FloatArray:
    """Inertial angular velocity (3,) in the law's own axes, rad/s: the mean over 0.02 s, within the span."""
    first, last = law.span_s
    # The time itself is evaluated as well, so that a law raises its error for it and not for a neighbouring time.
    times = np.array([t_s, max(t_s - _STEP_S, first), min(t_s + _STEP_S, last)])
    low, high = (Attitude(q, "icrs", "local_level") for q in law.quaternions(times)[1:])
    turned_s = float(times[2] - times[1])
    return low.rotation_vector_to(high) / turned_s if turned_s > 0.0 else np.zeros(3)


def from_matrices(matrices: FloatArray) -> FloatArray:
    """Quaternions (T, 4) of matrices (T, 3, 3) that transform coordinates, ``v_target = matrix @ v_source``."""
    if not len(matrices):
        return np.empty((0, 4))
    # SciPy's rotations act on vectors; the quaternion of a coordinate transformation is that of the transposed matrix.
    return np.asarray(Rotation.from_matrix(np.swapaxes(matrices, -1, -2)).as_quat())


def after(first: FloatArray, second: FloatArray) -> FloatArray:
    """Quaternions (T, 4) of the transformation `second` after `first`, each (T, 4) or (4,)."""
    if not first.size or not second.size:
        return np.empty((0, 4))
    # For coordinate transformations the order is the reverse of that of rotations of vectors.
    return np.asarray((Rotation.from_quat(first) * Rotation.from_quat(second)).as_quat())


def body_of(quaternions: FloatArray, mounting: FloatArray | None) -> FloatArray:
    """Quaternions (T, 4) ICRS → body from those of a camera and its mounting (4,), body → camera; returned unchanged
    without a mounting."""
    if mounting is None:
        return quaternions
    return after(quaternions, mounting * np.array([-1.0, -1.0, -1.0, 1.0]))


def common_span_s(*spans: tuple[float, float]) -> tuple[float, float]:
    """Intersection of spans."""
    return max((s[0] for s in spans), default=-math.inf), min((s[1] for s in spans), default=math.inf)
