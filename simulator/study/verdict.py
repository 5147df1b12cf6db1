"""Verdicts on a specification: by the 99.7th percentile of the errors and its confidence interval."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["FEWEST_TO_MEET", "MET", "NOT_MET", "UNDECIDED", "Verdict", "advice", "overall_verdict"]

MET, NOT_MET, UNDECIDED = "met", "not met", "undecided"
"""Verdicts on a specification."""

FEWEST_TO_MEET = 1228
"""Minimum number of trials for an upper confidence limit of 97.5 % of the 99.7th percentile: 0.997ⁿ ≤ 0.025. With
fewer, even errors that are all within the specification do not prove that 99.7 % are."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one axis: 99.7 % of the errors are to be within the specification."""

    axis: str
    """One of `BODY_AXES`."""
    p997_deg: float | None
    """99.7th percentile of the magnitude of the errors, degrees; None if nothing was solved."""
    interval95_deg: Sequence[float | None]
    """Its 95 % interval (`simulator.study.intervals.percentile_interval`); None for an open limit."""
    specified_deg: float
    """Specification."""

    @property
    def verdict(self) -> str:
        """`MET` if the whole interval is within the specification; `NOT_MET` if all of it is outside, or nothing was
        solved; `UNDECIDED` if the interval contains the specification, so that more trials are needed."""
        low, high = self.interval95_deg
        if self.p997_deg is None or (low is not None and low > self.specified_deg):
            return NOT_MET
        return MET if high is not None and high <= self.specified_deg else UNDECIDED

    def to_dict(self, three_sigma_deg: float | None) -> dict[str, Any]:
        """As in ``summary.json``, together with three times the rms."""
        return {
            "specified_deg": self.specified_deg,
            "p997_deg": self.p997_deg,
            "p997_interval95_deg": list(self.interval95_deg),
            "three_sigma_deg": three_sigma_deg,
            "verdict": self.verdict,
            "met": self.verdict == MET,
        }


def overall_verdict(verdicts: Iterable[str], wrong: int) -> str:
    """Verdict on all axes together; not met if there are wrong attitudes."""
    found = set(verdicts)
    if NOT_MET in found or wrong:
        return NOT_MET
    return UNDECIDED if UNDECIDED in found else MET


def advice(trials: int) -> str:
    """Number of trials needed for a decision."""
    return f"run at least {FEWEST_TO_MEET} trials to decide" if trials < FEWEST_TO_MEET else "run more trials to decide"
