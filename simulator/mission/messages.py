"""Navigation messages of CCSDS written in KVN: trajectories as OEM (502.0-B-3), attitudes as AEM, and with their
variances as ACM (504.0-B-2).

Quaternions are written unchanged: (x, y, z, w) of the coordinate transformation from frame A to frame B is the
standard's definition of (Q1, Q2, Q3, QC).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from simulator.mission.ccsds_names import centre_name
from simulator.mission.clock import Clock
from simulator.mission.trajectory import Trajectory
from startracker.core import FloatArray

CAMERA_FRAME = "STARTRACKER_1"
_AXES = f"COMMENT {CAMERA_FRAME}: +z along the boresight, +x along columns, +y along rows of the image"
_HERMITE_DEGREE = 7
_EPOCH_DIGITS = 9


@dataclass(frozen=True)
class Header:
    """Header of a message."""

    name: str
    """Name of the object."""
    created: str
    """Date and time of the message, UTC."""
    comment: str = ""
    """A line about its contents."""
    object_id: str = ""
    """International designator; the name where there is none."""

    def lines(self, kind: str, version: str) -> list[str]:
        """First lines of a message of a kind."""
        comment = [f"COMMENT {self.comment}"] if self.comment else []
        return [f"CCSDS_{kind}_VERS = {version}", *comment, f"CREATION_DATE = {self.created}", "ORIGINATOR = BORESIGHT"]


def oem_text(trajectory: Trajectory, t_s: FloatArray, header: Header) -> str:
    """Orbit ephemeris message of a trajectory at times (N,), N ≥ 2, ascending: ICRF axes, UTC, Hermite interpolation of
    up to degree 7."""
    epochs = [trajectory.clock.isot(t, _EPOCH_DIGITS) for t in t_s.tolist()]
    lines = [
        *header.lines("OEM", "2.0"),
        "META_START",
        f"OBJECT_NAME = {header.name}",
        f"OBJECT_ID = {header.object_id or header.name}",
        f"CENTER_NAME = {centre_name(trajectory.centre)}",
        "REF_FRAME = ICRF",
        "TIME_SYSTEM = UTC",
        *_span(epochs),
        "INTERPOLATION = HERMITE",
        f"INTERPOLATION_DEGREE = {min(_HERMITE_DEGREE, 2 * len(epochs) - 1)}",
        "META_STOP",
    ]
    for epoch, r_km, v_km_s in zip(epochs, *trajectory.state(t_s), strict=True):
        position, velocity = (f"{x:.9f}" for x in r_km), (f"{x:.12f}" for x in v_km_s)
        lines.append(" ".join([epoch, *position, *velocity]))
    return _text(lines)


def aem_text(clock: Clock, t_s: FloatArray, quaternions: FloatArray, header: Header) -> str:
    """Attitude ephemeris message of quaternions (N, 4), scalar last, from ICRF to the camera, at times (N,)."""
    epochs = [clock.isot(t, _EPOCH_DIGITS) for t in t_s.tolist()]
    lines = [
        *header.lines("AEM", "2.0"),
        "META_START",
        _AXES,
        f"OBJECT_NAME = {header.name}",
        f"OBJECT_ID = {header.object_id or header.name}",
        "REF_FRAME_A = ICRF",
        f"REF_FRAME_B = {CAMERA_FRAME}",
        "TIME_SYSTEM = UTC",
        *_span(epochs),
        "ATTITUDE_TYPE = QUATERNION",
        "META_STOP",
        "DATA_START",
        *(" ".join([epoch, _numbers(q)]) for epoch, q in zip(epochs, quaternions, strict=True)),
        "DATA_STOP",
    ]
    return _text(lines)


def acm_text(clock: Clock, t_s: FloatArray, quaternions: FloatArray, variances_deg2: FloatArray, header: Header) -> str:
    """Attitude comprehensive message: quaternions (N, 4) as in `aem_text`, and the variances (N, 3) of the attitude
    error about the camera's axes, deg². An ACM has no correlations, only the diagonal of the covariance."""
    # Times of an ACM are seconds after EPOCH_TZERO; those of OEM and AEM are calendar dates.
    start_s = float(t_s[0])
    since = [f"{t - start_s:.9f}" for t in t_s.tolist()]
    lines = [
        *header.lines("ACM", "2.0"),
        "META_START",
        f"OBJECT_NAME = {header.name}",
        *([f"INTERNATIONAL_DESIGNATOR = {header.object_id}"] if header.object_id else []),
        "TIME_SYSTEM = UTC",
        f"EPOCH_TZERO = {clock.isot(start_s, _EPOCH_DIGITS)}",
        "META_STOP",
        "ATT_START",
        _AXES,
        "REF_FRAME_A = ICRF",
        f"REF_FRAME_B = {CAMERA_FRAME}",
        "NUMBER_STATES = 4",
        "ATT_TYPE = QUATERNION",
        *(f"{time} {_numbers(q)}" for time, q in zip(since, quaternions, strict=True)),
        "ATT_STOP",
        "COV_START",
        "COMMENT variances of the attitude error about x, y, z, deg**2",
        "COV_BASIS = SIMULATED",
        f"COV_REF_FRAME = {CAMERA_FRAME}",
        "COV_TYPE = ANGLE",
        *(f"{time} {' '.join(f'{x:.9e}' for x in row)}" for time, row in zip(since, variances_deg2, strict=True)),
        "COV_STOP",
    ]
    return _text(lines)


def _span(epochs: Sequence[str]) -> list[str]:
    return [f"START_TIME = {epochs[0]}", f"STOP_TIME = {epochs[-1]}"]


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.15f}" for value in values)


def _text(lines: Iterable[str]) -> str:
    return "\n".join(lines) + "\n"
