"""Segments of ephemeris messages (OEM, AEM) before their interpretation: metadata, epochs and numbers with their
lines."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simulator.mission.ccsds import Item, read_items
from simulator.mission.clock import Clock
from simulator.mission.epochs import elapsed_s
from startracker.core import FloatArray
from startracker.errors import InputError, InputWarning

_HALF_MS = 5e-4
"""Tolerance, s, of the comparison of epochs with those of the metadata."""


class Layout(NamedTuple):
    """Numbers on a data line of a segment, after its epoch."""

    columns: tuple[str, ...]
    """Names of the numbers in XML, in the order of a line."""
    counts: tuple[int, ...]
    """Permitted counts of numbers on a line; numbers beyond `columns` are not used."""


@dataclass
class WrittenSegment:
    """A segment of a message before its interpretation."""

    position: str
    """File and line of its metadata."""
    keys: dict[str, Item] = field(default_factory=dict)
    """Entries of the metadata by keyword."""
    epochs: list[Item] = field(default_factory=list)
    """Epochs of the data, as text."""
    rows: list[list[float]] = field(default_factory=list)
    """Numbers of each epoch, in the order of the layout's columns."""

    def item(self, key: str) -> Item:
        """Entry of the metadata; `InputError` without it."""
        if key not in self.keys:
            raise InputError(f"{self.position}: the metadata has no {key}")
        return self.keys[key]

    def value(self, key: str) -> str:
        """Value of the metadata; `InputError` without it."""
        return self.item(key).value


def read_segments(path: Path, kind: str, layout_of: Callable[[WrittenSegment], Layout]) -> list[WrittenSegment]:
    """Segments of a message, KVN or XML.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        ``OEM`` or ``AEM``.
    layout_of : callable
        Layout of the data of a segment with its metadata.

    Raises
    ------
    InputError
        With file and line, if the file is damaged or truncated.
    """
    items = read_items(path, kind)
    found: list[WrittenSegment] = []
    inside = ""
    state: list[Item] = []
    for item in items:
        # A state of XML may contain blocks of its own; only its end leaves it. A covariance is skipped.
        mark, name = item.key[:1], item.key[1:]
        if mark in ("+", "-") and (inside != "STATE" or name == "STATE"):
            if item.key == "+META":
                found.append(WrittenSegment(item.position))
            elif item.key == "-STATE":
                _refuse_without_metadata(found, item)
                _add_state(found[-1], layout_of(found[-1]), state, item)
                state = []
            inside = name if mark == "+" else "DATA" if inside in ("STATE", "COVARIANCE") else ""
        elif inside == "META":
            found[-1].keys[item.key] = item
        elif inside == "STATE" and mark not in ("+", "-"):
            state.append(item)
        elif inside != "COVARIANCE" and not item.key:
            _refuse_without_metadata(found, item)
            _add_line(found[-1], layout_of(found[-1]), item)
    if inside in ("META", "COVARIANCE"):
        raise InputError(f"{items[-1].position}: the file ends before {inside}_STOP; it is truncated")
    if not found:
        raise InputError(f"{path}: has no segment (META_START)")
    return found


def _refuse_without_metadata(found: Sequence[WrittenSegment], item: Item) -> None:
    if not found:
        raise InputError(f"{item.position}: data before META_START")


def _add_line(segment: WrittenSegment, layout: Layout, item: Item) -> None:
    """A data line of KVN."""
    epoch, *values = item.value.split()
    if len(values) not in layout.counts:
        first, *others = layout.counts
        wanted = f"{first} (or {', '.join(map(str, others))})" if others else str(first)
        found = f"a line has an epoch and {wanted} numbers, this one {len(values)} numbers; is the file truncated?"
        raise InputError(f"{item.position}: {found}")
    segment.epochs.append(item._replace(value=epoch))
    segment.rows.append(numbers(values[: len(layout.columns)], item.position))


def _add_state(segment: WrittenSegment, layout: Layout, state: list[Item], end: Item) -> None:
    """A ``stateVector`` or ``attitudeState`` of XML."""
    given = {item.key: item for item in state}
    for key in ("EPOCH", *layout.columns):
        if key not in given:
            raise InputError(f"{end.position}: the state has no {key}")
        _check_axis(segment, given[key])
    segment.epochs.append(given["EPOCH"])
    segment.rows.append([numbers([given[key].value], given[key].position)[0] for key in layout.columns])


def _check_axis(segment: WrittenSegment, item: Item) -> None:
    """Check that the axis named by an angle or a rate agrees with the sequence of rotations."""
    if not item.axis or "EULER_ROT_SEQ" not in segment.keys:
        return
    sequence = segment.keys["EULER_ROT_SEQ"].value.upper().translate(str.maketrans("123", "XYZ"))
    number = int(item.key.split("_")[1])
    if sequence[number - 1 : number] != item.axis:
        raise InputError(f"{item.position}: rotation {number} is about {item.axis}, but EULER_ROT_SEQ = {sequence}")


def numbers(texts: Iterable[str], position: str) -> list[float]:
    """Finite numbers; `InputError` with the position for anything else."""
    found = []
    for text in texts:
        try:
            found.append(float(text))
        except ValueError:
            raise InputError(f"{position}: '{' '.join(text.split())}' is not a number") from None
        if not math.isfinite(found[-1]):
            raise InputError(f"{position}: '{text}' is not a finite number")
    return found


def of_object(path: Path, segments: list[WrittenSegment], wanted: str | None, key: str) -> list[WrittenSegment]:
    """Segments of an object by OBJECT_NAME or OBJECT_ID; if `wanted` is None, of the only object.

    Raises
    ------
    InputError
        For several objects without a choice, or an unknown object. The message names `key`, by which the scenario
        chooses.
    """
    objects = {(s.value("OBJECT_NAME"), s.value("OBJECT_ID")) for s in segments}
    chosen = [s for s in segments if wanted is None or wanted in (s.value("OBJECT_NAME"), s.value("OBJECT_ID"))]
    if not chosen or (wanted is None and len(objects) > 1):
        known = ", ".join(sorted(f"{name} ({number})" for name, number in objects))
        raise InputError(f"{path}: choose one of its objects by {key}: {known}")
    return chosen


def segment_times(
    segment: WrittenSegment, clock: Clock, required: Sequence[str]
) -> tuple[FloatArray, tuple[float, float]]:
    """Times (N,) of a segment's states, seconds after the epoch, and its usable span.

    States that do not reach START_TIME or STOP_TIME limit the span, with an `InputWarning`.

    Raises
    ------
    InputError
        With file and line: metadata that are missing, no states, or epochs that do not ascend.
    """
    for key in required:
        segment.item(key)
    scale = segment.item("TIME_SYSTEM").value
    if not segment.epochs:
        raise InputError(f"{segment.position}: the segment has no states; the file is truncated")
    positions = [item.position for item in segment.epochs]
    t_s = elapsed_s(clock, [item.value for item in segment.epochs], scale, positions)
    if (back := np.flatnonzero(np.diff(t_s) <= 0.0)).size:
        raise InputError(f"{positions[back[0] + 1]}: the epoch is not after the one before; sort the states by time")
    # The total span of the metadata must be covered by the states; the usable span, if it is stated, is part of it.
    span = {"START_TIME": -math.inf, "STOP_TIME": math.inf}
    for key in (*span, *(f"USEABLE_{key}" for key in span)):
        if key in segment.keys:
            item = segment.keys[key]
            span[key] = float(elapsed_s(clock, [item.value], scale, [item.position])[0])
    for key, missing in (("START_TIME", t_s[0] > span["START_TIME"]), ("STOP_TIME", t_s[-1] < span["STOP_TIME"])):
        at = 0 if key == "START_TIME" else -1
        if missing and abs(t_s[at] - span[key]) > _HALF_MS:
            warn_of(
                f"{positions[at]}: the states do not reach {key} = {segment.value(key)}, only "
                f"{segment.epochs[at].value}; is the file truncated?"
            )
    first = max(span.get("USEABLE_START_TIME", t_s[0]), t_s[0])
    last = min(span.get("USEABLE_STOP_TIME", t_s[-1]), t_s[-1])
    return t_s, (float(first), float(last))


def polynomial_nodes(segment: WrittenSegment, method_key: str, *, hermite: bool) -> int:
    """Number of nodes of a polynomial of degree INTERPOLATION_DEGREE: degree + 1, or half of it for Hermite's.

    A degree that needs more states than the segment has is reduced to the highest possible, with an `InputWarning`.

    Raises
    ------
    InputError
        With file and line, for a degree that is impossible.
    """
    item, states = segment.item("INTERPOLATION_DEGREE"), len(segment.epochs)
    # A Hermite polynomial through n positions and velocities has 2n conditions, and so the odd degree 2n − 1.
    degree = numbers([item.value], item.position)[0]
    nodes = int(degree + 1) // 2 if hermite else int(degree + 1)
    wrong = degree != int(degree) or nodes < 1 or (hermite and degree % 2 == 0)
    what = f"{item.position}: {segment.value(method_key)} of degree {degree:g}"
    if wrong:
        raise InputError(f"{what} is impossible")
    if nodes > states:
        used = 2 * states - 1 if hermite else states - 1
        warn_of(f"{what} needs {nodes} states, and the segment has {states}: degree {used} is used")
    return min(nodes, states)


def warn_of(text: str) -> None:
    """Issue an `InputWarning` about a message."""
    warnings.warn(text, InputWarning, stacklevel=3)
