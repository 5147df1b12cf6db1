"""The scenario's clock: conversion of seconds since the epoch to TT, Julian epoch and UTC."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, overload

import erfa

from startracker.arguments import is_time, real_number
from startracker.core import DAYS_PER_JULIAN_YEAR, J2000_JD_TT, FloatArray
from startracker.errors import InputError

SECONDS_PER_DAY = 86_400.0
FIRST_YEAR_OF_UTC = 1960
_LONGEST_S = 1e11
"""Times farther than this from the epoch, three thousand years, are refused, as no ephemeris covers them."""


@dataclass(frozen=True)
class Clock:
    """SI seconds elapsed since an epoch, converted to the time scales that the physics needs.

    The epoch is converted from UTC to TT once, with ERFA's table of leap seconds (``eraUtctai``, ``eraTaitt``; IAU
    SOFA). Elapsed seconds are then added to TT, which is uniform: a leap second between the epoch and an instant only
    changes the UTC label. Dates after the end of the table keep its last offset, as ERFA and astropy do."""

    epoch: datetime
    """With a time zone; UTC. `InputError` without one, or before the start of UTC (1960)."""
    _tt: tuple[float, float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.epoch.tzinfo is None:
            raise InputError(f"the epoch {self.epoch} has no time zone; write it in UTC, for example {self.epoch}Z")
        utc = self.epoch.astimezone(UTC)
        if utc.year < FIRST_YEAR_OF_UTC:
            raise InputError(f"the epoch {utc.isoformat()} is before the start of UTC; use a date from 1960 on")
        second = utc.second + utc.microsecond * 1e-6
        # The ufuncs are called directly because their wrappers warn ("dubious year") of any date after the table of
        # leap seconds.
        utc1, utc2, _ = erfa.ufunc.dtf2d("UTC", utc.year, utc.month, utc.day, utc.hour, utc.minute, second)
        tai1, tai2, _ = erfa.ufunc.utctai(utc1, utc2)
        tt1, tt2, _ = erfa.ufunc.taitt(tai1, tai2)
        # The dataclass is frozen; these are its only assignments.
        object.__setattr__(self, "epoch", utc)
        object.__setattr__(self, "_tt", (float(tt1), float(tt2)))

    @overload
    def tt_jd(self, t_s: float) -> tuple[float, float]: ...
    @overload
    def tt_jd(self, t_s: FloatArray) -> tuple[float, FloatArray]: ...
    def tt_jd(self, t_s: float | FloatArray) -> tuple[float, float | FloatArray]:
        """Two-part Julian date TT, days; their sum is the date, and the first part is the same at every instant.

        Accurate to 5 ns per year from the epoch (rounding of the second part).
        """
        # Only the small part changes, so no digits are lost to the large one.
        return self._tt[0], self._tt[1] + t_s / SECONDS_PER_DAY

    @overload
    def jyear(self, t_s: float) -> float: ...
    @overload
    def jyear(self, t_s: FloatArray) -> FloatArray: ...
    def jyear(self, t_s: float | FloatArray) -> float | FloatArray:
        """Julian epoch, TT: 2000 + (JD − 2451545) / 365.25."""
        jd1, jd2 = self.tt_jd(t_s)
        return 2000.0 + ((jd1 - J2000_JD_TT) + jd2) / DAYS_PER_JULIAN_YEAR

    def elapsed_s(self, time: Any) -> float:
        """SI seconds since the epoch, of a number of seconds, an astropy ``Quantity`` or an astropy ``Time``."""
        if is_time(time):
            tt = time.tt
            return float(((tt.jd1 - self._tt[0]) + (tt.jd2 - self._tt[1])) * SECONDS_PER_DAY)
        return real_number("at_s", time, unit="s", least=-_LONGEST_S, most=_LONGEST_S)

    def utc_jd(self, t_s: float | FloatArray) -> tuple[Any, Any]:
        """Two-part quasi Julian date UTC (ERFA's form: a day with a leap second is one day long)."""
        tt1, tt2 = self.tt_jd(t_s)
        tai1, tai2, _ = erfa.ufunc.tttai(tt1, tt2)
        utc1, utc2, _ = erfa.ufunc.taiutc(tai1, tai2)
        return utc1, utc2

    def isot(self, t_s: float, digits: int = 3) -> str:
        """UTC as ISO 8601 without a zone, rounded to milliseconds or to a number of decimals of a second; a leap second
        is written as second 60."""
        year, month, day, fields, _ = erfa.ufunc.d2dtf("UTC", digits, *self.utc_jd(t_s))
        hour, minute, second, part = fields.item()
        return f"{year:04d}-{month:02d}-{day:02d}T{hour:02d}:{minute:02d}:{second:02d}.{part:0{digits}d}"
