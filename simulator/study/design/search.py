"""Design search: the smallest aperture, field or exposure predicted to meet a scenario's specification.

Nothing is rendered (`simulator.study.coverage.prediction`). `simulator.study.design.verification` runs trials of the
value found, and searches on with them if they contradict the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from simulator.scenario import Scenario, ScenarioError
from simulator.study.axes import BODY_AXES
from simulator.study.coverage.boresights import Boresights, Exclusion, along_path, whole_sky
from simulator.study.coverage.prediction import Prediction, left_out, predict
from simulator.study.specification.requirements import AVAILABILITY, Requirement, Specification, specification_of
from simulator.study.specification.verdicts import MET, judge
from startracker._version import __version__
from startracker.errors import InputError

Progress = Callable[[int], None]
"""Called with the number of values computed."""

DEFAULT_AVAILABILITY = 0.999
"""Fraction of the attitudes with enough stars if neither the specification nor the trade requires one."""

_TOLERANCE = 0.005
"""Relative accuracy of the resulting value."""


def _focal_length(scenario: Scenario, field_deg: float) -> dict[str, Any]:
    """Keys that give this field across the detector's width, edge to edge."""
    if not 0.0 < field_deg < 170.0:
        raise InputError(f"field: must be above 0 and below 170 degrees, not {field_deg:g}")
    half_mm = 0.5 * scenario.detector.width * scenario.detector.pitch_um[0] * 1e-3
    half = math.radians(field_deg) / 2.0
    reach = {"pinhole": math.tan(half), "equisolid": 2.0 * math.sin(half / 2.0)}.get(scenario.optics.projection, half)
    return {"optics.focal_length_mm": half_mm / reach}


PARAMETERS: dict[str, tuple[str, str, Callable[[Scenario, float], dict[str, Any]]]] = {
    "optics.aperture_mm": ("aperture", "mm", lambda scenario, value: {"optics.aperture_mm": value}),
    "field": ("field across the width", "°", _focal_length),
    "detector.exposure_s": ("exposure", "s", lambda scenario, value: {"detector.exposure_s": value}),
}
"""Parameters: title, unit, and the keys set by a value. ``field`` changes the focal length, not the aperture or the
detector."""


@dataclass(frozen=True)
class Point:
    """Prediction for one value of the parameter."""

    value: float
    """Value of the parameter, in its unit."""
    impossible: str = ""
    """Reason why no such camera is possible; the other fields are then undefined."""
    magnitude_limit: float | None = None
    """Faintest star counted, V: the detection limit of the camera or the limit of the tracker's catalogue."""
    stars_mean: float | None = None
    stars_min: int | None = None
    """Stars used in a field."""
    availability: float | None = None
    """Fraction of the attitudes with enough stars."""
    three_sigma_deg: dict[str, float | None] = field(default_factory=dict)
    """Three times the predicted rms error about roll, pitch and yaw over the attitudes with enough stars."""
    specification: dict[str, Any] = field(default_factory=dict)
    """Predicted value of each requirement, its limit and verdict, as in ``summary.json``."""
    met: bool = False
    """Whether all requirements that can be predicted are met."""

    def within(self, factors: Mapping[str, float], least_availability: float) -> bool:
        """Whether every predicted error is within its limit after multiplication by its factor (1 if not given), and
        the availability is sufficient."""
        if self.impossible or self.availability is None or self.availability < least_availability:
            return False
        errors = [(name, entry) for name, entry in self.specification.items() if "specified_deg" in entry]
        return all(
            entry["value_deg"] is not None and entry["value_deg"] * factors.get(name, 1.0) <= entry["specified_deg"]
            for name, entry in errors
        )


@dataclass(frozen=True)
class Trade:
    """The varied parameter, and the requirements for its smallest value."""

    parameter: str
    """A key of `PARAMETERS`."""
    low: float
    high: float
    """Range searched, in the parameter's unit."""
    steps: int = 12
    """Number of values in the table, at equal ratios, at least 2."""
    least_stars: int = 5
    """Minimum number of stars for an attitude to be available."""
    least_availability: float | None = None
    """Required fraction of the sky (or of the time along the path) with this number, 0 to 1; None: that of the
    specification, otherwise `DEFAULT_AVAILABILITY`."""
    count: int = 5000
    """Attitudes."""
    path: bool = False
    """Along the mission's path instead of the whole sky."""

    def check(self) -> None:
        """Raise `InputError` for an unknown parameter or invalid values."""
        if self.parameter not in PARAMETERS:
            known = ", ".join(PARAMETERS)
            raise InputError(f"--over: unknown parameter {self.parameter!r}; use one of {known}")
        if not (math.isfinite(self.high) and 0.0 < self.low < self.high):
            raise InputError(f"--from and --to: must be 0 < from < to, not {self.low:g} and {self.high:g}")
        if self.steps < 2:
            raise InputError(f"--steps: must be at least 2, not {self.steps}")
        if self.least_stars < 1:
            raise InputError(f"--stars: must be at least 1, not {self.least_stars}")
        if self.least_availability is not None and not 0.0 <= self.least_availability <= 1.0:
            raise InputError(f"--availability: must be from 0 to 1, not {self.least_availability:g}")


@dataclass(frozen=True, eq=False)
class Design:
    """Trade-off of one parameter, as predicted."""

    name: str
    """Of the scenario."""
    parameter: str
    """A key of `PARAMETERS`."""
    over: str
    """``sky`` or ``path``."""
    attitudes: int
    """Number of boresights."""
    least_stars: int
    """Minimum number of stars for an attitude."""
    least_availability: float
    """Required fraction of the attitudes with this number."""
    requirements: tuple[Requirement, ...]
    """What is specified."""
    left_out: tuple[str, ...]
    """What the scenario contains and the prediction does not."""
    points: tuple[Point, ...]
    """In ascending order of value."""
    best: Point | None
    """The smallest value predicted to meet the requirements; None if none does."""

    def to_dict(self) -> dict[str, Any]:
        """What ``design.json`` holds of the prediction."""
        return {**asdict(self), "version": __version__}


def changed(scenario: Scenario, parameter: str, value: float) -> Scenario:
    """The scenario with another value of a parameter, checked as a file is; `InputError` if no such camera is
    possible."""
    try:
        return scenario.changed(PARAMETERS[parameter][2](scenario, value))
    except ScenarioError as error:
        raise InputError("; ".join(str(error).splitlines())) from error


class Search:
    """Predictions of one trade by value, each computed once.

    Parameters
    ----------
    scenario, trade
        As for `design`.
    progress : callable, optional
        Called after every new value.

    Raises
    ------
    InputError
        For an unknown parameter or invalid values.
    """

    def __init__(self, scenario: Scenario, trade: Trade, progress: Progress | None = None) -> None:
        trade.check()
        self.scenario, self.trade, self.progress = scenario, trade, progress
        self.specification = specification_of(scenario)
        self.looks = _attitudes(scenario, trade, self.specification)
        asked = self.specification.find(AVAILABILITY)
        self.least_availability = (
            trade.least_availability
            if trade.least_availability is not None
            else asked.limit
            if asked
            else DEFAULT_AVAILABILITY
        )
        self.grid = [float(f"{value:.6g}") for value in np.geomspace(trade.low, trade.high, trade.steps)]
        self.points: dict[float, Point] = {}

    def point(self, value: float) -> Point:
        """Prediction of a value of the parameter."""
        if value not in self.points:
            self.points[value] = self._computed(value)
            if self.progress:
                self.progress(len(self.points))
        return self.points[value]

    def smallest(self, factors: Mapping[str, float] | None = None, above: float = 0.0) -> Point | None:
        """Smallest value that meets the requirements, to 0.5 %; None if none of the grid does.

        Parameters
        ----------
        factors : mapping, optional
            Factors on the predicted errors by the name of their requirement.
        above : float
            Smaller values are not considered.
        """
        factors = factors or {}

        def meets(value: float) -> bool:
            return self.point(value).within(factors, self.least_availability)

        grid = [above, *(value for value in self.grid if value > above)] if above else self.grid
        met = [meets(value) for value in grid]
        if not any(met):
            return None
        first = met.index(True)
        best, fails = grid[first], grid[first - 1] if first else 0.0
        while first and best - fails > _TOLERANCE * best:
            middle = float(f"{math.sqrt(fails * best):.6g}")
            best, fails = (middle, fails) if meets(middle) else (best, middle)
        return self.point(best)

    def _computed(self, value: float) -> Point:
        try:
            chosen = changed(self.scenario, self.trade.parameter, value)
        except InputError as error:
            return Point(value, impossible=str(error))
        return _point(value, predict(chosen, self.looks, self.trade.least_stars), self.least_availability)


def design(
    scenario: Scenario, trade: Trade, progress: Progress | None = None, *, search: Search | None = None
) -> Design:
    """Smallest value of a parameter that is predicted to meet the specification and the availability.

    The error of each attitude is normal with its predicted covariance; the percentiles are those of the mixture over
    all attitudes. The limit is determined to 0.5 % by bisection between the first value of the table that meets the
    requirements and the previous one.

    Parameters
    ----------
    scenario : Scenario
        All other parameters, including the specification.
    trade : Trade
        Parameter, range and conditions.
    progress : callable, optional
        Called after every value.
    search : Search, optional
        Predictions already computed for this scenario and trade, to which those computed here are added.

    Raises
    ------
    InputError
        For an unknown parameter or invalid values, or if the scenario does not turn at the specified rate.
    """
    search = search or Search(scenario, trade, progress)
    for value in search.grid:
        search.point(value)
    best = search.smallest()
    return Design(
        name=scenario.name,
        parameter=trade.parameter,
        over=search.looks.kind,
        attitudes=len(search.looks),
        least_stars=trade.least_stars,
        least_availability=search.least_availability,
        requirements=search.specification.requirements,
        left_out=left_out(scenario),
        points=tuple(search.points[value] for value in sorted(search.points)),
        best=best,
    )


def _attitudes(scenario: Scenario, trade: Trade, specification: Specification) -> Boresights:
    """Attitudes of a trade; those within the specified exclusion angles do not count."""
    angles = dict(specification.exclusion_deg)
    excluded = Exclusion(angles.get("sun", 0.0), angles.get("moon", 0.0), angles.get("earth", 0.0))
    if trade.path:
        return along_path(scenario, trade.count, excluded)
    return whole_sky(trade.count, scenario=scenario, exclusion=excluded)


def _point(value: float, prediction: Prediction, least_availability: float) -> Point:
    evidence = prediction.evidence
    if evidence.untested:
        raise InputError(evidence.untested[0])
    judged = judge(evidence.specification, evidence)
    enough = len(evidence.covariance_rad2)
    availability = enough / evidence.attitudes
    met = all(verdict.verdict == MET for verdict in judged.verdicts if not verdict.estimate.unknown)
    return Point(
        value=value,
        magnitude_limit=prediction.magnitude_limit,
        stars_mean=float(prediction.counts.mean()),
        stars_min=int(prediction.counts.min()),
        availability=availability,
        three_sigma_deg={axis: 3.0 * evidence.rms_deg(axis) if enough else None for axis in BODY_AXES},
        specification=judged.by_name(),
        met=met and availability >= least_availability,
    )
