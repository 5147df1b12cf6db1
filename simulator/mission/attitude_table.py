"""Attitudes given by tables of quaternions: their interpolation, and tables in CSV and Parquet."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from simulator.mission.attitude_law import after, body_of, from_matrices
from simulator.mission.clock import Clock
from simulator.mission.frames import to_frame
from simulator.mission.interpolation import StateTable
from simulator.mission.pointing import level_matrices
from simulator.mission.spinning import LARGEST_STEP_DEG
from simulator.mission.tables import read_rows
from simulator.mission.tabulated import RESOLUTION_S, Part, piecewise
from simulator.mission.trajectory import Trajectory
from startracker.core import FloatArray
from startracker.errors import InputError

QUATERNION_COLUMNS = ("qx", "qy", "qz", "qw")
LOCAL_LEVEL = "local_level"
"""Axes of the local level (`simulator.mission.pointing.local_level`)."""
LENGTH_TOLERANCE = 1e-3
"""Deviation of a quaternion's length from 1 that is accepted as the rounding of a file with few decimals."""
_BORESIGHT_TOLERANCE_DEG = 0.01


class Interpolation(Protocol):
    """Quaternions over time."""

    def __call__(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4) at times (T,)."""
        ...


@dataclass(frozen=True, eq=False)
class _Polynomials:
    """Polynomials through the components, normalised."""

    table: StateTable

    def __call__(self, t_s: FloatArray) -> FloatArray:
        found = self.table.state(t_s)[:, :4]
        return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class _Rotations:
    """SciPy's interpolation of rotations."""

    along: Slerp | RotationSpline
    first_s: float
    last_s: float

    def __call__(self, t_s: FloatArray) -> FloatArray:
        if not len(t_s):
            return np.empty((0, 4))
        return np.asarray(self.along(np.clip(t_s, self.first_s, self.last_s)).as_quat())


def interpolated(
    t_s: FloatArray,
    quaternions: FloatArray,
    method: Literal["slerp", "spline", "lagrange", "hermite"],
    nodes: int = 2,
    derivatives: FloatArray | None = None,
) -> Interpolation:
    """Interpolation of attitudes.

    Parameters
    ----------
    t_s : array, shape (N,)
        Ascending times, N ≥ 2, or N = 1 for a polynomial of one node.
    quaternions : array, shape (N, 4)
        From `continuous`.
    method : str
        ``slerp``: constant rate between two attitudes (Shoemake 1985); ``spline``: cubic spline of rotations with
        continuous angular acceleration (SciPy's ``RotationSpline``); ``lagrange``: polynomials through the components
        of `nodes` quaternions, normalised; ``hermite``: the same with `derivatives`.
    nodes : int
        Nodes of a polynomial.
    derivatives : array, shape (N, 4), optional
        Of the quaternions, 1/s.
    """
    if method in ("slerp", "spline"):
        kind = Slerp if method == "slerp" else RotationSpline
        return _Rotations(kind(t_s, Rotation.from_quat(quaternions)), float(t_s[0]), float(t_s[-1]))
    if method == "hermite":
        assert derivatives is not None
        return _Polynomials(StateTable(t_s, np.concatenate([quaternions, derivatives], axis=1), "hermite", nodes))
    return _Polynomials(StateTable(t_s, quaternions, "lagrange", nodes))


def continuous(quaternions: FloatArray, positions: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Unit quaternions (N, 4) without changes of sign from row to row, and the factors (N,) that were applied.

    Raises
    ------
    InputError
        With the position of a quaternion whose length is not 1, or that is more than 170° from the one before.
    """
    length = np.linalg.norm(quaternions, axis=1)
    if (wrong := np.flatnonzero(~(np.abs(length - 1.0) < LENGTH_TOLERANCE))).size:
        k = wrong[0]
        raise InputError(
            f"{positions[k]}: the quaternion has a length of {length[k]:.6g}; attitudes are unit quaternions"
        )
    unit = quaternions / length[:, None]
    # The scalar product of two unit quaternions is the cosine of half the angle between them, up to the sign: q and −q
    # are the same attitude.
    agreement = np.sum(unit[1:] * unit[:-1], axis=1)
    if (far := np.flatnonzero(np.abs(agreement) < math.cos(math.radians(LARGEST_STEP_DEG / 2.0)))).size:
        k = far[0]
        turn_deg = math.degrees(2.0 * math.acos(abs(agreement[k])))
        raise InputError(
            f"{positions[k + 1]}: {turn_deg:.0f}° from the attitude before, which does not determine the direction of "
            "the rotation; give attitudes at shorter steps"
        )
    factor = np.concatenate([[1.0], np.cumprod(np.where(agreement < 0.0, -1.0, 1.0))]) / length
    return quaternions * factor[:, None], factor


@dataclass(frozen=True, eq=False)
class AttitudeSegment:
    """Attitudes over a span."""

    first_s: float
    """Beginning of the usable span, seconds after the epoch."""
    last_s: float
    """End of the usable span."""
    frame: str
    """Axes from which the quaternions transform (`simulator.mission.frames.to_frame`, or ``local_level``), and in which
    they are interpolated."""
    quaternions: Interpolation
    """Quaternions from those axes to the axes of the law."""


@dataclass(frozen=True, eq=False)
class TabulatedAttitude:
    """Segments in order of time. Where two overlap, the later one is used; in a gap between two, and outside all of
    them, there is no attitude."""

    clock: Clock
    """Epoch."""
    segments: tuple[AttitudeSegment, ...]
    """The segments by their first times."""
    name: str
    """The file, for messages."""
    mounting: FloatArray | None
    """(4,): Quaternion from body to camera, if the file has the attitudes of the camera."""
    orbit: Trajectory | None = None
    """Trajectory to whose local level the frame ``local_level`` refers."""

    @classmethod
    def of(
        cls,
        segments: Sequence[AttitudeSegment],
        clock: Clock,
        name: str,
        mounting: FloatArray | None,
        orbit: Trajectory | None = None,
    ) -> TabulatedAttitude:
        """Law of at least one segment, whose spans are extended by the resolution of epochs."""
        wider = [replace(s, first_s=s.first_s - RESOLUTION_S, last_s=s.last_s + RESOLUTION_S) for s in segments]
        return cls(clock, tuple(sorted(wider, key=lambda segment: segment.first_s)), name, mounting, orbit)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds after the epoch."""
        return self.segments[0].first_s, max(segment.last_s for segment in self.segments)

    def quaternions(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4) ICRS → body at times (T,); `InputError` outside the span, or in a gap."""
        parts = [Part(s.first_s, s.last_s, functools.partial(self._of, s)) for s in self.segments]
        return body_of(piecewise(parts, self.clock, t_s, self.name, "attitudes"), self.mounting)

    def _of(self, segment: AttitudeSegment, t_s: FloatArray) -> FloatArray:
        # The interpolation is in the frame of the segment, as the standards require; the result is transformed to ICRF.
        own = segment.quaternions(t_s)
        if segment.frame == "icrf":
            return own
        if segment.frame == LOCAL_LEVEL:
            assert self.orbit is not None
            axes = level_matrices(*self.orbit.state(t_s))
        else:
            axes = np.broadcast_to(to_frame(segment.frame, self.clock, t_s), (len(t_s), 3, 3))
        return after(from_matrices(axes), own)


def read_attitude_table(
    path: Path,
    clock: Clock,
    frame: str,
    method: Literal["slerp", "spline"],
    mounting: FloatArray | None,
    orbit: Trajectory | None = None,
) -> TabulatedAttitude:
    """Law of a table in CSV or Parquet.

    Its columns are ``utc`` (ISO 8601) or ``t_s`` (seconds after the scenario's epoch), and ``qx``, ``qy``, ``qz``,
    ``qw``: the unit quaternion, scalar last, that transforms coordinates from the axes `frame` to those of the body or
    the camera. If the table has the columns ``ra_deg`` and ``dec_deg``, the boresight of the camera (ICRS), they are
    compared with the quaternions, which detects a quaternion of another convention.

    Parameters
    ----------
    path : Path
        The file.
    clock : Clock
        The scenario's clock.
    frame : str
        As for `simulator.mission.frames.to_frame`, or ``local_level``.
    method : str
        As for `interpolated`.
    mounting : array, shape (4,), optional
        Quaternion from body to camera, if the table has the attitudes of the camera.
    orbit : Trajectory, optional
        Trajectory of the spacecraft. Without it, attitudes relative to ``local_level`` can be read, but not evaluated.

    Raises
    ------
    InputError
        With file and line: as for `simulator.mission.tables.read_rows` and `continuous`, and for a direction that
        contradicts its quaternion.
    """
    t_s, values, positions = read_rows(path, clock, QUATERNION_COLUMNS, ("ra_deg", "dec_deg"))
    quaternions, _ = continuous(values[:, :4], positions)
    segment = AttitudeSegment(float(t_s[0]), float(t_s[-1]), frame, interpolated(t_s, quaternions, method))
    law = TabulatedAttitude.of([segment], clock, str(path), mounting, orbit)
    if mounting is not None and values.shape[1] > 4 and (orbit is not None or frame != LOCAL_LEVEL):
        cameras = replace(law, mounting=None).quaternions(t_s)
        _compare_directions(cameras, np.radians(values[:, 4:]), positions)
    return law


def _compare_directions(quaternions: FloatArray, stated_rad: FloatArray, positions: Sequence[str]) -> None:
    """Compare boresights of attitudes with stated right ascensions and declinations (N, 2)."""
    boresight = Rotation.from_quat(quaternions).apply([0.0, 0.0, 1.0])
    ra, dec = stated_rad.T
    stated = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    # The angle follows from the chord, because arccos loses all digits of a small angle.
    off_deg = np.degrees(2.0 * np.arcsin(np.minimum(np.linalg.norm(boresight - stated, axis=1) / 2.0, 1.0)))
    if (wrong := np.flatnonzero(~(off_deg < _BORESIGHT_TOLERANCE_DEG))).size:
        k = wrong[0]
        raise InputError(
            f"{positions[k]}: the boresight by the quaternion is {off_deg[k]:.3g}° from ra_deg and dec_deg; "
            "quaternions are scalar last and transform coordinates from the frame to the camera (v_camera = A v_frame)"
        )
