"""Design search: the smallest aperture, field or exposure that meets a scenario's specification and availability.

Nothing is rendered: the light of each star gives its centroid error (`simulator.study.coverage.sensitivity`), and the
stars of each field the attitude covariance P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹, at thousands of boresights. The resulting value
can be verified by a Monte Carlo run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.special import gammaincinv

from simulator.build import build_mounting
from simulator.mission.clock import Clock
from simulator.scenario import Scenario
from simulator.sky.colours import spectral_coordinates
from simulator.study.coverage.boresights import Boresights, along_path, whole_sky
from simulator.study.coverage.field_counts import accumulate_information, outline
from simulator.study.coverage.sensitivity import build_sensitivity
from simulator.study.run import run
from simulator.study.statistics import BODY_AXES, deg_text
from simulator.study.verdict import NOT_MET
from startracker._version import __version__
from startracker.catalog import load_catalog
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.guide import RESOLVED_PX
from startracker.catalog.voxels import voxel_grid
from startracker.errors import InputError

__all__ = ["PARAMETERS", "Design", "Point", "Trade", "Verification", "design", "predict", "verify"]

FloatArray = NDArray[np.float64]

Progress = Callable[[int], None]
"""Called with the number of values computed."""

_TOLERANCE = 0.005
"""Relative accuracy of the resulting value."""

_BLEND_MAG = 0.8
_LEAST_STARS = 2
"""Minimum number of stars of an attitude."""


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
    """Predicted 3σ about roll, pitch and yaw: three times the root mean square over the attitudes with enough stars, as
    in ``boresight run``."""
    met: bool = False
    """Whether specification and availability are met."""


@dataclass(frozen=True)
class Verification:
    """Monte Carlo run of the resulting value, compared with its prediction; angles in degrees."""

    trials: int
    solved: int
    wrong: int
    """Frames, solved frames, and frames with a wrong attitude."""
    three_sigma_deg: dict[str, float | None]
    predicted_deg: dict[str, float | None]
    """Three times the rms error about each body axis, measured and predicted."""
    p997_deg: dict[str, float | None] = field(default_factory=dict)
    """99.7th percentile of the measured errors."""
    contradictions: tuple[str, ...] = ()
    """Contradictions between the run and the prediction that the requirements are met; empty if there are none."""

    def to_dict(self) -> dict[str, Any]:
        """As in ``design.json``."""
        return asdict(self) | {"contradicted": bool(self.contradictions)}


@dataclass(frozen=True, eq=False)
class Design:
    """Trade-off of one parameter."""

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
    specification_deg: dict[str, float]
    """Specified 3σ about each body axis."""
    points: tuple[Point, ...]
    """In ascending order of value."""
    best: Point | None
    """The smallest value that meets the requirements; None if none does."""

    def to_dict(self) -> dict[str, Any]:
        """What ``design.json`` holds."""
        return {**asdict(self), "version": __version__}


def changed(scenario: Scenario, parameter: str, value: float) -> Scenario:
    """The scenario with another value of a parameter; `InputError` if no such camera is possible."""
    return _with(scenario, PARAMETERS[parameter][2](scenario, value))


def predict(scenario: Scenario, looks: Boresights, least_stars: int) -> Point:
    """Stars and accuracy of a scenario's camera at the given attitudes; `value` is 0.

    Stars are counted if they are in the tracker's catalogue and detected by the camera; the brightest up to the
    tracker's maximum (`tracker.detection.max_stars`).
    """
    sensitivity = build_sensitivity(scenario)
    camera = sensitivity.camera
    known = scenario.tracker.magnitude_limit
    every = load_catalog(scenario.tracker.catalog).brighter_than(known + _BLEND_MAG)
    if len(every) == 0:
        return Point(0.0, impossible=f"no star of the catalogue is brighter than {known:g}")
    stars = merge_doubles(every, min(RESOLVED_PX * camera.pixel_rad, 0.1)).brighter_than(known)
    b_v, giant = spectral_coordinates(stars.b_v, stars.spectral_type)
    electrons = sensitivity.electrons_of(stars.v_mag, b_v, giant)
    rows = np.argsort(-electrons, kind="stable")
    rows = rows[electrons[rows] >= sensitivity.least_electrons]
    directions = stars.directions(float(Clock(scenario.epoch).jyear(0.0)))[rows]
    counts, information = accumulate_information(
        looks.matrices,
        directions,
        voxel_grid(directions),
        outline(camera),
        1.0 / sensitivity.sigma_rad(electrons[rows]) ** 2,
        scenario.tracker.detection.max_stars,
        np.ascontiguousarray(looks.nadir),
        looks.limb_cosine,
    )
    enough = (counts >= max(least_stars, _LEAST_STARS)) & looks.allowed
    three_sigma: dict[str, float | None] = dict.fromkeys(BODY_AXES)
    if enough.any():
        to_body = build_mounting(scenario).inverse.as_matrix()
        covariance = to_body @ np.linalg.inv(information[enough]).mean(axis=0) @ to_body.T
        three = np.degrees(3.0 * np.sqrt(np.diag(covariance)))
        three_sigma = {axis: float(v) for axis, v in zip(BODY_AXES, three, strict=True)}
    return Point(
        value=0.0,
        magnitude_limit=min(sensitivity.magnitude_limit, known),
        stars_mean=float(counts.mean()),
        stars_min=int(counts.min()),
        availability=float(enough.mean()),
        three_sigma_deg=three_sigma,
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
    least_availability: float = 0.999
    """Required fraction of the sky (or of the time along the path) with this number, 0 to 1."""
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
        if not 0.0 <= self.least_availability <= 1.0:
            raise InputError(f"--availability: must be from 0 to 1, not {self.least_availability:g}")


def design(scenario: Scenario, trade: Trade, progress: Progress | None = None) -> Design:
    """Smallest value of a parameter that meets the specification and the availability.

    The limit is determined to 0.5 % by bisection between the first value of the table that meets the requirements and
    the previous one.

    Parameters
    ----------
    scenario : Scenario
        All other parameters, including the specification.
    trade : Trade
        Parameter, range and conditions.
    progress : callable, optional
        Called after every value.

    Raises
    ------
    InputError
        For an unknown parameter or invalid values.
    """
    trade.check()
    looks = along_path(scenario, trade.count) if trade.path else whole_sky(trade.count)
    specification = {axis: float(getattr(scenario.specification, f"{axis}_deg")) for axis in BODY_AXES}
    points: dict[float, Point] = {}

    def computed(value: float) -> Point:
        if value not in points:
            points[value] = _point(scenario, trade, value, looks, specification)
            if progress:
                progress(len(points))
        return points[value]

    grid = [float(f"{value:.6g}") for value in np.geomspace(trade.low, trade.high, trade.steps)]
    met = [computed(value).met for value in grid]
    best = None
    if any(met):
        first = met.index(True)
        best = points[grid[first]]
        if first > 0:
            fails = grid[first - 1]
            while best.value - fails > _TOLERANCE * best.value:
                middle = float(f"{math.sqrt(fails * best.value):.6g}")
                point = computed(middle)
                best, fails = (point, fails) if point.met else (best, middle)
    return Design(
        name=scenario.name,
        parameter=trade.parameter,
        over=looks.kind,
        attitudes=len(looks),
        least_stars=trade.least_stars,
        least_availability=trade.least_availability,
        specification_deg=specification,
        points=tuple(points[value] for value in sorted(points)),
        best=best,
    )


def verify(scenario: Scenario, result: Design, trials: int, workers: int = 1) -> Verification:
    """Run trials for the resulting value, over the whole sky or along the path as in the prediction.

    Raises
    ------
    InputError
        If no value was found, or for fewer than one trial.
    """
    if result.best is None:
        raise InputError("--verify: no value meets the specification, so there is nothing to verify")
    chosen = changed(scenario, result.parameter, result.best.value)
    if result.over == "sky":
        chosen = _with(chosen, {"study.sampling": "sky", "pointing.target": None})
    summary = run(chosen, trials, workers=workers).summary
    return Verification(
        trials=trials,
        solved=summary["solved"],
        wrong=summary["wrong"],
        three_sigma_deg={axis: summary["errors_deg"][axis]["three_sigma"] for axis in BODY_AXES},
        predicted_deg=dict(result.best.three_sigma_deg),
        p997_deg={axis: summary["errors_deg"][axis]["p997"] for axis in BODY_AXES},
        contradictions=tuple(_contradictions(summary, result)),
    )


def _contradictions(summary: Mapping[str, Any], result: Design) -> Iterator[str]:
    """Statistically significant contradictions between a run and the requirements.

    An axis contradicts if its verdict is "not met", or if three times its rms exceeds the specification by more than in
    99.9 % of runs that just meet it. For normal errors of equal σ, n (rms / σ)² has a χ² distribution of n degrees of
    freedom; a third of n is used, because fields differ and the poorest dominate (a kurtosis of 7; Box 1953).
    """
    n = summary["solved"]
    if summary["wrong"]:
        yield f"{summary['wrong']} of {n} accepted attitudes are wrong"
    low, high = summary["availability_interval95"]
    if high < result.least_availability:
        yield (
            f"{100 * summary['availability']:.2f} % of the frames were solved (95 % interval {100 * low:.2f} to "
            f"{100 * high:.2f} %), but {100 * result.least_availability:g} % are required"
        )
    freedom = max(n / 3.0, 1.0)
    excess = math.sqrt(2.0 * gammaincinv(freedom / 2.0, 0.999) / freedom)
    for axis, limit in result.specification_deg.items():
        three_sigma = summary["errors_deg"][axis]["three_sigma"]
        not_met = summary["specification"][axis]["verdict"] == NOT_MET
        if not_met or (three_sigma is not None and three_sigma > excess * limit):
            yield f"3σ {axis} is {deg_text(three_sigma)} , but {deg_text(limit)} is specified"


def _point(scenario: Scenario, trade: Trade, value: float, looks: Boresights, specification: dict[str, float]) -> Point:
    try:
        chosen = changed(scenario, trade.parameter, value)
    except InputError as error:
        return Point(value, impossible=str(error))
    point = predict(chosen, looks, trade.least_stars)
    accurate = all(
        (reached := point.three_sigma_deg.get(axis)) is not None and reached <= limit
        for axis, limit in specification.items()
    )
    met = accurate and point.availability is not None and point.availability >= trade.least_availability
    return replace(point, value=value, met=met)


def _with(scenario: Scenario, keys: dict[str, Any]) -> Scenario:
    """The scenario with other values of keys, checked as a file is: `InputError` if no such camera is possible."""
    try:
        return scenario.changed(keys)
    except ValidationError as error:
        reasons = [str(problem.get("ctx", {}).get("error", problem["msg"])) for problem in error.errors()]
        raise InputError("; ".join(" ".join(text.split()) for text in reasons)) from error
