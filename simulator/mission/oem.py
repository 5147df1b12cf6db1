"""Orbit ephemeris messages, CCSDS 502.0-B-3, read from KVN and XML."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from simulator.mission.clock import Clock
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
from simulator.mission.trajectory import BARYCENTRE, CENTRES
from startracker.errors import InputError

FRAMES = {
    "ICRF": "icrf",
    "GCRF": "icrf",
    "EME2000": "eme2000",
    "J2000": "eme2000",
    "TEME": "teme",
    "TOD": "equator_of_date",
    "ITRF": "itrf",
}
"""Reference frames that can be read; a realisation of ITRF (``ITRF2014``, ``ITRF-97``) is taken as ITRF."""

_CENTRES = {name.upper(): name for name in CENTRES} | {
    "SOLAR SYSTEM BARYCENTER": BARYCENTRE,
    "SSB": BARYCENTRE,
    "JUPITER BARYCENTER": "Jupiter",
    "SATURN BARYCENTER": "Saturn",
    "URANUS BARYCENTER": "Uranus",
    "NEPTUNE BARYCENTER": "Neptune",
}
_REQUIRED = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "START_TIME", "STOP_TIME")
_LAYOUT = Layout(("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT"), (6, 9))
"""Position and velocity, and perhaps the acceleration."""
_DEFAULT_NODES = 4
"""Nodes of Hermite's polynomial, of degree 7, where a message names no interpolation."""


def read_oem(path: Path, clock: Clock, wanted: str | None) -> TabulatedTrajectory:
    """Trajectory of an orbit ephemeris message.

    Segments are interpolated by themselves, by the method and degree that they name (LAGRANGE or HERMITE; without one,
    Hermite's polynomial of degree 7), in their own reference frame, and only within their usable span.

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
    return TabulatedTrajectory.of([_segment(segment, clock) for segment in segments], clock, str(path))


def _segment(written: WrittenSegment, clock: Clock) -> Segment:
    """Segment with times in seconds after the epoch."""
    t_s, (first_s, last_s) = segment_times(written, clock, _REQUIRED)
    method, nodes = _interpolation(written, len(t_s))
    return Segment(
        first_s, last_s, _centre(written), _frame(written), StateTable(t_s, np.array(written.rows), method, nodes)
    )


def _interpolation(written: WrittenSegment, states: int) -> tuple[Literal["lagrange", "hermite"], int]:
    """Method, and nodes of a polynomial."""
    if "INTERPOLATION" not in written.keys:
        return "hermite", min(_DEFAULT_NODES, states)
    given = written.keys["INTERPOLATION"]
    methods: dict[str, Literal["lagrange", "hermite"]] = {"LINEAR": "lagrange"}
    methods |= {"LAGRANGE": "lagrange", "HERMITE": "hermite"}
    method = methods.get(given.value.upper())
    if method is None:
        raise InputError(f"{given.position}: interpolation {given.value} is not supported; use HERMITE or LAGRANGE")
    return method, polynomial_nodes(written, "INTERPOLATION", hermite=method == "hermite")


def _centre(written: WrittenSegment) -> str:
    item = written.keys["CENTER_NAME"]
    name = " ".join(item.value.upper().split())
    if name not in _CENTRES:
        raise InputError(f"{item.position}: centre {item.value} is not supported; use {', '.join(CENTRES)}")
    return _CENTRES[name]


def _frame(written: WrittenSegment) -> str:
    item = written.keys["REF_FRAME"]
    name = item.value.upper()
    frame = FRAMES.get(name, "itrf" if name.startswith("ITRF") else "")
    if not frame:
        raise InputError(f"{item.position}: frame {item.value} is not supported; use {', '.join(FRAMES)}")
    return frame
