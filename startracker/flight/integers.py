"""Shift of an integer of a flight build, as of `c/tracker_integers.h`."""

from __future__ import annotations


def shifted(value: int, power: int) -> int:
    """value × 2^power, rounded down."""
    return value << power if power >= 0 else value >> -power
