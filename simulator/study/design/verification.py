"""Verification of a design: trials of the value found, and the search continued with them if they contradict it.

A run that contradicts the prediction gives its factor, measured over predicted, by which the next value is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from simulator.scenario import Scenario
from simulator.study.axes import BODY_AXES
from simulator.study.design.search import Design, Point, Search, Trade, changed, design
from simulator.study.run import run
from simulator.study.specification.requirements import specification_of
from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED, Judgement, frames_needed
from startracker.errors import InputError

Report = Callable[[int, float], None]
"""Called with the number of the run and its value before each run."""

MOST_RUNS = 8
"""Runs of a verified design."""
_LARGEST_STEP = 1.5
_SMALLEST_STEP = 1.03
_STEP = 1.15
"""Ratio of successive values: its limits, and its value if it cannot be derived from the errors. A few outliers can
cause a factor of ten that disappears at a slightly larger value."""
_TRIALS_FACTOR = 1.6
_CLOSE_ENOUGH = 1.12
"""Ratio of the smallest value confirmed to the largest one contradicted at which the search ends."""
_FIRST_LOOK = 0.1
"""Fraction of the trials of a run after which a contradiction ends it: most values that fail do so by far."""
_FEWEST_FIRST = 50
"""Minimum number of trials of such a first look."""


@dataclass(frozen=True)
class Verification:
    """Monte Carlo run of a value, compared with its prediction; angles in degrees."""

    value: float
    """Value of the parameter."""
    trials: int
    solved: int
    misidentified: int
    inconsistent: int
    wrong: int
    """Frames, solved frames, and of these the misidentified, the inconsistent and the wrong attitudes
    (`simulator.study.specification.outcome`)."""
    judgement: Judgement
    """Verdicts on the specification."""
    ratio: dict[str, float | None]
    """Measured over predicted value of each specified error."""
    three_sigma_deg: dict[str, float | None]
    predicted_deg: dict[str, float | None]
    """Three times the rms error about each body axis, measured and predicted."""
    p997_deg: dict[str, float | None]
    """99.7th percentile of the measured errors."""
    contradictions: tuple[str, ...] = ()
    """Contradictions between the run and the prediction that the requirements are met; empty if there are none."""

    @property
    def accepted(self) -> bool:
        """Whether the run confirms the value: all requirements are met, or are undecided for want of trials with the
        measured value within its limit."""
        if self.contradictions:
            return False
        open_ones = [
            each for each in self.judgement.verdicts if each.verdict == UNDECIDED and not each.estimate.unknown
        ]
        return all(each.estimate.frames < each.needed and (each.margin or math.inf) >= 1.0 for each in open_ones)

    def to_dict(self) -> dict[str, Any]:
        """As in ``design.json``."""
        plain = {key: value for key, value in asdict(self).items() if key != "judgement"}
        judged = {"specification": self.judgement.by_name(self.three_sigma_deg), "verdict": self.judgement.to_dict()}
        return plain | judged | {"contradicted": bool(self.contradictions), "accepted": self.accepted}


@dataclass(frozen=True, eq=False)
class Verified:
    """A design and the runs that confirm or contradict it."""

    design: Design
    """As predicted, with the points that the search added."""
    runs: tuple[Verification, ...]
    """In the order of their computation."""

    @property
    def answer(self) -> Verification | None:
        """The run of the smallest confirmed value; None if there is none."""
        return min((run for run in self.runs if run.accepted), key=lambda run: run.value, default=None)

    @property
    def confirmed(self) -> str:
        """What the runs say of the answer: ``confirmed`` if it meets the specification, or ``not contradicted`` if they
        have too few trials for that."""
        return "confirmed" if self.answer and self.answer.judgement.state == MET else "not contradicted"

    def to_dict(self) -> dict[str, Any]:
        """What ``design.json`` holds."""
        best, answer = self.design.best, self.answer
        last = answer or (self.runs[-1] if self.runs else None)
        return self.design.to_dict() | {
            "answer": answer.value if answer else best.value if best and not self.runs else None,
            "verification": last.to_dict() if last else None,
            "verifications": [run.to_dict() for run in self.runs],
        }

    @property
    def contradicted(self) -> bool:
        """Whether no run confirms a value."""
        return bool(self.runs) and self.answer is None


def trials_for(scenario: Scenario) -> int:
    """Trials of a verification by default: `_TRIALS_FACTOR` times as many as can show every requirement on errors to be
    met, so that the upper limits are the second largest errors."""
    return math.ceil(
        _TRIALS_FACTOR * max((frames_needed(each) for each in specification_of(scenario).errors), default=1)
    )


def verify(
    scenario: Scenario, result: Design, trials: int, workers: int = 1, point: Point | None = None
) -> Verification:
    """Run trials of a value, over the whole sky or along the path as in the prediction.

    The run ends after the first tenth of the trials if these already show that the specification is not met.

    Parameters
    ----------
    scenario : Scenario
        As for `simulator.study.design.search.design`.
    result : Design
        The prediction.
    trials, workers : int
        Trials, and processes on this machine.
    point : Point, optional
        Value and prediction; by default the best one.

    Raises
    ------
    InputError
        If no value was found, or for fewer than one trial.
    """
    point = point or result.best
    if point is None:
        raise InputError("--verify: no value meets the specification, so there is nothing to verify")
    chosen = changed(scenario, result.parameter, point.value)
    if result.over == "sky":
        chosen = chosen.changed({"study.sampling": "sky", "pointing.target": None})
    first = int(_FIRST_LOOK * trials)
    study = run(chosen, first, workers=workers) if first >= _FEWEST_FIRST else None
    if study is None or study.judgement.state != NOT_MET:
        study = run(chosen, trials, workers=workers)
    summary, judged = study.summary, study.judgement
    ratios: dict[str, float | None] = {}
    for each in judged.verdicts:
        if each.requirement.axis:
            expected = point.specification[each.requirement.name]["value_deg"]
            measured = each.estimate.value
            ratios[each.requirement.name] = measured / expected if measured is not None and expected else None
    return Verification(
        value=point.value,
        trials=summary["trials"],
        solved=summary["solved"],
        misidentified=summary.get("misidentified", 0),
        inconsistent=summary.get("inconsistent", 0),
        wrong=summary["wrong"],
        judgement=judged,
        ratio=ratios,
        three_sigma_deg={axis: summary["errors_deg"][axis]["three_sigma"] for axis in BODY_AXES},
        predicted_deg=dict(point.three_sigma_deg),
        p997_deg={axis: summary["errors_deg"][axis]["p997"] for axis in BODY_AXES},
        contradictions=tuple(_contradictions(judged, summary, result)),
    )


def _contradictions(judged: Judgement, summary: Mapping[str, Any], result: Design) -> Iterator[str]:
    """Requirements that the run shows not to be met, and fewer solved frames than predicted."""
    for each in judged.verdicts:
        if each.verdict == NOT_MET:
            yield each.text
    if judged.refused_wrong:
        yield f"{judged.wrong} of {summary['solved']} accepted attitudes are wrong{judged.kinds}"
    low, high = summary["availability_interval95"]
    if high < result.least_availability:
        yield (
            f"{100 * summary['availability']:.2f} % of the frames were solved (95 % interval {100 * low:.2f} to "
            f"{100 * high:.2f} %), but {100 * result.least_availability:g} % are required"
        )


def verified_design(
    scenario: Scenario,
    trade: Trade,
    trials: int,
    workers: int = 1,
    search: Search | None = None,
    report: Report | None = None,
) -> Verified:
    """Smallest value of a parameter that trials confirm.

    Starts at the predicted value. If its run contradicts it, or leaves it undecided with enough trials, the prediction
    is multiplied by measured / predicted, and the next value is the smallest that meets the specification so, at most
    1.5 times the previous one; between the largest contradicted and the smallest confirmed value the search continues
    by bisection to 12 %, `MOST_RUNS` runs in all.

    Parameters
    ----------
    scenario, trade
        As for `simulator.study.design.search.design`.
    trials, workers : int
        Trials of each run, and processes on this machine.
    search : Search, optional
        Predictions already computed.
    report : callable, optional
        Called before each run.
    """
    search = search or Search(scenario, trade)
    result = design(scenario, trade, search=search)
    runs: list[Verification] = []
    next_point = result.best
    while next_point is not None and len(runs) < MOST_RUNS:
        if report:
            report(len(runs) + 1, next_point.value)
        runs.append(verify(scenario, result, trials, workers, next_point))
        next_point = _next(runs, search)
    return Verified(design(scenario, trade, search=search), tuple(runs))


def _next(runs: list[Verification], search: Search) -> Point | None:
    """Point of the next run; None if the search ends."""
    failed = max((run.value for run in runs if not run.accepted), default=None)
    confirmed = min((run.value for run in runs if run.accepted), default=None)
    if confirmed is not None:
        if failed is None or failed >= confirmed or confirmed <= _CLOSE_ENOUGH * failed:
            return None
        # Bisection of the logarithm: what counts is the ratio of the two values.
        return search.point(float(f"{math.sqrt(failed * confirmed):.6g}"))
    last = runs[-1]
    if last.value >= search.trade.high:
        return None
    factors = {}
    for each in last.judgement.verdicts:
        predicted = search.point(last.value).specification[each.requirement.name].get("value_deg")
        if predicted and each.estimate.value is not None:
            # The upper end of the interval, because a value is confirmed only when this is within the limit.
            factors[each.requirement.name] = (each.estimate.high or each.estimate.value) / predicted
    corrected = search.smallest(factors, above=last.value) if any(f > 1.0 for f in factors.values()) else None
    step = _LARGEST_STEP if corrected is None and factors else _STEP
    asked = corrected.value if corrected and corrected.value > last.value else last.value * step
    value = min(max(asked, last.value * _SMALLEST_STEP), last.value * _LARGEST_STEP, search.trade.high)
    point = search.point(float(f"{value:.6g}"))
    return None if point.impossible else point
