"""Trajectories given by tables of states: segments of an ephemeris, and tables in CSV."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.clock import Clock
from simulator.mission.frames import states_to_gcrs
from simulator.mission.interpolation import StateTable
from simulator.mission.tables import read_rows
from simulator.mission.trajectory import GM_KM3_S2, centre_state, osculating_period_s, refuse_outside
from startracker.core import FloatArray
from startracker.errors import InputError

CSV_COLUMNS = ("x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s")
_CSV_NODES = 4
RESOLUTION_S = 1e-6
"""Rounding of epochs in files: a time within it of the end of a segment belongs to the segment."""


class Table(Protocol):
    """States over time, such as `StateTable`."""

    def state(self, t_s: FloatArray) -> FloatArray:
        """States (T, 6) at times (T,)."""
        ...


@dataclass(frozen=True, eq=False)
class Segment:
    """A table with its centre and axes."""

    first_s: float
    """Beginning of the usable span, seconds after the epoch."""
    last_s: float
    """End of the usable span."""
    centre: str
    """One of `simulator.mission.trajectory.CENTRES`."""
    frame: str
    """Axes (`simulator.mission.frames.to_frame`, or ``itrf``), in which the states are interpolated."""
    table: Table
    """States over seconds after the epoch."""
    frame_epoch_s: float | None = None
    """Fixed date of the axes, seconds after the epoch; None if the axes are those of the time of each state."""


@dataclass(frozen=True, eq=False)
class TabulatedTrajectory:
    """Segments in order of time. Where two overlap, the later one is used; in a gap between two, and outside all of
    them, there is no state."""

    clock: Clock
    """Epoch."""
    centre: str
    """Centre of the first segment, to which all states are referred."""
    segments: tuple[Segment, ...]
    """The segments by their first times."""
    name: str
    """The file, for messages."""
    object_id: str = ""
    """Identifier of the object in the file; empty where it has none."""

    @classmethod
    def of(cls, segments: list[Segment], clock: Clock, name: str, centre: str | None = None) -> TabulatedTrajectory:
        """Trajectory of at least one segment, whose spans are extended by the resolution of epochs."""
        rounding = RESOLUTION_S
        wider = [replace(s, first_s=s.first_s - rounding, last_s=s.last_s + rounding) for s in segments]
        ordered = sorted(wider, key=lambda segment: segment.first_s)
        return cls(clock, centre or ordered[0].centre, tuple(ordered), name)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds after the epoch."""
        return self.segments[0].first_s, max(segment.last_s for segment in self.segments)

    @property
    def period_s(self) -> float:
        """Period of the osculating ellipse at the epoch, or at the nearest end of the span."""
        at = np.array([min(max(0.0, self.span_s[0]), self.span_s[1])])
        r_km, v_km_s = self.state(at)
        return osculating_period_s(r_km[0], v_km_s[0], GM_KM3_S2[self.centre])

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, ICRF axes, at seconds since the epoch, shape (...).

        Raises
        ------
        InputError
            Outside the span, or in a gap between segments.
        """
        t = np.asarray(t_s, dtype=float)
        parts = [Part(s.first_s, s.last_s, functools.partial(self._states, s)) for s in self.segments]
        out = piecewise(parts, self.clock, t.ravel(), self.name, "states")
        return out[:, :3].reshape(*t.shape, 3), out[:, 3:].reshape(*t.shape, 3)

    def _states(self, segment: Segment, t_s: FloatArray) -> FloatArray:
        # The interpolation is in the axes and about the centre of the segment; the result is transformed.
        found = segment.table.state(t_s)
        of_date_s = t_s if segment.frame_epoch_s is None else np.full_like(t_s, segment.frame_epoch_s)
        r_km, v_km_s = states_to_gcrs(segment.frame, self.clock, of_date_s, found[:, :3], found[:, 3:])
        out = np.concatenate([r_km, v_km_s], axis=1)
        if segment.centre != self.centre:
            theirs, ours = (centre_state(name, self.clock, t_s) for name in (segment.centre, self.centre))
            out += np.concatenate([theirs.r_km - ours.r_km, theirs.v_km_s - ours.v_km_s], axis=1)
        return out


class Part(NamedTuple):
    """A quantity (T, C) at times (T,) from `first_s` to `last_s`, seconds after the epoch."""

    first_s: float
    last_s: float
    values: Callable[[FloatArray], FloatArray]


def piecewise(parts: Sequence[Part], clock: Clock, t_s: FloatArray, name: str, what: str) -> FloatArray:
    """Values (T, C) at times (T,) from parts in order of time; where two overlap, from the later one.

    Raises
    ------
    InputError
        Outside the span, or in a gap; `name` is the file, `what` the quantity, for the message.
    """
    refuse_outside(clock, t_s, (parts[0].first_s, max(part.last_s for part in parts)), name)
    # A call without times gives the number of columns. Later parts overwrite earlier ones, and NaN marks gaps.
    out = np.full((t_s.size, parts[0].values(t_s[:0]).shape[1]), np.nan)
    for part in parts:
        rows = np.flatnonzero((t_s >= part.first_s) & (t_s <= part.last_s))
        if len(rows):
            out[rows] = part.values(t_s[rows])
    if np.isnan(out).any():
        gap = float(t_s[np.isnan(out[:, 0])][0])
        before = max(part.last_s for part in parts if part.last_s < gap)
        after = min(part.first_s for part in parts if part.first_s > gap)
        ends = " to ".join(clock.isot(end) for end in (before, after))
        raise InputError(f"{name}: no {what} from {ends} UTC, a gap between segments")
    return out


def read_csv(path: Path, clock: Clock, centre: str, frame: str) -> TabulatedTrajectory:
    """Trajectory of a table with a header line.

    Its columns are ``utc`` (ISO 8601) or ``t_s`` (seconds after the scenario's epoch), and `CSV_COLUMNS`; lines that
    start with ``#`` are comments. Interpolated by Hermite's polynomial of degree 7.

    Raises
    ------
    InputError
        With file and line: a missing column, a value that is not a number, or times that do not ascend.
    """
    t_s, states, _ = read_rows(path, clock, CSV_COLUMNS)
    table = StateTable(t_s, states, "hermite", min(_CSV_NODES, len(t_s)))
    return TabulatedTrajectory.of([Segment(float(t_s[0]), float(t_s[-1]), centre, frame, table)], clock, str(path))
