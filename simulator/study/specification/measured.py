"""Frames as evidence on a specification: errors by order statistics, fractions by Wilson's interval."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.study.axes import CAMERA_AXES
from simulator.study.body_angles import body_angles_deg
from simulator.study.intervals import effective_number, percentile_interval, wilson_interval
from simulator.study.specification.outcome import outcome_flags
from simulator.study.specification.requirements import (
    AVAILABILITY,
    INCONSISTENT_RATE,
    WRONG_RATE,
    Requirement,
    Specification,
    error_about,
    specification_of,
)
from simulator.study.specification.verdicts import Estimate, Judgement, judge
from startracker.core import BoolArray, FloatArray
from startracker.geometry.attitude import radec_to_direction

Columns = Mapping[str, NDArray[Any]]


RATE_BAND = (0.9, 1.1)
"""Frames at these multiples of the specified rate are judged: the rotation of the local level and the pointing error
add to the commanded rate."""

JUDGED_COLUMNS = ("t_s", "true_ra_deg", "true_dec_deg", "rate_deg_s")
"""Columns of the conditions of a specification, beside statuses and errors."""


@dataclass(frozen=True, eq=False)
class Setting:
    """Facts about the frames that their columns do not contain."""

    exposure_s: float = math.nan
    lost_in_space: bool = False
    """Whether the tracker had no prior, so that a first attitude is an acquisition."""
    step_s: float | None = None
    """Interval of the frames of a sequence; None for independent trials."""
    angles_deg: Mapping[str, FloatArray] = field(default_factory=dict)
    """(n,) by body: angle of the boresight from the centre of the Sun and the Moon, and from the limb of the Earth;
    only the bodies of which a specification excludes a part."""


def setting_of(
    scenario: Scenario, specification: Specification, columns: Columns, step_s: float | None = None
) -> Setting:
    """Setting of a scenario's frames; angles from the bodies if the specification has exclusion angles.

    Parameters
    ----------
    scenario : Scenario
        The scenario of the frames.
    specification : Specification
        Its specification.
    columns : mapping of arrays
        With ``t_s``, ``true_ra_deg`` and ``true_dec_deg`` if there are exclusion angles.
    step_s : float, optional
        Interval of the frames of a sequence.
    """
    angles: dict[str, FloatArray] = {}
    if specification.exclusion_deg:
        ra, dec = (np.radians(np.asarray(columns[name], dtype=float)) for name in ("true_ra_deg", "true_dec_deg"))
        bodies = [body for body, _ in specification.exclusion_deg]
        t_s = np.asarray(columns["t_s"], dtype=float)
        angles = body_angles_deg(scenario, t_s, radec_to_direction(ra, dec), bodies)
    return Setting(scenario.detector.exposure_s, not scenario.tracker.prior, step_s, angles)


def judge_frames(scenario: Scenario, columns: Columns, step_s: float | None = None) -> Judgement:
    """Verdicts on a scenario's specification from the columns of its trials, or of a sequence with this step."""
    specification = specification_of(scenario)
    return judge(specification, Measured(columns, specification, setting_of(scenario, specification, columns, step_s)))


@dataclass(frozen=True, eq=False)
class Measured:
    """Frames of a run or a sequence as evidence."""

    columns: Columns
    """As in ``trials.parquet`` or ``sequence.parquet``."""
    specification: Specification
    """Its conditions select the frames that count."""
    setting: Setting = Setting()

    basis = "measured"

    @property
    def unit(self) -> str:
        """What is counted."""
        return "trials" if self.setting.step_s is None else "independent frames"

    @cached_property
    def counted(self) -> BoolArray:
        """(n,): Frames in the conditions of the specification."""
        counted = np.ones(len(self.columns["status"]), dtype=bool)
        for body, angle in self.specification.exclusion_deg:
            counted &= self.setting.angles_deg[body] >= angle
        rate = self.specification.rate_deg_s
        return counted if rate is None else counted & _near(self._rates_deg_s, rate)

    @cached_property
    def _rates_deg_s(self) -> FloatArray:
        if "rate_deg_s" in self.columns:
            return np.asarray(self.columns["rate_deg_s"], dtype=float)
        rates = [np.asarray(self.columns[f"true_rate_{axis}_deg_s"], dtype=float) for axis in "xyz"]
        return np.asarray(np.linalg.norm(rates, axis=0))

    @cached_property
    def _solved(self) -> BoolArray:
        return np.asarray(np.asarray(self.columns["status"] == "solved", dtype=bool) & self.counted)

    @cached_property
    def _wrong(self) -> BoolArray:
        return np.asarray(outcome_flags(self.columns)[2] & self._solved)

    @property
    def wrong(self) -> int:
        """Wrong attitudes among the frames that count."""
        return int(self._wrong.sum())

    @property
    def misidentified(self) -> int:
        """Wrong attitudes with a misidentified star."""
        return int((outcome_flags(self.columns)[0] & self._wrong).sum())

    @property
    def gross(self) -> int:
        """Wrong attitudes with the right stars, inconsistent and beyond the specification."""
        misidentified, inconsistent, _ = outcome_flags(self.columns)
        return int((inconsistent & ~misidentified & self._wrong).sum())

    @property
    def untested(self) -> tuple[str, ...]:
        """The specified rate or what is outside the exclusion angles, if no frame has it."""
        if len(self.counted) == 0 or self.counted.any():
            return ()
        rate = self.specification.rate_deg_s
        if rate is not None and not _near(self._rates_deg_s, rate).any():
            low, high = float(np.min(self._rates_deg_s)), float(np.max(self._rates_deg_s))
            return (untested_rate(rate, low, high),)
        keys = ", ".join(
            f"specification.{body}_exclusion_deg {angle:g}" for body, angle in self.specification.exclusion_deg
        )
        return (f"every frame is excluded by {keys}",)

    @cached_property
    def _independent(self) -> float:
        """Fraction of the frames that are effectively independent: 1 for trials; in a sequence that of the most
        correlated error about a camera axis."""
        if self.setting.step_s is None:
            return 1.0
        errors = [np.asarray(self.columns[f"error_{axis}_deg"], dtype=float)[self._solved] for axis in CAMERA_AXES]
        solved = len(errors[0])
        return min(effective_number(error) for error in errors) / solved if solved else 1.0

    def estimate(self, requirement: Requirement) -> Estimate:
        """Measured value with its 95 % interval.

        Errors are those of the solved frames, wrong ones included. In a sequence the number of independent frames is
        the effective one (`simulator.study.intervals.effective_number`).
        """
        frames = int(self.counted.sum())
        if frames == 0:
            return Estimate(
                None, None, None, 0, "no frame in the specified conditions" if len(self.counted) else "no frame"
            )
        if requirement.axis:
            axes = ("cross_x", "cross_y") if requirement.axis == "across" else (requirement.axis,)
            errors = {axis: np.asarray(self.columns[f"error_{axis}_deg"], dtype=float) for axis in axes}
            return self._percentile(np.abs(error_about(errors, requirement.axis))[self._solved], requirement)
        if requirement.name in (AVAILABILITY, WRONG_RATE):
            right = int(self._solved.sum()) - self.wrong
            return self._share(right if requirement.name == AVAILABILITY else self.wrong, frames)
        if requirement.name == INCONSISTENT_RATE:
            return self._share(int((outcome_flags(self.columns)[1] & self._solved).sum()), frames)
        return self._acquisition(requirement)

    def _percentile(self, values: FloatArray, requirement: Requirement, independent: float | None = None) -> Estimate:
        assert requirement.percent is not None
        if len(values) == 0:
            return Estimate(None, None, None, 0)
        ordered = np.sort(values)
        count = len(values) * (self._independent if independent is None else independent)
        low, high = percentile_interval(ordered, requirement.percent, count)
        # a value of the sample, so that it is within its interval between two others, found by its number, as values
        # may be infinite
        number = int(np.percentile(np.arange(len(ordered)), requirement.percent, method="inverted_cdf"))
        return Estimate(float(ordered[number]), low, high, _rounded(count))

    def _share(self, number: int, frames: int) -> Estimate:
        """A fraction of the frames, of which as many are independent as of the errors."""
        count = frames * self._independent
        return Estimate(number / frames, *wilson_interval(number * self._independent, count), _rounded(count))

    def _acquisition(self, requirement: Requirement) -> Estimate:
        """Time to the first correct attitude: of every trial, as if all its later frames failed as its first does; of a
        sequence the one at its start."""
        if not self.setting.lost_in_space:
            return Estimate(None, None, None, 0, "not measured: the tracker has a prior (tracker.prior: false)")
        right = self._solved & ~self._wrong
        if self.setting.step_s is None:
            times = np.where(right[self.counted], self.setting.exposure_s, math.inf)
        else:
            first = int(np.argmax(right)) if right.any() else math.inf
            times = np.array([first * self.setting.step_s + self.setting.exposure_s])
        return self._percentile(times, requirement, independent=1.0)


def untested_rate(rate_deg_s: float, low_deg_s: float, high_deg_s: float) -> str:
    """Sentence on a specified rate that no frame has."""
    has = f"{low_deg_s:.3g}" if f"{low_deg_s:.3g}" == f"{high_deg_s:.3g}" else f"{low_deg_s:.3g} to {high_deg_s:.3g}"
    return (
        f"no frame turns at the {rate_deg_s:g}°/s of specification.rate_deg_s (within 10 %), but at {has}°/s; "
        "set pointing.rate_deg_s"
    )


def _near(rates_deg_s: FloatArray, rate_deg_s: float) -> BoolArray:
    return np.asarray((rates_deg_s >= RATE_BAND[0] * rate_deg_s) & (rates_deg_s <= RATE_BAND[1] * rate_deg_s))


def _rounded(count: float) -> float:
    """A whole number as such, for display."""
    return int(count) if float(count).is_integer() else round(count, 1)
