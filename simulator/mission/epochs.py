"""Conversion of epochs in mission files, in any time scale, to seconds after the scenario's epoch."""

from __future__ import annotations

import re
from collections.abc import Sequence

import erfa
import numpy as np

from simulator.mission.clock import SECONDS_PER_DAY, Clock
from startracker.core import J2000_JD_TT, FloatArray
from startracker.ephemeris import timescale
from startracker.errors import InputError

SCALES = ("UTC", "TAI", "TT", "TDB", "GPS", "UT1", "TCG", "TCB")
"""Time scales that can be read; TDT is TT."""
_GPS_BEHIND_TAI_S = 19.0
_CALENDAR = re.compile(r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d(?:\.\d*)?)Z?")
_DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})[T ](\d\d):(\d\d):(\d\d(?:\.\d*)?)Z?")


def elapsed_s(clock: Clock, texts: Sequence[str], scale: str, positions: Sequence[str]) -> FloatArray:
    """SI seconds (N,) from the clock's epoch to epochs of one time scale.

    Parameters
    ----------
    clock : Clock
        The scenario's clock.
    texts : sequence of str
        N epochs, ``2026-03-21T12:00:00.000`` or, with the day of the year, ``2026-080T12:00:00.000``.
    scale : str
        One of `SCALES`, or ``TDT``.
    positions : sequence of str
        File and line of each, for messages.

    Raises
    ------
    InputError
        For an unknown time scale, or for the first text that is not an epoch.

    Notes
    -----
    The resolution is limited by the two-part Julian date of the scenario's epoch, 0.02 ns, and of a float of seconds:
    4 ns after a year. TDB by ERFA's ``dtdb`` at the geocentre; UT1 by Skyfield's table.
    """
    scale = {"TDT": "TT"}.get(scale.upper(), scale.upper())
    if scale not in SCALES:
        raise InputError(f"{positions[0]}: time scale '{scale}' cannot be read; convert to {', '.join(SCALES)}")
    fields = np.array([epoch_fields(text, at) for text, at in zip(texts, positions, strict=True)]).reshape(-1, 6)
    whole = [column.astype(np.int32) for column in fields[:, :5].T]
    # For a scale other than UTC a day always has 86,400 s, for which TAI stands here; UTC accepts a second 60.
    jd1, jd2, status = erfa.ufunc.dtf2d("UTC" if scale == "UTC" else "TAI", *whole, fields[:, 5])
    if (wrong := np.flatnonzero((status < 0) | (status > 1))).size:  # 1: after the table of leap seconds
        raise InputError(f"{positions[wrong[0]]}: '{texts[wrong[0]]}' is not a date and time of {scale}")
    tt1, tt2 = _to_tt(jd1, jd2, scale)
    first1, first2 = clock.tt_jd(0.0)
    return np.asarray(((tt1 - first1) + (tt2 - first2)) * SECONDS_PER_DAY)


def utc_days(text: str, position: str) -> tuple[float, float]:
    """Two-part Julian date UTC of an epoch as two-line elements count it: midnight, and the time since in days of
    86,400 s.

    Raises
    ------
    InputError
        With the position, if the text is not an epoch.
    """
    year, month, day, hour, minute, second = epoch_fields(text, position)
    whole = [np.int32(part) for part in (year, month, day, hour, minute)]
    _, _, status = erfa.ufunc.dtf2d("UTC", *whole, second)
    if status < 0 or status > 1:
        raise InputError(f"{position}: '{text}' is not a date and time of UTC")
    mjd_zero, mjd, _ = erfa.ufunc.cal2jd(*whole[:3])
    return float(mjd_zero + mjd), (3600.0 * hour + 60.0 * minute + second) / SECONDS_PER_DAY


def tdb_seconds(clock: Clock, t_s: FloatArray) -> FloatArray:
    """TDB seconds after J2000, SPICE's ephemeris time, of seconds (N,) after the clock's epoch."""
    tt1, tt2 = clock.tt_jd(t_s)
    return np.asarray(((tt1 - J2000_JD_TT) + tt2) * SECONDS_PER_DAY + _tdb_minus_tt(tt1, tt2))


def from_tdb_seconds(clock: Clock, tdb_s: FloatArray) -> FloatArray:
    """The inverse of `tdb_seconds`."""
    tt1, tt2 = clock.tt_jd(0.0)
    tt_s = tdb_s - _tdb_minus_tt(J2000_JD_TT, tdb_s / SECONDS_PER_DAY)
    return np.asarray(tt_s - ((tt1 - J2000_JD_TT) + tt2) * SECONDS_PER_DAY)


def _tdb_minus_tt(jd1: FloatArray | float, jd2: FloatArray) -> FloatArray:
    """TDB − TT, s, at the geocentre. The date may be TDB or TT, because the difference changes by less than 4e-10 s per
    second."""
    return np.asarray(erfa.ufunc.dtdb(jd1, jd2, 0.0, 0.0, 0.0, 0.0))


def epoch_fields(text: str, position: str) -> tuple[float, ...]:
    """Year, month, day, hour, minute and second of an epoch by calendar or by day of the year.

    Raises
    ------
    InputError
        With the position, if the text is neither, or the year has no such day.
    """
    if match := _CALENDAR.fullmatch(text):
        return tuple(float(part) for part in match.groups())
    if match := _DAY_OF_YEAR.fullmatch(text):
        year, day, *time = match.groups()
        date = np.datetime64(f"{year}-01-01") + np.timedelta64(int(day) - 1, "D")
        if str(date)[:4] == year:  # day 366 of a common year is in the next one
            return tuple(float(part) for part in (year, str(date)[5:7], str(date)[8:10], *time))
    raise InputError(f"{position}: '{text}' is not an epoch such as 2026-03-21T12:00:00.000")


def _to_tt(jd1: FloatArray, jd2: FloatArray, scale: str) -> tuple[FloatArray, FloatArray]:
    """Convert two-part Julian dates of another time scale to TT."""
    # The scales form a chain, TCB → TDB → TT and UTC or GPS → TAI → TT; the steps below are in its order.
    if scale == "TT":
        return jd1, jd2
    if scale == "UT1":
        return jd1, _tt_of_ut1(jd1, jd2)
    if scale == "TCG":
        tt1, tt2, _ = erfa.ufunc.tcgtt(jd1, jd2)
        return tt1, tt2
    if scale == "TCB":
        jd1, jd2, _ = erfa.ufunc.tcbtdb(jd1, jd2)
    if scale in ("TDB", "TCB"):
        return jd1, jd2 - _tdb_minus_tt(jd1, jd2) / SECONDS_PER_DAY
    if scale == "UTC":
        jd1, jd2, _ = erfa.ufunc.utctai(jd1, jd2)
    if scale == "GPS":
        jd2 = jd2 + _GPS_BEHIND_TAI_S / SECONDS_PER_DAY
    tt1, tt2, _ = erfa.ufunc.taitt(jd1, jd2)
    return tt1, tt2


def _tt_of_ut1(jd1: FloatArray, jd2: FloatArray) -> FloatArray:
    """Second part of the Julian date TT of an instant in UT1.

    The table of ΔT is a function of TT, so the equation is iterated; after the second step the error is below 1e-12 s.
    """
    tt2 = jd2
    for _ in range(2):
        tt2 = jd2 + timescale().tt_jd(jd1, tt2).delta_t / SECONDS_PER_DAY
    return np.asarray(tt2)
