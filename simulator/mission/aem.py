"""Attitude ephemeris messages, CCSDS 504.0-B-1 and 504.0-B-2, read from KVN and XML.

The quaternion (Q1, Q2, Q3, QC) of the standard describes the coordinate transformation from frame A to frame B, which
is the convention of this package as well. Euler angles are intrinsic: each rotation is about an axis of the frame that
results from the rotations before it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from simulator.mission.attitude_table import AttitudeSegment, continuous, interpolated
from simulator.mission.ccsds import Item
from simulator.mission.ccsds_names import FRAMES, named_frame
from simulator.mission.clock import Clock
from simulator.mission.segments import (
    Layout,
    WrittenSegment,
    of_object,
    polynomial_nodes,
    read_segments,
    segment_times,
)
from simulator.mission.spinning import SpinningStates, spinning
from startracker.core import FloatArray
from startracker.errors import InputError

_REQUIRED = (
    "OBJECT_NAME",
    "OBJECT_ID",
    "REF_FRAME_A",
    "REF_FRAME_B",
    "TIME_SYSTEM",
    "START_TIME",
    "STOP_TIME",
    "ATTITUDE_TYPE",
)
_COMPONENTS = ("Q1", "Q2", "Q3", "QC")
_DERIVATIVES = tuple(f"{name}_DOT" for name in _COMPONENTS)
_ANGULAR = ("ANGVEL_X", "ANGVEL_Y", "ANGVEL_Z")
_ANGLES = ("ANGLE_1", "ANGLE_2", "ANGLE_3")
_ANGLE_RATES = tuple(f"{name}_DOT" for name in _ANGLES)
_SPIN = ("SPIN_ALPHA", "SPIN_DELTA", "SPIN_ANGLE", "SPIN_ANGLE_VEL")
_TYPES: dict[str, tuple[tuple[str, ...], int]] = {
    "QUATERNION": (_COMPONENTS, 4),
    "QUATERNION/DERIVATIVE": (_COMPONENTS + _DERIVATIVES, 8),
    "QUATERNION/ANGVEL": (_COMPONENTS + _ANGULAR, 7),
    "QUATERNION/RATE": (_COMPONENTS, 7),
    "EULER_ANGLE": (_ANGLES, 3),
    "EULER_ANGLE/DERIVATIVE": (_ANGLES + _ANGLE_RATES, 6),
    "EULER_ANGLE/ANGVEL": (_ANGLES + _ANGULAR, 6),
    "EULER_ANGLE/RATE": (_ANGLES, 6),
    "SPIN": (_SPIN, 4),
    "SPIN/NUTATION": ((*_SPIN, "NUTATION", "NUTATION_PER", "NUTATION_PHASE"), 7),
    "SPIN/NUTATION_MOM": ((*_SPIN, "MOMENTUM_ALPHA", "MOMENTUM_DELTA", "NUTATION_VEL"), 7),
}
"""For each attitude type the columns that are used, and the count of numbers on a line. The rates of the types RATE are
not used, because the first version of the standard does not define their axes."""
_AXES = {"1": "X", "2": "Y", "3": "Z", "X": "X", "Y": "Y", "Z": "Z"}
_GIVES: dict[str, Literal["body", "camera"]] = {
    "SC_BODY": "body",
    "STARTRACKER": "camera",
    "AST": "camera",
    "CAMERA": "camera",
}
"""Whether a frame is that of the body or of the camera, by its name without a number (SANA's registry of spacecraft
body reference frames)."""


class AemSegments(NamedTuple):
    """Segments of an object."""

    segments: list[AttitudeSegment]
    gives: Literal["body", "camera"] | None
    """Whether the frame that is not inertial is that of the body or of the camera; None if its name does not show
    it."""
    frame: str
    """Name of that frame, with its file and line."""


def read_aem(path: Path, clock: Clock, wanted: str | None) -> AemSegments:
    """Segments of an attitude ephemeris message.

    Each segment is interpolated on its own, by the method and degree that it names, and only within its usable span:
    LINEAR and LAGRANGE interpolate the components of the quaternions, HERMITE the components and their derivatives
    (types DERIVATIVE and ANGVEL), and the result is normalised; SLERP, which is also the default, rotates at a constant
    rate. Euler angles are converted to quaternions first. Attitudes of the types SPIN are propagated from state to
    state by their own rates (`simulator.mission.spinning`), whatever the method.

    Parameters
    ----------
    path : Path
        The file, KVN or XML.
    clock : Clock
        The scenario's clock.
    wanted : str or None
        OBJECT_NAME or OBJECT_ID; needed if the file has several objects.

    Raises
    ------
    InputError
        With file and line: a damaged or truncated file, frames, a type, time scale or interpolation that are not
        supported, quaternions whose length is not 1, or no such object.
    """
    written = of_object(path, read_segments(path, "AEM", _layout), wanted, "pointing.attitude.object")
    frames = {_other_frame(segment).value.upper(): _other_frame(segment) for segment in written}
    if len(frames) > 1:
        names = " and ".join(frames)
        raise InputError(f"{path}: has attitudes of {names}; give a file with one of them")
    item = next(iter(frames.values()))
    gives = _GIVES.get(item.value.upper().rstrip("0123456789").rstrip("_"))
    return AemSegments([_segment(segment, clock) for segment in written], gives, f"{item.position}: {item.value}")


def _layout(written: WrittenSegment) -> Layout:
    given = written.item("ATTITUDE_TYPE")
    columns, count = _TYPES.get(given.value.upper().replace(" ", "_"), ((), 0))
    if not columns:
        known = ", ".join(_TYPES)
        raise InputError(f"{given.position}: attitude type {given.value} is not supported; use {known}")
    # Quaternion and derivative are four columns each, and the scalar comes first in both.
    if columns[0] == "Q1" and _scalar_first(written):
        columns = tuple(name for start in (0, 4) for name in _rotated(columns[start : start + 4]))
    return Layout(columns, (count,))


def _scalar_first(written: WrittenSegment) -> bool:
    """Whether QC is the first number of a line, which the first version of the standard permits by a keyword."""
    if "QUATERNION_TYPE" not in written.keys:
        return False
    item = written.keys["QUATERNION_TYPE"]
    if item.value.upper() not in ("FIRST", "LAST"):
        raise InputError(f"{item.position}: QUATERNION_TYPE is FIRST or LAST, not {item.value}")
    return item.value.upper() == "FIRST"


def _rotated(columns: tuple[str, ...]) -> tuple[str, ...]:
    """Quaternion components with the scalar first; other columns are returned unchanged."""
    return (columns[3], *columns[:3]) if columns[3:] and columns[3].startswith("QC") else columns


def _other_frame(written: WrittenSegment) -> Item:
    """Entry of the frame that is not inertial."""
    a, b = written.item("REF_FRAME_A"), written.item("REF_FRAME_B")
    # Exactly one of the two must be a known inertial or Earth-fixed frame.
    if bool(named_frame(a.value)) == bool(named_frame(b.value)):
        known = ", ".join(FRAMES)
        raise InputError(f"{a.position}: attitudes from {a.value} to {b.value}; one of the two must be of {known}")
    return b if named_frame(a.value) else a


def _segment(written: WrittenSegment, clock: Clock) -> AttitudeSegment:
    """Segment from the inertial frame to the other, with times in seconds after the epoch."""
    t_s, (first_s, last_s) = segment_times(written, clock, _REQUIRED)
    positions = [item.position for item in written.epochs]
    forward = named_frame(written.value("REF_FRAME_A")) != ""
    # The quaternions go from A to B unless ATTITUDE_DIR says the opposite; `forward` is whether they start in the
    # inertial frame.
    if "ATTITUDE_DIR" in written.keys:
        direction = written.keys["ATTITUDE_DIR"]
        if direction.value.upper() not in ("A2B", "B2A"):
            raise InputError(f"{direction.position}: ATTITUDE_DIR is A2B or B2A, not {direction.value}")
        forward = forward == (direction.value.upper() == "A2B")
    frame = named_frame(written.value("REF_FRAME_A")) or named_frame(written.value("REF_FRAME_B"))
    columns = dict(zip(_layout(written).columns, np.array(written.rows).T, strict=True))
    if "SPIN_ALPHA" in columns:
        return AttitudeSegment(first_s, last_s, frame, _spinning(t_s, columns, positions, forward=forward))
    quaternions, derivatives = _quaternions(written, columns)
    if not forward:
        conjugate = np.array([-1.0, -1.0, -1.0, 1.0])
        quaternions = quaternions * conjugate
        derivatives = None if derivatives is None else derivatives * conjugate
    quaternions, factor = continuous(quaternions, positions)
    if derivatives is not None:
        derivatives = derivatives * factor[:, None]
    method, nodes = _interpolation(written, derivatives is not None)
    along = interpolated(t_s, quaternions, method, nodes, derivatives)
    return AttitudeSegment(first_s, last_s, frame, along)


def _spinning(
    t_s: FloatArray, columns: dict[str, FloatArray], positions: list[str], *, forward: bool
) -> SpinningStates:
    """Attitudes of a spinning body, after a check that each state agrees with the motion from the state before."""
    if "NUTATION_PER" in columns and (wrong := np.flatnonzero(columns["NUTATION_PER"] <= 0.0)).size:
        raise InputError(f"{positions[wrong[0]]}: NUTATION_PER must be above 0 s")
    along = spinning(t_s, columns, reverse=not forward)
    along.check(positions)
    return along


def _quaternions(written: WrittenSegment, columns: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray | None]:
    """Quaternions (N, 4) in the direction of the message, scalar last, and their derivatives."""

    def of(names: tuple[str, ...]) -> FloatArray | None:
        return np.stack([columns[name] for name in names], axis=1) if names[0] in columns else None

    angles = of(_ANGLES)
    quaternions = of(_COMPONENTS) if angles is None else _from_euler(written, angles)
    assert quaternions is not None
    angular, euler_rates = of(_ANGULAR), of(_ANGLE_RATES)
    # For Euler angles ANGVEL_FRAME is optional; without it the axes of the angular velocity are unknown, and it is
    # ignored.
    if angular is not None and (angles is None or "ANGVEL_FRAME" in written.keys):
        return quaternions, _derivatives(quaternions, _in_frame_b(written, quaternions, np.radians(angular)))
    if angles is not None and euler_rates is not None:
        return quaternions, _derivatives(quaternions, _angular_velocity(written, angles, np.radians(euler_rates)))
    return quaternions, of(_DERIVATIVES)


def _in_frame_b(written: WrittenSegment, quaternions: FloatArray, rate: FloatArray) -> FloatArray:
    """Angular velocities (N, 3) of B relative to A in axes of B."""
    item = written.item("ANGVEL_FRAME")
    name = item.value.upper()
    if name in ("REF_FRAME_A", written.value("REF_FRAME_A").upper()):
        return np.asarray(Rotation.from_quat(quaternions).inv().apply(rate))
    if name not in ("REF_FRAME_B", written.value("REF_FRAME_B").upper()):
        raise InputError(f"{item.position}: ANGVEL_FRAME must be REF_FRAME_A or REF_FRAME_B, not {item.value}")
    return rate


def _angular_velocity(written: WrittenSegment, degrees: FloatArray, rates: FloatArray) -> FloatArray:
    """Angular velocities (N, 3), axes of B, from the rates (N, 3) of Euler angles.

    Each rate is about the axis of its own rotation; the rotations that follow transform that axis into B.
    """
    axes = _sequence(written)
    # From the last rotation, whose axis is an axis of B already, to the first; `following` accumulates the rotations
    # after the current one.
    total, following = np.zeros_like(rates), Rotation.identity(len(rates))
    for k in (2, 1, 0):
        about = np.zeros_like(rates)
        about[:, "XYZ".index(axes[k])] = rates[:, k]
        total += following.inv().apply(about)
        following = Rotation.from_euler(axes[k], degrees[:, k : k + 1], degrees=True) * following
    return total


def _derivatives(quaternions: FloatArray, rate: FloatArray) -> FloatArray:
    """Derivatives (N, 4) of quaternions from A to B by the angular velocity of B relative to A, q' = ½ q ⊗ (ω, 0) with
    ω in axes of B (Wertz 1978, eq. 16-3)."""
    vector, scalar = quaternions[:, :3], quaternions[:, 3:]
    along = scalar * rate + np.cross(vector, rate)
    return 0.5 * np.concatenate([along, -np.sum(vector * rate, axis=1, keepdims=True)], axis=1)


def _from_euler(written: WrittenSegment, degrees: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_euler(_sequence(written), degrees, degrees=True).as_quat())


def _sequence(written: WrittenSegment) -> str:
    """Axes of EULER_ROT_SEQ, such as ``ZXZ``."""
    item = written.item("EULER_ROT_SEQ")
    axes = "".join(_AXES.get(letter, "?") for letter in item.value.upper())
    if len(axes) != 3 or "?" in axes or axes[0] == axes[1] or axes[1] == axes[2]:
        raise InputError(f"{item.position}: '{item.value}' is not a sequence of three rotations such as ZXZ or 321")
    return axes


def _interpolation(
    written: WrittenSegment, with_derivatives: bool
) -> tuple[Literal["slerp", "lagrange", "hermite"], int]:
    """Method, and nodes of a polynomial."""
    if len(written.epochs) == 1:
        return "lagrange", 1
    if "INTERPOLATION_METHOD" not in written.keys:
        return "slerp", 2
    given = written.keys["INTERPOLATION_METHOD"]
    method = given.value.upper()
    if method == "SLERP":
        return "slerp", 2
    if method == "LINEAR":
        return "lagrange", 2
    if method not in ("LAGRANGE", "HERMITE"):
        raise InputError(
            f"{given.position}: interpolation {given.value} is not supported; use LINEAR, LAGRANGE, HERMITE or SLERP"
        )
    # Hermite's polynomial through values alone is Lagrange's
    hermite = method == "HERMITE" and with_derivatives
    return "hermite" if hermite else "lagrange", polynomial_nodes(written, "INTERPOLATION_METHOD", hermite=hermite)
