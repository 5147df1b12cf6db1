"""How much a datasheet simulates."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Amounts:
    """Numbers of frames; the trials of all points of a series have the same indices (common random numbers)."""

    fields: int
    """Scanned fields."""
    trials: int
    """Trials of the mission."""
    acquisition: int
    """Trials over the whole sky, lost in space; half of them with a prior."""
    per_rate: int
    """Frames at each angular rate."""
    bisections: int
    """Steps in which the bracket of a limit is halved."""
    per_point: int
    """Trials of each other point: temperature, robustness, pairs of trials."""
    sequence: int
    """Frames of the sequence in tracking mode."""
    acceleration: int
    """Frames of the sequence at each acceleration."""
    directions: int
    """Directions of the sky coverage, and instants along the path."""

    def to_dict(self) -> dict[str, int]:
        """As in ``datasheet.json``."""
        return asdict(self)


QUICK = Amounts(16, 400, 60, 16, 2, 20, 40, 8, 3000)
"""For a first look."""
FULL = Amounts(96, 3000, 800, 60, 5, 150, 300, 24, 10_000)
"""From 1,228 trials on, the 99.7th percentile has an upper limit."""
