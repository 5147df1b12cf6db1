"""Verdicts on a specification: by the 99.7th percentile of the errors and its confidence interval."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["FEWEST_TO_MEET", "MET", "NOT_MET", "UNDECIDED", "Verdict", "advice", "overall_verdict"]

MET, NOT_MET, UNDECIDED = "met", "not met", "undecided"
"""Verdicts on a specification."""

FEWEST_TO_MEET = 1228
"""Trials from which on the 99.7th percentile has an upper bound of 97.5 %: 0.997ⁿ ≤ 0.025. With fewer, even errors that
are all within the specification do not show that 99.7 % of them are."""


@dataclass(frozen=True)
class Verdict:
    """One axis against its specification, of which 99.7 % of the errors are to be within."""

    axis: str
    """One of `BODY_AXES`."""
    p997_deg: float | None
    """Magnitude that 99.7 % of the errors stay below, degrees; None where nothing was solved."""
    interval95_deg: Sequence[float | None]
    """Its 95 % interval (`simulator.study.intervals.percentile_interval`); None for an open end."""
    specified_deg: float
    """What was asked for."""

    @property
    def verdict(self) -> str:
        """`MET` where the whole interval is within the specification, `NOT_MET` where all of it is beyond, or nothing
        was solved; `UNDECIDED` where the interval has the specification in it: only more trials can decide."""
        low, high = self.interval95_deg
        if self.p997_deg is None or (low is not None and low > self.specified_deg):
            return NOT_MET
        return MET if high is not None and high <= self.specified_deg else UNDECIDED

    def to_dict(self, three_sigma_deg: float | None) -> dict[str, Any]:
        """As ``summary.json`` holds it, with three times the rms beside it."""
        return {
            "specified_deg": self.specified_deg,
            "p997_deg": self.p997_deg,
            "p997_interval95_deg": list(self.interval95_deg),
            "three_sigma_deg": three_sigma_deg,
            "verdict": self.verdict,
            "met": self.verdict == MET,
        }


def overall_verdict(verdicts: Iterable[str], wrong: int) -> str:
    """Verdict on all axes together; wrong attitudes meet nothing."""
    found = set(verdicts)
    if NOT_MET in found or wrong:
        return NOT_MET
    return UNDECIDED if UNDECIDED in found else MET


def advice(trials: int) -> str:
    """How many trials would decide what so many leave undecided."""
    return f"run at least {FEWEST_TO_MEET} trials to decide" if trials < FEWEST_TO_MEET else "run more trials to decide"
