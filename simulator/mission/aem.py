"""Attitude ephemeris messages, CCSDS 504.0-B-1 and 504.0-B-2, read from KVN and XML.

The quaternion (Q1, Q2, Q3, QC) of the standard describes the coordinate transformation from frame A to frame B, as ours
does; Euler angles are successive rotations of the axes about the axes that result from the one before.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from simulator.mission.attitude_table import AttitudeSegment, continuous, interpolated
from simulator.mission.ccsds import Item
from simulator.mission.clock import Clock
from simulator.mission.oem import FRAMES
from simulator.mission.segments import (
    Layout,
    WrittenSegment,
    of_object,
    polynomial_nodes,
    read_segments,
    segment_times,
)
from startracker.arrays import FloatArray
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
_TYPES: dict[str, tuple[tuple[str, ...], int]] = {
    "QUATERNION": (_COMPONENTS, 4),
    "QUATERNION/DERIVATIVE": (_COMPONENTS + _DERIVATIVES, 8),
    "QUATERNION/ANGVEL": (_COMPONENTS + _ANGULAR, 7),
    "QUATERNION/RATE": (_COMPONENTS, 7),
    "EULER_ANGLE": (_ANGLES, 3),
    "EULER_ANGLE/DERIVATIVE": (_ANGLES, 6),
    "EULER_ANGLE/ANGVEL": (_ANGLES, 6),
    "EULER_ANGLE/RATE": (_ANGLES, 6),
}
"""Numbers that are used of each type, and those of a line: rates of the first version, and those beside Euler angles,
are not used."""
_FIRST = {
    4: ("QC", *_COMPONENTS[:3]),
    7: ("QC", *_COMPONENTS[:3], *_ANGULAR),
    8: ("QC", *_COMPONENTS[:3], "QC_DOT", *_DERIVATIVES[:3]),
}
"""Columns with the scalar first, by their number."""
_AXES = {"1": "X", "2": "Y", "3": "Z", "X": "X", "Y": "Y", "Z": "Z"}
_GIVES: dict[str, Literal["body", "camera"]] = {
    "SC_BODY": "body",
    "STARTRACKER": "camera",
    "AST": "camera",
    "CAMERA": "camera",
}
"""What frames are, by their names without a number (SANA's registry of spacecraft body reference frames)."""


class AemSegments(NamedTuple):
    """Segments of an object."""

    segments: list[AttitudeSegment]
    gives: Literal["body", "camera"] | None
    """What the frame that is not inertial is, by its name; None if the name leaves it open."""
    frame: str
    """Its name, with its file and line."""


def read_aem(path: Path, clock: Clock, wanted: str | None) -> AemSegments:
    """Segments of an attitude ephemeris message.

    Segments are interpolated by themselves, by the method and degree that they name, and only within their usable span:
    LINEAR and LAGRANGE through the components of the quaternions, HERMITE through components and derivatives
    (QUATERNION/DERIVATIVE, QUATERNION/ANGVEL), the result normalised; SLERP, also where none is named, by rotation at a
    constant rate. Euler angles are converted to quaternions first.

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
        supported, quaternions that are none, or no such object.
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
    columns, count = _TYPES.get(given.value.upper(), ((), 0))
    if not columns:
        known = ", ".join(_TYPES)
        raise InputError(f"{given.position}: attitude type {given.value} is not supported; use {known}")
    if columns[0] == "Q1" and _scalar_first(written):
        columns = _FIRST[len(columns)]
    return Layout(columns, (count,))


def _scalar_first(written: WrittenSegment) -> bool:
    """Whether QC is the first number of a line: in the first version of the standard by a keyword."""
    if "QUATERNION_TYPE" not in written.keys:
        return False
    item = written.keys["QUATERNION_TYPE"]
    if item.value.upper() not in ("FIRST", "LAST"):
        raise InputError(f"{item.position}: QUATERNION_TYPE is FIRST or LAST, not {item.value}")
    return item.value.upper() == "FIRST"


def _inertial(name: str) -> str:
    return FRAMES.get(name.upper(), "itrf" if name.upper().startswith("ITRF") else "")


def _other_frame(written: WrittenSegment) -> Item:
    """Entry of the frame that is not inertial."""
    a, b = written.item("REF_FRAME_A"), written.item("REF_FRAME_B")
    if bool(_inertial(a.value)) == bool(_inertial(b.value)):
        known = ", ".join(FRAMES)
        raise InputError(f"{a.position}: attitudes from {a.value} to {b.value}; one of the two must be of {known}")
    return b if _inertial(a.value) else a


def _segment(written: WrittenSegment, clock: Clock) -> AttitudeSegment:
    """Segment from the inertial frame to the other, with times in seconds after the epoch."""
    t_s, (first_s, last_s) = segment_times(written, clock, _REQUIRED)
    positions = [item.position for item in written.epochs]
    quaternions, derivatives = _quaternions(written)
    forward = _inertial(written.value("REF_FRAME_A")) != ""
    if "ATTITUDE_DIR" in written.keys:
        direction = written.keys["ATTITUDE_DIR"]
        if direction.value.upper() not in ("A2B", "B2A"):
            raise InputError(f"{direction.position}: ATTITUDE_DIR is A2B or B2A, not {direction.value}")
        forward = forward == (direction.value.upper() == "A2B")
    if not forward:
        conjugate = np.array([-1.0, -1.0, -1.0, 1.0])
        quaternions = quaternions * conjugate
        derivatives = None if derivatives is None else derivatives * conjugate
    quaternions, factor = continuous(quaternions, positions)
    if derivatives is not None:
        derivatives = derivatives * factor[:, None]
    method, nodes = _interpolation(written, derivatives is not None)
    frame = _inertial(written.value("REF_FRAME_A")) or _inertial(written.value("REF_FRAME_B"))
    along = interpolated(t_s, quaternions, method, nodes, derivatives)
    return AttitudeSegment(first_s, last_s, frame, along)


def _quaternions(written: WrittenSegment) -> tuple[FloatArray, FloatArray | None]:
    """Quaternions (N, 4) in the direction of the message, scalar last, and their derivatives."""
    columns, rows = _layout(written).columns, np.array(written.rows)
    by_name = dict(zip(columns, rows.T, strict=True))
    if "ANGLE_1" in by_name:
        return _from_euler(written, rows), None
    quaternions = np.stack([by_name[name] for name in _COMPONENTS], axis=1)
    if _DERIVATIVES[0] in by_name:
        return quaternions, np.stack([by_name[name] for name in _DERIVATIVES], axis=1)
    if _ANGULAR[0] in by_name:
        return quaternions, _derivatives(written, quaternions, rows[:, 4:7])
    return quaternions, None


def _derivatives(written: WrittenSegment, quaternions: FloatArray, degrees_s: FloatArray) -> FloatArray:
    """Derivatives (N, 4) of quaternions from A to B by the angular velocity of B relative to A, degrees per second,
    q' = ½ q ⊗ (ω, 0) with ω in axes of B (Wertz 1978, eq. 16-3)."""
    item = written.item("ANGVEL_FRAME")
    rate = np.radians(degrees_s)
    if item.value.upper() == written.value("REF_FRAME_A").upper():
        rate = Rotation.from_quat(quaternions).inv().apply(rate)
    elif item.value.upper() != written.value("REF_FRAME_B").upper():
        raise InputError(f"{item.position}: ANGVEL_FRAME must be REF_FRAME_A or REF_FRAME_B, not {item.value}")
    vector, scalar = quaternions[:, :3], quaternions[:, 3:]
    along = scalar * rate + np.cross(vector, rate)
    return 0.5 * np.concatenate([along, -np.sum(vector * rate, axis=1, keepdims=True)], axis=1)


def _from_euler(written: WrittenSegment, degrees: FloatArray) -> FloatArray:
    item = written.item("EULER_ROT_SEQ")
    axes = "".join(_AXES.get(letter, "?") for letter in item.value.upper())
    if len(axes) != 3 or "?" in axes or axes[0] == axes[1] or axes[1] == axes[2]:
        raise InputError(f"{item.position}: '{item.value}' is no sequence of three rotations such as ZXZ or 321")
    return np.asarray(Rotation.from_euler(axes, degrees, degrees=True).as_quat())


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
