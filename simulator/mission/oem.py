"""Orbit ephemeris messages, CCSDS 502.0-B-1 to B-3, read from KVN and XML."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from simulator.mission.ccsds_names import centre_of, frame_of
from simulator.mission.clock import Clock
from simulator.mission.epochs import elapsed_s
from simulator.mission.interpolation import StateTable
from simulator.mission.segments import (
    Layout,
    WrittenSegment,
    of_object,
    polynomial_nodes,
    read_segments,
    segment_times,
)
from simulator.mission.tabulated import Segment, TabulatedTrajectory
from startracker.errors import InputError

_REQUIRED = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "START_TIME", "STOP_TIME")
_LAYOUT = Layout(("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT"), (6, 9))
"""Position and velocity, optionally followed by the acceleration, which is not used."""
_DEFAULT_NODES = 4
"""Nodes of Hermite's polynomial of degree 7, the default for a message that names no interpolation."""


def read_oem(path: Path, clock: Clock, wanted: str | None) -> TabulatedTrajectory:
    """Trajectory of an orbit ephemeris message.

    Each segment is interpolated on its own, by the method and degree that it names (LAGRANGE or HERMITE; by default
    Hermite's polynomial of degree 7), in its own reference frame, and only within its usable span.

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
        With file and line: a damaged or truncated file, a centre, frame, time scale or interpolation that is not
        supported, or no such object.
    """
    segments = of_object(path, read_segments(path, "OEM", lambda _: _LAYOUT), wanted, "orbit.object")
    found = TabulatedTrajectory.of([_segment(segment, clock) for segment in segments], clock, str(path))
    return replace(found, object_id=segments[0].value("OBJECT_ID"))


def _segment(written: WrittenSegment, clock: Clock) -> Segment:
    """Segment with times in seconds after the epoch."""
    t_s, (first_s, last_s) = segment_times(written, clock, _REQUIRED)
    method, nodes = _interpolation(written, len(t_s))
    frame = frame_of(written.keys["REF_FRAME"], has_epoch="REF_FRAME_EPOCH" in written.keys)
    table = StateTable(t_s, np.array(written.rows), method, nodes)
    centre = centre_of(written.keys["CENTER_NAME"])
    return Segment(first_s, last_s, centre, frame, table, _frame_epoch_s(written, clock, frame))


def _interpolation(written: WrittenSegment, states: int) -> tuple[Literal["lagrange", "hermite"], int]:
    """Method, and nodes of a polynomial."""
    if "INTERPOLATION" not in written.keys:
        return "hermite", min(_DEFAULT_NODES, states)
    given = written.keys["INTERPOLATION"]
    if given.value.upper() == "LINEAR":
        return "lagrange", min(2, states)
    methods: dict[str, Literal["lagrange", "hermite"]] = {"LAGRANGE": "lagrange", "HERMITE": "hermite"}
    method = methods.get(given.value.upper())
    if method is None:
        raise InputError(f"{given.position}: interpolation {given.value} is not supported; use HERMITE or LAGRANGE")
    return method, polynomial_nodes(written, "INTERPOLATION", hermite=method == "hermite")


def _frame_epoch_s(written: WrittenSegment, clock: Clock, frame: str) -> float | None:
    """Seconds after the epoch at which the axes of date of the frame are taken; None for the time of each state."""
    # Inertial frames do not depend on a date, so a REF_FRAME_EPOCH has no effect on them.
    if "REF_FRAME_EPOCH" not in written.keys or frame in ("icrf", "eme2000"):
        return None
    item = written.keys["REF_FRAME_EPOCH"]
    if frame == "itrf":
        raise InputError(f"{item.position}: REF_FRAME_EPOCH is for axes of date; {written.value('REF_FRAME')} rotates")
    return float(elapsed_s(clock, [item.value], written.value("TIME_SYSTEM"), [item.position])[0])
