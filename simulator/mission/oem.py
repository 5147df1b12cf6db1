"""Orbit ephemeris messages, CCSDS 502.0-B-3, read from KVN and XML."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulator.mission.ccsds import Item, read_items
from simulator.mission.clock import Clock
from simulator.mission.epochs import elapsed_s
from simulator.mission.interpolation import StateTable
from simulator.mission.tabulated import Segment, TabulatedTrajectory
from simulator.mission.trajectory import BARYCENTRE, CENTRES
from startracker.errors import InputError

__all__ = ["FRAMES", "read_oem"]

FloatArray = NDArray[np.float64]

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
_COLUMNS = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
_DEFAULT_NODES = 4
"""Nodes of Hermite's polynomial, of degree 7, where a message names no interpolation."""


@dataclass
class _Block:
    """A segment as it is written."""

    position: str
    keys: dict[str, Item] = field(default_factory=dict)
    epochs: list[Item] = field(default_factory=list)
    states: list[list[float]] = field(default_factory=list)

    def value(self, key: str) -> str:
        if key not in self.keys:
            raise InputError(f"{self.position}: the metadata has no {key}")
        return self.keys[key].value


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
    blocks = _blocks(path, read_items(path, "OEM"))
    objects = {(b.value("OBJECT_NAME"), b.value("OBJECT_ID")) for b in blocks}
    chosen = [b for b in blocks if wanted is None or wanted in (b.value("OBJECT_NAME"), b.value("OBJECT_ID"))]
    if not chosen or (wanted is None and len(objects) > 1):
        known = ", ".join(sorted(f"{name} ({number})" for name, number in objects))
        raise InputError(f"{path}: choose one of its objects by orbit.object: {known}")
    return TabulatedTrajectory.of([_segment(block, clock) for block in chosen], clock, str(path))


def _blocks(path: Path, items: list[Item]) -> list[_Block]:
    blocks: list[_Block] = []
    inside = ""
    state: list[Item] = []
    for item in items:
        if item.key == "+META":
            blocks.append(_Block(item.position))
        if item.key[:1] in ("+", "-"):
            if item.key == "-STATE":
                _add_state(blocks[-1], state, item)
                state = []
            inside = item.key[1:] if item.key[0] == "+" else "DATA" if inside in ("STATE", "COVARIANCE") else ""
        elif inside == "META":
            blocks[-1].keys[item.key] = item
        elif inside == "STATE":
            state.append(item)
        elif inside != "COVARIANCE" and not item.key:
            if not blocks:
                raise InputError(f"{item.position}: data before META_START")
            _add_line(blocks[-1], item)
    if inside in ("META", "COVARIANCE"):
        raise InputError(f"{items[-1].position}: the file ends before {inside}_STOP; it is truncated")
    if not blocks:
        raise InputError(f"{path}: has no segment (META_START)")
    return blocks


def _add_line(block: _Block, item: Item) -> None:
    """A line of data: epoch, position, velocity, and perhaps the acceleration."""
    epoch, *values = item.value.split()
    if len(values) not in (6, 9):
        found = f"a line has an epoch and 6 (or 9) numbers, this one {len(values)} numbers; is the file truncated?"
        raise InputError(f"{item.position}: {found}")
    block.epochs.append(item._replace(value=epoch))
    block.states.append(_numbers(values[:6], item.position))


def _add_state(block: _Block, state: list[Item], end: Item) -> None:
    """A ``stateVector`` of XML."""
    given = {item.key: item for item in state}
    for key in ("EPOCH", *_COLUMNS):
        if key not in given:
            raise InputError(f"{end.position}: the stateVector has no {key}")
    block.epochs.append(given["EPOCH"])
    block.states.append([_numbers([given[key].value], given[key].position)[0] for key in _COLUMNS])


def _numbers(texts: Iterable[str], position: str) -> list[float]:
    numbers = []
    for text in texts:
        try:
            numbers.append(float(text))
        except ValueError:
            raise InputError(f"{position}: '{text}' is not a number") from None
        if not math.isfinite(numbers[-1]):
            raise InputError(f"{position}: '{text}' is not a finite number")
    return numbers


def _segment(block: _Block, clock: Clock) -> Segment:
    """Segment with times in seconds after the epoch."""
    for key in _REQUIRED:
        block.value(key)
    scale = block.keys["TIME_SYSTEM"]
    if not block.epochs:
        raise InputError(f"{block.position}: the segment has no states; the file is truncated")
    positions = [item.position for item in block.epochs]
    t_s = elapsed_s(clock, [item.value for item in block.epochs], scale.value, positions)
    if (back := np.flatnonzero(np.diff(t_s) <= 0.0)).size:
        raise InputError(f"{positions[back[0] + 1]}: the epoch is not after the one before; sort the states by time")
    span = {"START_TIME": -math.inf, "STOP_TIME": math.inf}
    for key in (*span, *(f"USEABLE_{key}" for key in span)):
        if key in block.keys:
            item = block.keys[key]
            span[key] = float(elapsed_s(clock, [item.value], scale.value, [item.position])[0])
    half_ms = 5e-4
    if t_s[-1] < span["STOP_TIME"] - half_ms or t_s[0] > span["START_TIME"] + half_ms:
        missing = "STOP_TIME" if t_s[-1] < span["STOP_TIME"] - half_ms else "START_TIME"
        at = positions[-1] if missing == "STOP_TIME" else positions[0]
        raise InputError(
            f"{at}: the states do not reach {missing} = {block.value(missing)}; the file is truncated or its metadata "
            "is wrong"
        )
    first = max(span.get("USEABLE_START_TIME", t_s[0]), t_s[0])
    last = min(span.get("USEABLE_STOP_TIME", t_s[-1]), t_s[-1])
    method, nodes = _interpolation(block, len(t_s))
    table = StateTable(t_s, np.array(block.states), method, nodes)
    return Segment(first, last, _centre(block), _frame(block), table)


def _interpolation(block: _Block, states: int) -> tuple[Literal["lagrange", "hermite"], int]:
    """Method, and nodes of a polynomial."""
    if "INTERPOLATION" not in block.keys:
        return "hermite", min(_DEFAULT_NODES, states)
    given = block.keys["INTERPOLATION"]
    degree = _numbers([block.value("INTERPOLATION_DEGREE")], block.keys["INTERPOLATION_DEGREE"].position)[0]
    methods: dict[str, Literal["lagrange", "hermite"]] = {"LINEAR": "lagrange"}
    methods |= {"LAGRANGE": "lagrange", "HERMITE": "hermite"}
    method = methods.get(given.value.upper())
    if method is None:
        raise InputError(f"{given.position}: interpolation {given.value} is not supported; use HERMITE or LAGRANGE")
    nodes = int(degree + 1) if method == "lagrange" else int(degree + 1) // 2
    wrong = degree != int(degree) or nodes < 1 or (method == "hermite" and degree % 2 == 0)
    if wrong or nodes > states:
        at = block.keys["INTERPOLATION_DEGREE"].position
        need = f"needs {nodes} states, and the segment has {states}" if nodes > states else "is impossible"
        raise InputError(f"{at}: {given.value} of degree {degree:g} {need}")
    return method, nodes


def _centre(block: _Block) -> str:
    item = block.keys["CENTER_NAME"]
    name = " ".join(item.value.upper().split())
    if name not in _CENTRES:
        raise InputError(f"{item.position}: centre {item.value} is not supported; use {', '.join(CENTRES)}")
    return _CENTRES[name]


def _frame(block: _Block) -> str:
    item = block.keys["REF_FRAME"]
    name = item.value.upper()
    frame = FRAMES.get(name, "itrf" if name.startswith("ITRF") else "")
    if not frame:
        raise InputError(f"{item.position}: frame {item.value} is not supported; use {', '.join(FRAMES)}")
    return frame
