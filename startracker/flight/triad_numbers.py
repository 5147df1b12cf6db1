"""Limits of the identification by triads in a flight build, as integers."""

from __future__ import annotations

import math
from typing import NamedTuple

from startracker.errors import InputError
from startracker.flight.design import FlightDesign
from startracker.flight.integers import ANGLE_BITS
from startracker.identification.acceptance import WIDEST_SHARE
from startracker.settings.identification import TriadSettings

MOST_STARS = 24
"""Brightest stars that make triads at most."""
MOST_GROUPS, MOST_NAMED, MOST_CHECKED = 128, 512, 12
"""Groups; different guide stars that a group can name; groups that are verified."""
_MOST_TRIADS, _TRIAD_BYTES = 4096, 12
_ROOM_BYTES, _FIXED_BYTES, _STAR_BYTES = 61_000, 9_600, 240
"""Of the context for the search; of it without triads and guide stars, and of each star of a list."""


class TriadNumbers(NamedTuple):
    """Limits of the triads of one camera; angles in degrees of 10.6."""

    stars: int
    """Brightest stars that make triads."""
    room: int
    """Triads that there is room for."""
    rotation: int
    """Largest difference of the two rotations of a triad."""
    enclosed: int
    """Of an inner angle; −1: no test."""
    grouping: int
    """Of a rotation from the mean of its group."""
    votes: int
    """Fewest votes for a guide star."""
    lone: int
    """1: of three stars with one group a single vote is enough."""
    widest: int
    """Largest error that is assumed unless more is stated, 2.30 rad."""
    fixed: int
    """Tolerance of all separations, 2.30 rad; 0: by the stars' errors."""


def triad_numbers(design: FlightDesign) -> TriadNumbers:
    """Limits of a design.

    Raises
    ------
    InputError
        For too few or too many stars.
    """
    settings = TriadSettings.of(design.identification)
    if not 3 <= settings.max_stars <= MOST_STARS:
        raise InputError(
            f"identifier triads: set tracker.identification.max_stars to 3 to {MOST_STARS} in a flight build"
        )
    room = _ROOM_BYTES - _FIXED_BYTES - _STAR_BYTES * design.detection.max_stars - len(design.guide)
    enclosed = settings.enclosed_tolerance_deg
    return TriadNumbers(
        settings.max_stars,
        max(min(room // _TRIAD_BYTES, _MOST_TRIADS), 256),
        _angle(settings.rotation_tolerance_deg),
        -1 if enclosed is None else _angle(enclosed),
        _angle(settings.grouping_tolerance_deg),
        settings.vote_number,
        int(settings.three_stars),
        int(WIDEST_SHARE * design.guide.half_diagonal_rad * (1 << 30)),
        round(math.radians(min(settings.separation_tolerance_deg or 0.0, 90.0)) * (1 << 30)),
    )


def _angle(degrees: float) -> int:
    """Of 10.6, truncated; beyond half a turn there is no difference."""
    return int(min(degrees, 180.0) * (1 << ANGLE_BITS))


def triad_constants(t: TriadNumbers) -> dict[str, int]:
    """Numbers of the header by name, without the prefix."""
    return {
        "TRIAD_STARS": t.stars,
        "TRIAD_ROOM": t.room,
        "TRIAD_ROTATION": t.rotation,
        "TRIAD_ENCLOSED": t.enclosed,
        "TRIAD_GROUPING": t.grouping,
        "TRIAD_VOTES": t.votes,
        "TRIAD_LONE": t.lone,
        "TRIAD_WIDEST": t.widest,
        "TRIAD_GROUPS": MOST_GROUPS,
        "TRIAD_NAMED": MOST_NAMED,
        "TRIAD_CHECKED": MOST_CHECKED,
    }
