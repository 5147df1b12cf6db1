"""The verdict on a specification: one function and one set of words for every command.

A requirement is met if the whole 95 % interval of the measured value is within its limit, not met if all of it is
outside, and undecided otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, NamedTuple, Protocol

from simulator.study.specification.requirements import (
    ACQUISITION,
    AVAILABILITY,
    WRONG_RATE,
    Requirement,
    Specification,
)
from simulator.study.texts import between_text, deg_text, percent_text

MET, NOT_MET, UNDECIDED = "met", "not met", "undecided"
"""Verdicts, on a requirement and on a specification."""

_TAIL = 0.025
"""Probability that a limit of a 95 % interval is exceeded."""


class Estimate(NamedTuple):
    """A measured or predicted value, in the unit of the requirement's limit."""

    value: float | None
    """None if nothing was solved; infinite where too few frames were."""
    low: float | None
    high: float | None
    """95 % interval; None for a limit that the frames do not determine. Both are the value of a prediction."""
    frames: float
    """Frames, or the effective number of independent ones."""
    unknown: str = ""
    """Reason why nothing is known about the requirement; empty if something is."""


class Evidence(Protocol):
    """What is known about a camera: `Measured` or `Predicted`."""

    @property
    def basis(self) -> str:
        """``measured`` or ``predicted``."""

    @property
    def unit(self) -> str:
        """What is counted, in the plural: trials, or independent frames."""

    @property
    def wrong(self) -> int:
        """Frames with a wrong attitude."""

    @property
    def misidentified(self) -> int:
        """Wrong attitudes with a misidentified star."""

    @property
    def gross(self) -> int:
        """Wrong attitudes with the right stars, inconsistent and beyond the specification."""

    @property
    def untested(self) -> tuple[str, ...]:
        """Conditions of the specification that no frame has, as sentences."""

    def estimate(self, requirement: Requirement) -> Estimate:
        """The value that the requirement limits."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one requirement."""

    requirement: Requirement
    estimate: Estimate

    @property
    def verdict(self) -> str:
        """`MET`, `NOT_MET` or `UNDECIDED`."""
        value, low, high, _, unknown = self.estimate
        limit = self.requirement.limit
        if unknown:
            return UNDECIDED
        if value is None:
            return NOT_MET
        if self.requirement.name == AVAILABILITY:  # a minimum
            limit, low, high = -limit, high and -high, low and -low
        if low is not None and low > limit:
            return NOT_MET
        return MET if high is not None and high <= limit else UNDECIDED

    @property
    def margin(self) -> float | None:
        """Limit relative to the value, above 1 if the value is within it (for the availability, of the unavailable
        fraction); None if the value is unknown or zero."""
        value, limit = self.estimate.value, self.requirement.limit
        if value is None:
            return None
        if self.requirement.name == AVAILABILITY:
            value, limit = 1.0 - value, 1.0 - limit
        return limit / value if value > 0.0 else None

    @property
    def value_text(self) -> str:
        """Value for display: ``99.7 % below 8.12″``."""
        if self.estimate.unknown:
            return self.estimate.unknown
        value, percent = _quantity_text(self.requirement, self.estimate.value), self.requirement.percent
        return value if percent is None else f"{percent:g} % below {value}"

    @property
    def interval_text(self) -> str:
        """95 % interval for display, ``7.40 to 9.01″``; empty for a prediction or without a value."""
        _, low, high, _, unknown = self.estimate
        if unknown or low == high:
            return ""
        return between_text(_quantity_text(self.requirement, low), _quantity_text(self.requirement, high))

    @property
    def limit_text(self) -> str:
        """The limit for display."""
        return _quantity_text(self.requirement, self.requirement.limit)

    @property
    def text(self) -> str:
        """One line: requirement, value, interval, limit and verdict."""
        between = f" (95 % interval {self.interval_text})" if self.interval_text else ""
        return f"{self.requirement.title}: {self.value_text}{between}, specified {self.limit_text}: {self.verdict}"

    @property
    def needed(self) -> int:
        """Least number of frames that can show the requirement to be met."""
        return frames_needed(self.requirement)

    def to_dict(self, three_sigma_deg: float | None = None) -> dict[str, Any]:
        """As in ``summary.json``: for errors in degrees, with three times the rms if given."""
        value, low, high, frames, unknown = self.estimate
        each = self.requirement
        unit = "_deg" if each.axis else "_s" if each.name == ACQUISITION else ""
        found: dict[str, Any] = {
            f"specified{unit}": each.limit,
            f"value{unit}": _finite(value),
            f"interval95{unit}": [_finite(low), _finite(high)],
            "percentile": each.percent,
            "frames": frames,
            "frames_needed": self.needed,
            "verdict": self.verdict,
            "met": self.verdict == MET,
            "text": self.text,
        }
        if each.axis and each.percent == 99.7:  # names of the first version
            found |= {"p997_deg": value, "p997_interval95_deg": [low, high], "three_sigma_deg": three_sigma_deg}
        return found | ({"unknown": unknown} if unknown else {})


@dataclass(frozen=True)
class Judgement:
    """Verdicts on all requirements of a specification."""

    verdicts: tuple[Verdict, ...]
    basis: str
    """``measured`` or ``predicted``."""
    unit: str
    """What is counted, in the plural."""
    wrong: int = 0
    """Wrong attitudes; any is a reason for `NOT_MET` unless a rate of them is specified."""
    untested: tuple[str, ...] = ()
    """Conditions that were not tested; the specification is then at best `UNDECIDED`."""
    misidentified: int = 0
    gross: int = 0
    """Wrong attitudes with a misidentified star, and those that are inconsistent and beyond a limit."""

    @property
    def state(self) -> str:
        """Verdict on the whole specification: `NOT_MET` if a requirement is, `MET` if all are."""
        found = {each.verdict for each in self.verdicts}
        if NOT_MET in found or self.refused_wrong:
            return NOT_MET
        return UNDECIDED if UNDECIDED in found or self.untested else MET

    @property
    def refused_wrong(self) -> bool:
        """Whether there are wrong attitudes, and no rate of them is specified."""
        return self.wrong > 0 and not any(each.requirement.name == WRONG_RATE for each in self.verdicts)

    @property
    def kinds(self) -> str:
        """What the wrong attitudes are, for display; empty if it is not known."""
        parts = [f"{self.misidentified} misidentified"] if self.misidentified else []
        parts += [f"{self.gross} inconsistent and beyond the specification"] if self.gross else []
        return f" ({', '.join(parts)})" if parts else ""

    @property
    def advice(self) -> str:
        """What decides an undecided specification; empty if it is not."""
        open_ones = [each for each in self.verdicts if each.verdict == UNDECIDED and not each.estimate.unknown]
        if self.state != UNDECIDED or not open_ones:
            return ""
        needed, count = max(each.needed for each in open_ones), min(each.estimate.frames for each in open_ones)
        return f"run at least {needed} {self.unit} to decide" if count < needed else f"run more {self.unit} to decide"

    @property
    def text(self) -> str:
        """The line that every command prints: verdict, and what decides it."""
        decisive = [each for each in self.verdicts if each.verdict == self.state]
        if self.state == NOT_MET:
            reasons = [f"{each.requirement.title} {each.value_text} (specified {each.limit_text})" for each in decisive]
        elif self.state == UNDECIDED:
            reasons = [", ".join(each.requirement.title for each in decisive)]
        else:
            known = [(each.margin, each.requirement.title) for each in decisive if each.margin]
            reasons = ["smallest margin {1}, {0:.3g} ×".format(*min(known))] if known else []
        if self.refused_wrong:
            reasons.append(f"{self.wrong} wrong attitude{'s' if self.wrong > 1 else ''}{self.kinds}")
        if self.state == UNDECIDED:
            reasons += [*self.untested, self.advice]
        said = "; ".join(filter(None, reasons))
        return f"Specification: {self.state}{' (predicted)' if self.basis == 'predicted' else ''}{said and f': {said}'}"

    def by_name(self, three_sigma_deg: Mapping[str, float | None] | None = None) -> dict[str, Any]:
        """As ``specification`` in the result files: each requirement by its name, errors with three times their rms by
        axis if given."""
        three = three_sigma_deg or {}
        return {each.requirement.name: each.to_dict(three.get(each.requirement.axis)) for each in self.verdicts}

    def to_dict(self) -> dict[str, Any]:
        """As ``verdict`` in the result files."""
        return {
            "verdict": self.state,
            "basis": self.basis,
            "wrong": self.wrong,
            "misidentified": self.misidentified,
            "untested": list(self.untested),
            "text": self.text,
        }


def judge(specification: Specification, evidence: Evidence) -> Judgement:
    """Verdicts on a specification.

    Parameters
    ----------
    specification : Specification
        What is required.
    evidence : Evidence
        What was measured (`simulator.study.specification.measured`) or predicted
        (`simulator.study.specification.predicted`).
    """
    verdicts = tuple(Verdict(each, evidence.estimate(each)) for each in specification.requirements)
    wrong, misidentified, gross = evidence.wrong, evidence.misidentified, evidence.gross
    return Judgement(verdicts, evidence.basis, evidence.unit, wrong, evidence.untested, misidentified, gross)


def frames_needed(requirement: Requirement) -> int:
    """Least number of independent frames that can show a requirement to be met.

    For a percentile pⁿ ≤ 0.025, so that the largest of n values is an upper limit (1,228 for 99.7 %); for a fraction of
    failures f the n for which Wilson's interval of none of n ends at f, z² (1 − f) / f.
    """
    if requirement.percent is not None:
        return math.ceil(math.log(_TAIL) / math.log(requirement.percent / 100.0))
    failures = 1.0 - requirement.limit if requirement.name == AVAILABILITY else requirement.limit
    z = NormalDist().inv_cdf(1.0 - _TAIL)
    return math.ceil(z * z * (1.0 - failures) / failures * (1.0 - 1e-12))


def _quantity_text(requirement: Requirement, value: float | None) -> str:
    if requirement.axis:
        return deg_text(value)
    if requirement.name == ACQUISITION:
        return "–" if value is None else f"{value:g} s" if math.isfinite(value) else "never"
    return percent_text(value)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
