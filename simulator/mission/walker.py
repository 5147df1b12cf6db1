"""Synthetic constellations in Walker's pattern, as two-line elements."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import NamedTuple

from simulator.constants import EARTH_GM_KM3_S2, EARTH_RADIUS_KM

_FIRST_NUMBER, _MOST = 90_001, 9_999


class Walker(NamedTuple):
    """Walker delta pattern i: t/p/f (Walker 1984, J. Brit. Interplanet. Soc. 37, 559): satellites on circular orbits in
    planes whose nodes are equally spaced."""

    altitude_km: float
    """Height above the equatorial radius."""
    inclination_deg: float
    satellites: int
    """Total number t of satellites."""
    planes: int
    """Number p of planes."""
    phasing: int = 0
    """Factor f: satellites of neighbouring planes differ by f × 360°/t along the orbit."""
    name: str = "WALKER"
    """Prefix of the names; plane and slot follow."""


def walker_tle(shell: Walker, epoch: datetime, first_number: int = _FIRST_NUMBER) -> str:
    """Two-line elements, with lines of names and check digits, of a constellation at an epoch (with a time zone).

    The mean motion follows from Kepler's third law, and drag is zero. Catalogue numbers count from `first_number`.

    Raises
    ------
    ValueError
        If the satellites cannot be divided equally among the planes, or their numbers exceed five digits.
    """
    if shell.satellites % shell.planes or first_number + shell.satellites > _FIRST_NUMBER + _MOST:
        raise ValueError(f"{shell}: satellites must be a multiple of planes, and their numbers below 100,000")
    a_km = EARTH_RADIUS_KM + shell.altitude_km
    turns_per_day = 86_400.0 / math.tau * math.sqrt(EARTH_GM_KM3_S2 / a_km**3)
    # The epoch of two-line elements is a year and a day of the year with a fraction.
    in_plane, utc = shell.satellites // shell.planes, epoch.astimezone(UTC)
    midnight = utc.replace(hour=0, minute=0, second=0, microsecond=0)
    day = utc.timetuple().tm_yday + (utc - midnight).total_seconds() / 86_400.0
    lines = []
    for k in range(shell.satellites):
        plane, slot = divmod(k, in_plane)
        number = first_number + k
        node_deg = 360.0 * plane / shell.planes
        anomaly_deg = (360.0 * slot / in_plane + 360.0 * shell.phasing * plane / shell.satellites) % 360.0
        # Columns of the format: number, designator (empty), epoch, derivatives of the mean motion, B*, ephemeris type.
        first = f"1 {number:05d}U {'':8} {utc.year % 100:02d}{day:012.8f}  .00000000  00000-0  00000-0 0  999"
        second = (
            f"2 {number:05d} {shell.inclination_deg:8.4f} {node_deg:8.4f} 0000000 {0.0:8.4f} {anomaly_deg:8.4f} "
            f"{turns_per_day:11.8f}    0"
        )
        name = f"{shell.name} {plane + 1:02d}-{slot + 1:02d}"
        lines += [name, *(f"{line}{_check_digit(line)}" for line in (first, second))]
    return "\n".join(lines) + "\n"


def _check_digit(line: str) -> int:
    """Sum of the digits, with 1 for a minus sign, modulo 10."""
    return sum(int(c) if c.isdigit() else int(c == "-") for c in line) % 10
