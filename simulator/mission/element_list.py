"""States of many satellites from a list of two-line or mean elements, by SGP4."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simulator.mission.clock import SECONDS_PER_DAY, Clock
from simulator.mission.element_files import read_elements
from simulator.mission.frames import teme, to_gcrs
from simulator.mission.mean_elements import MeanElements, epoch_s, sgp4_record
from simulator.mission.trajectory import States
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError


class ElementList:
    """Orbits of N satellites.

    Parameters
    ----------
    sets : sequence of MeanElements
        Sets of elements; of several sets of one object, the one whose epoch is closest to the clock's is used.
    clock : Clock
        The scenario's clock.
    max_age_days : float
        Longest time between the epoch of a set and an instant.
    """

    def __init__(self, sets: Sequence[MeanElements], clock: Clock, max_age_days: float) -> None:
        self.clock = clock
        self.max_age_days = max_age_days
        nearest: dict[str, tuple[float, MeanElements]] = {}
        for elements in sets:
            at_s = epoch_s(elements, clock)
            if elements.number not in nearest or abs(at_s) < abs(nearest[elements.number][0]):
                nearest[elements.number] = (at_s, elements)
        self.elements = tuple(elements for _, elements in nearest.values())
        self.epoch_s: FloatArray = np.array([at_s for at_s, _ in nearest.values()])
        self._records = [sgp4_record(elements) for elements in self.elements]
        # SGP4's array takes one Julian date UTC for all its members. Sets are grouped such that no leap second is
        # between their epochs, as the date then corresponds to the same elapsed time for all of a group.
        days = np.array([record.jdsatepoch + record.jdsatepochF for record in self._records])
        _, self._leap_group = np.unique(np.round(days * SECONDS_PER_DAY - self.epoch_s), return_inverse=True)
        self._all: dict[int, Any] = {}

    @classmethod
    def read(cls, path: Path, clock: Clock, max_age_days: float) -> ElementList:
        """The list of a file (`simulator.mission.element_files.read_elements`); `InputError` with file and line."""
        # The cache is keyed by date and size, so that a file that has been replaced is read again.
        try:
            stat = path.stat()
            sets = _read(path, stat.st_mtime_ns, stat.st_size)
        except OSError:
            sets = tuple(read_elements(path))  # raises the reader's error for this file
        if not sets:
            raise InputError(f"{path}: has no elements; give a file of two-line elements or CCSDS OMM")
        return cls(sets, clock, max_age_days)

    def __len__(self) -> int:
        return len(self.elements)

    def states(self, t_s: FloatArray, rows: IntArray | None = None) -> States:
        """Positions (N, K, 3), km, and velocities (N, K, 3), km/s, in GCRS of all satellites, or of some rows, at K
        seconds since the clock's epoch; NaN where SGP4 reports an error, as for a satellite that has re-entered.

        Raises
        ------
        InputError
            If a set is older than `max_age_days`.
        """
        chosen = np.arange(len(self)) if rows is None else rows
        self._refuse_old(t_s, chosen)
        r_km, v_km_s = np.empty((2, len(chosen), len(t_s), 3))
        for group in np.unique(self._leap_group[chosen]).tolist():
            members = np.flatnonzero(self._leap_group[chosen] == group)
            array = self._array(chosen[members], group if rows is None else None)
            r_km[members], v_km_s[members] = self._propagated(t_s, array, int(chosen[members[0]]))
        matrix = teme(self.clock, t_s)
        return States(to_gcrs(matrix, r_km), to_gcrs(matrix, v_km_s))

    def _array(self, rows: IntArray, group: int | None) -> Any:
        """python-sgp4's array of some rows; the array of a whole group is cached."""
        from sgp4.api import SatrecArray

        if group is None or group not in self._all:
            array = SatrecArray([self._records[row] for row in rows.tolist()])
            if group is None:
                return array
            self._all[group] = array
        return self._all[group]

    def _propagated(self, t_s: FloatArray, array: Any, row: int) -> tuple[FloatArray, FloatArray]:
        """TEME states (N, K, 3) of an array of satellites; `row` is any member of it in this list."""
        first = self._records[row]
        # SGP4 subtracts the epoch of each set again: these are elapsed SI seconds, independent of leap seconds
        days = first.jdsatepochF + (t_s - self.epoch_s[row]) / SECONDS_PER_DAY
        error, r_km, v_km_s = array.sgp4(np.full(days.shape, first.jdsatepoch), days)
        r_km[error != 0], v_km_s[error != 0] = np.nan, np.nan
        return r_km, v_km_s

    def _refuse_old(self, t_s: FloatArray, rows: IntArray) -> None:
        old = np.abs(self.epoch_s[rows][:, None] - t_s) > self.max_age_days * SECONDS_PER_DAY
        if old.any():
            row, when = (int(index[0]) for index in np.nonzero(old))
            elements, of_s = self.elements[rows[row]], float(self.epoch_s[rows[row]])
            raise InputError(
                f"{elements.position}: the elements of {elements.name or elements.number} are of "
                f"{self.clock.isot(of_s)} UTC, more than sky.satellites.max_age_days = {self.max_age_days:g} days from "
                f"{self.clock.isot(float(t_s[when]))}; use elements of that time, or change the epoch or study.sampling"
            )


@functools.lru_cache(maxsize=2)  # 30,000 objects take seconds; the check of a scenario and its sky read the same file
def _read(path: Path, mtime_ns: int, size: int) -> tuple[MeanElements, ...]:
    """Sets of elements of a file with this date and size."""
    return tuple(read_elements(path))
