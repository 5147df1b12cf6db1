"""SPK kernels of SPICE (*SPK Required Reading*, NAIF): segments of types 2, 3, 8, 9, 12 and 13."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.polynomial import chebyshev

from simulator.mission.clock import Clock
from simulator.mission.epochs import from_tdb_seconds, tdb_seconds
from simulator.mission.interpolation import StateTable
from simulator.mission.tabulated import Segment, Table, TabulatedTrajectory
from simulator.mission.trajectory import BARYCENTRE
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.files import KERNEL_BYTES, check_file

NAIF = {
    0: BARYCENTRE,
    1: "Mercury",
    2: "Venus",
    3: "Earth-Moon barycentre",
    4: "Mars",
    9: "Pluto barycentre",
    10: "Sun",
    199: "Mercury",
    299: "Venus",
    399: "Earth",
    301: "Moon",
    499: "Mars",
    5: "Jupiter",
    6: "Saturn",
    7: "Uranus",
    8: "Neptune",
}
"""Centres by NAIF number. If a centre has two numbers, that of the body itself comes last, so that the inverse of this
table gives it."""
_FRAMES = {1: "icrf", 17: "ecliptic"}
"""Frames by NAIF number: J2000, which SPICE identifies with the ICRF, and ECLIPJ2000."""
_POSITIONS, _STATES = 2, 3
_EQUAL_STEPS = (8, 12)
_HERMITE = (12, 13)
_TYPES = (_POSITIONS, _STATES, 8, 9, 12, 13)


@dataclass(frozen=True, eq=False)
class ChebyshevTable:
    """Chebyshev polynomials over intervals of equal length."""

    first_s: float
    """Start of the first interval."""
    length_s: float
    """Length of every interval."""
    coefficients: FloatArray
    """(degree + 1, N, 3) for positions (type 2), or (degree + 1, N, 6) for states (type 3), of N intervals."""

    def state(self, t_s: FloatArray) -> FloatArray:
        """States (T, 6) at times (T,) within the table."""
        intervals = self.coefficients.shape[1]
        number = np.clip(np.floor((t_s - self.first_s) / self.length_s), 0, intervals - 1).astype(int)
        at = 2.0 * ((t_s - self.first_s) - number * self.length_s) / self.length_s - 1.0
        chosen = self.coefficients[:, number]
        found = chebyshev.chebval(at[:, None], chosen, tensor=False)
        if found.shape[1] == 6:
            return np.asarray(found)
        # The polynomials are functions of a variable from −1 to 1 over an interval.
        slope = chebyshev.chebval(at[:, None], chebyshev.chebder(chosen), tensor=False) * (2.0 / self.length_s)
        return np.concatenate([found, slope], axis=1)


@dataclass(frozen=True, eq=False)
class _TdbTable:
    """Adapter of a table over TDB seconds after J2000 to seconds after the epoch."""

    clock: Clock
    table: Table

    def state(self, t_s: FloatArray) -> FloatArray:
        return self.table.state(tdb_seconds(self.clock, t_s))


def read_spk(path: Path, clock: Clock, target: str | int | None, centre: str) -> TabulatedTrajectory:
    """Trajectory of a target of an SPK kernel.

    Parameters
    ----------
    path : Path
        Binary kernel.
    clock : Clock
        The scenario's clock.
    target : str, int or None
        NAIF number of the spacecraft; needed if the kernel has several targets.
    centre : str
        Centre to which the states are referred; that of a segment may be any body of DE421.

    Raises
    ------
    InputError
        For a file that is not a kernel or is truncated, no such target, or a type, a frame or a centre that is not
        supported.
    """
    segments = _segments(path)
    targets = sorted({segment.target for segment in segments})
    if target is None and len(targets) == 1:
        target = targets[0]
    chosen = [segment for segment in segments if str(segment.target) == str(target)]
    if not chosen:
        raise InputError(f"{path}: choose one of its targets by orbit.object: {', '.join(map(str, targets))}")
    found = [_segment(path, clock, segment) for segment in chosen]
    return TabulatedTrajectory.of(found, clock, str(path), centre)


def _segments(path: Path) -> list[Any]:
    """Segments of a kernel, each with its numbers in the attribute `words`."""
    from jplephem.daf import DAF
    from jplephem.spk import SPK

    check_file(path, KERNEL_BYTES, "give an SPK kernel")
    try:
        with path.open("rb") as file:
            kernel = SPK(DAF(file))
            for segment in kernel.segments:
                # Read now, because the file is closed before the segments are used.
                segment.words = kernel.daf.read_array(segment.start_i, segment.end_i).astype(float)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give an SPK kernel") from error
    except Exception as error:  # jplephem lets errors of struct, NumPy and its own pass
        raise InputError(f"{path}: is not an SPK kernel, or is truncated ({error})") from error
    if not kernel.segments:
        raise InputError(f"{path}: the kernel has no segments")
    return list(kernel.segments)


def _segment(path: Path, clock: Clock, segment: Any) -> Segment:
    what = f"{path}: target {segment.target}"
    if segment.data_type not in _TYPES:
        known = ", ".join(map(str, _TYPES))
        raise InputError(f"{what}: type {segment.data_type} is not supported, only {known}; write it as type 13 or OEM")
    if segment.frame not in _FRAMES:
        raise InputError(f"{what}: frame {segment.frame} is not supported; use J2000 (1) or ECLIPJ2000 (17)")
    if segment.center not in NAIF:
        raise InputError(f"{what}: centre {segment.center} is not supported; use {', '.join(map(str, NAIF))}")
    table = _table(segment.data_type, segment.words)
    first_s, last_s = from_tdb_seconds(clock, np.array([segment.start_second, segment.end_second]))
    return Segment(float(first_s), float(last_s), NAIF[segment.center], _FRAMES[segment.frame], _TdbTable(clock, table))


def _table(kind: int, words: FloatArray) -> ChebyshevTable | StateTable:
    """Table over TDB seconds from the words of a segment (*SPK Required Reading*)."""
    if kind in (_POSITIONS, _STATES):
        # Each record has its middle and radius, which follow from its number, and the coefficients of each component.
        first_s, length_s, size, count = words[-4:]
        columns = 3 if kind == _POSITIONS else 6
        records = words[: int(size) * int(count)].reshape(int(count), int(size))[:, 2:]
        coefficients = records.reshape(len(records), columns, -1).transpose(2, 0, 1)
        return ChebyshevTable(first_s, length_s, np.ascontiguousarray(coefficients))
    count = int(words[-1])
    states = words[: 6 * count].reshape(count, 6)
    method: Literal["hermite", "lagrange"] = "hermite" if kind in _HERMITE else "lagrange"
    # The last words are the degree or window size minus one, which is the number of nodes minus one in both cases, and
    # the count of states.
    if kind in _EQUAL_STEPS:
        first_s, step_s = words[-4], words[-3]
        t_s = first_s + step_s * np.arange(count)
    else:
        t_s = words[6 * count : 7 * count]
    return StateTable(t_s, states, method, min(int(words[-2]) + 1, count))
