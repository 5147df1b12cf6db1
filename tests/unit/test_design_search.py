"""The search for a design and its verification with cameras whose errors are known: no star is counted, no frame
rendered."""

import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from simulator.checks import load_scenario
from simulator.study.coverage.prediction import Prediction, left_out
from simulator.study.design import verification
from simulator.study.design.search import DEFAULT_AVAILABILITY, Design, Point, Search, Trade, _point, changed, design
from simulator.study.design.verification import MOST_RUNS, Verification, verified_design, verify
from simulator.study.specification.predicted import Predicted
from simulator.study.specification.requirements import Requirement, Specification
from simulator.study.specification.verdicts import MET, NOT_MET, Estimate, Judgement, Verdict
from startracker.errors import InputError

SCENARIO = load_scenario("cubesat_ideal", ["detector.width=64", "detector.height=64", "specification.availability=0.9"])
LIMIT = 10.0  # of the error about yaw, which is 60 over the value of the parameter
YAW = Requirement("yaw", LIMIT, 99.7, "yaw")
AXES = ("roll", "pitch", "yaw")


class Known(Search):
    """A search among cameras with an error of 60/value, enough stars from 2 on, and none at 40 and more."""

    def _computed(self, value):
        if value >= 40.0:
            return Point(value, impossible="too large")
        error = 60.0 / value
        entry = {"value_deg": error, "specified_deg": LIMIT}
        axes = dict.fromkeys(AXES, error)
        return Point(value, "", 6.0, 9.0, 3, 1.0 if value >= 2.0 else 0.5, axes, {"yaw": entry}, error <= LIMIT)


def trade(**keys):
    return Trade(**({"parameter": "detector.exposure_s", "low": 0.5, "high": 30.0, "steps": 5, "count": 10} | keys))


def search(**keys):
    return Known(SCENARIO, trade(**keys))


# ---------------------------------------------------------------- search
def test_the_smallest_value_is_found_to_half_a_percent():
    found = search()
    best = found.smallest()
    assert 6.0 <= best.value <= 6.0 * 1.005
    twice = found.smallest({"yaw": 2.0})
    assert 12.0 <= twice.value <= 12.0 * 1.005
    assert found.smallest({"roll": 9.0}).value == best.value  # of a requirement that is not there
    assert found.smallest({"yaw": 6.0}) is None  # 36 is beyond the range


def test_values_below_a_bound_are_not_considered():
    found = search()
    assert found.smallest(above=9.0).value == 9.0
    assert 12.0 <= found.smallest({"yaw": 2.0}, above=7.0).value <= 12.0 * 1.005
    assert found.smallest({"yaw": 0.1}, above=0.0).value == pytest.approx(2.0, rel=0.006)  # enough stars from 2 on


def test_every_value_is_computed_once_and_the_progress_told():
    told = []
    found = Known(SCENARIO, trade(), told.append)
    for value in (3.0, 4.0, 3.0):
        found.point(value)
    assert told == [1, 2]
    assert sorted(found.points) == [3.0, 4.0]


def test_the_grid_has_equal_ratios():
    assert search(low=1.0, high=16.0, steps=5).grid == [1.0, 2.0, 4.0, 8.0, 16.0]


@pytest.mark.parametrize(
    ("of_trade", "of_scenario", "least"),
    [(None, 0.9, 0.9), (0.7, 0.9, 0.7), (0.0, 0.9, 0.0), (None, None, DEFAULT_AVAILABILITY)],
)
def test_the_least_availability_is_that_of_the_trade_then_of_the_specification(of_trade, of_scenario, least):
    scenario = SCENARIO.changed({"specification.availability": of_scenario})
    assert Known(scenario, trade(least_availability=of_trade)).least_availability == least


def entry(value_deg, limit_deg=10.0):
    return {"yaw": {"value_deg": value_deg, "specified_deg": limit_deg}}


@pytest.mark.parametrize(
    ("point", "factors", "within"),
    [
        (Point(1.0, "", availability=0.9, specification=entry(9.0)), {}, True),
        (Point(1.0, "", availability=0.8, specification=entry(9.0)), {}, False),
        (Point(1.0, "", availability=None), {}, False),
        (Point(1.0, "no such camera", availability=1.0), {}, False),
        (Point(1.0, "", availability=1.0, specification=entry(None)), {}, False),
        (Point(1.0, "", availability=1.0, specification=entry(5.0)), {"yaw": 2.0}, True),
        (Point(1.0, "", availability=1.0, specification=entry(5.1)), {"yaw": 2.0}, False),
        (Point(1.0, "", availability=1.0, specification={"availability": {"specified": 0.5, "value": 0.1}}), {}, True),
    ],
)
def test_a_point_is_within_its_limits(point, factors, within):
    assert point.within(factors, 0.9) is within


def test_a_design_has_its_points_in_order_and_the_conditions_of_the_trade():
    found = search(least_stars=7)
    found.point(29.0)
    result = design(SCENARIO, found.trade, search=found)
    values = [point.value for point in result.points]
    assert values == sorted(values)
    assert {0.5, 30.0, 29.0} <= set(values)
    assert result.best.value == found.smallest().value
    assert (result.over, result.attitudes, result.least_stars, result.least_availability) == ("sky", 10, 7, 0.9)
    assert (result.name, result.parameter) == (SCENARIO.name, "detector.exposure_s")


@pytest.mark.parametrize("field_deg", [0.0, -1.0, 170.0, math.nan])
def test_fields_that_no_lens_has(field_deg):
    with pytest.raises(Exception, match="field: must be above 0 and below 170 degrees"):
        changed(SCENARIO, "field", field_deg)


@pytest.mark.parametrize(
    ("limits", "counted", "met"),
    [
        ((1.0,), 10, True),
        ((1e-4,), 10, False),
        ((1.0, 1e-4), 10, False),
        ((1.0,), 8, False),  # too few attitudes
        ((1.0, None), 10, True),  # what cannot be predicted does not count
        ((1e-4, None), 10, False),
    ],
)
def test_a_point_is_met_by_all_that_can_be_predicted(limits, counted, met):
    """1e-6 rad about every axis are 5.7e-5°, of which 99.7 % are below 1.7e-4°."""
    axes = ("yaw", "roll")
    required = [
        Requirement("acquisition", 1.0, 50.0) if limit is None else Requirement(axis, limit, 99.7, axis)
        for axis, limit in zip(axes, limits, strict=False)
    ]
    covariance = np.tile(np.eye(3) * 1e-12, (counted, 1, 1))
    evidence = Predicted(covariance, np.eye(3), 10, Specification(tuple(required)), 0.1)
    found = _point(3.0, Prediction(6.5, np.array([4, 9, 5]), evidence), 0.9)
    assert found.met is met
    assert (found.availability, found.stars_min, found.stars_mean) == (counted / 10, 4, 6.0)
    assert (found.value, found.magnitude_limit) == (3.0, 6.5)
    assert found.three_sigma_deg["yaw"] == pytest.approx(3.0 * math.degrees(1e-6))
    none = _point(3.0, Prediction(6.5, np.zeros(3, int), replace(evidence, covariance_rad2=covariance[:0])), 0.9)
    assert none.three_sigma_deg == dict.fromkeys(AXES)
    assert not none.met


@pytest.mark.parametrize("keys", [{"high": math.inf}, {"low": 0.0}, {"low": 31.0}, {"low": 30.0}])
def test_ranges_that_cannot_be_searched(keys):
    with pytest.raises(InputError, match="must be 0 < from < to"):
        trade(**keys).check()


def test_the_least_values_of_a_trade_are_allowed():
    trade(steps=2, least_stars=1, least_availability=0.0).check()
    trade(least_availability=1.0).check()
    for keys in ({"steps": 1}, {"least_stars": 0}, {"least_availability": -1e-9}, {"least_availability": 1.001}):
        with pytest.raises(InputError, match="must be"):
            trade(**keys).check()


def test_a_narrow_field_and_a_rolling_shutter():
    """A field of half a degree: 32 pixels on either side are tan 0.25° of the focal length."""
    pitch_mm = SCENARIO.detector.pitch_um[0] * 1e-3
    narrow = changed(SCENARIO, "field", 0.5).optics.focal_length_mm
    assert narrow == pytest.approx(32.0 * pitch_mm / math.tan(math.radians(0.25)), rel=1e-12)
    assert "rolling shutter" not in left_out(SCENARIO)
    assert "rolling shutter" in left_out(
        SCENARIO.changed({"detector.shutter": "rolling", "detector.line_time_us": 20.0})
    )


# ---------------------------------------------------------------- verification
def judgement(measured, frames=3000, wrong=0, spread=0.0):
    """A measured error about yaw, known to `spread` of it."""
    estimate = Estimate(measured, measured * (1.0 - spread), measured * (1.0 + spread), frames)
    return Judgement((Verdict(YAW, estimate),), "measured", "trials", wrong)


def run_of(value, factor, frames=3000, spread=0.0):
    judged = judgement(factor * 60.0 / value, frames, spread=spread)
    bad = ("yaw is not met",) if judged.state == NOT_MET else ()
    none = dict.fromkeys(AXES)
    return Verification(value, frames, frames, 0, 0, 0, judged, {"yaw": factor}, none, none, none, bad)


def verified(monkeypatch, factor, **keys):
    """Design whose trials find errors `factor` times those predicted."""
    reports = []

    def fake(_scenario, _result, trials, workers, point):
        assert (trials, workers) == (3000, 4)
        return run_of(point.value, factor(point.value) if callable(factor) else factor)

    monkeypatch.setattr(verification, "verify", fake)
    found = search(**keys)
    result = verified_design(
        SCENARIO, found.trade, 3000, 4, found, lambda number, value: reports.append((number, value))
    )
    assert [value for _, value in reports] == [run.value for run in result.runs]
    assert [number for number, _ in reports] == list(range(1, len(result.runs) + 1))
    return result


def test_a_prediction_that_holds_needs_one_run(monkeypatch):
    found = verified(monkeypatch, 0.97)
    assert [run.value for run in found.runs] == [found.design.best.value]
    assert found.answer is found.runs[0]
    assert found.confirmed == "confirmed"
    assert not found.contradicted
    told = found.to_dict()
    assert told["answer"] == told["verification"]["value"] == found.design.best.value
    assert told["verification"]["accepted"] is True
    assert told["verification"]["contradicted"] is False


def test_a_prediction_without_runs_is_the_answer_itself():
    found = search()
    unverified = verification.Verified(design(SCENARIO, found.trade, search=found), ()).to_dict()
    assert unverified["answer"] == found.smallest().value
    assert unverified["verification"] is None
    assert unverified["verifications"] == []


def test_a_contradicted_prediction_is_corrected_by_its_factor(monkeypatch):
    """Errors twice as large: 12 is needed. At most 1.5 times the value before, then by the factor, then by bisection to
    12 % between the largest contradicted and the smallest confirmed value."""
    found = verified(monkeypatch, 2.0)
    values = [run.value for run in found.runs]
    first = found.design.best.value
    assert values[1] == pytest.approx(1.5 * first, rel=1e-5)
    assert 12.0 <= values[2] <= 12.0 * 1.005
    assert values[3] == pytest.approx(math.sqrt(values[1] * values[2]), rel=1e-5)
    assert found.answer.value == values[2]
    assert found.answer.value / max(run.value for run in found.runs if not run.accepted) <= 1.12
    assert set(values) <= {point.value for point in found.design.points}


def test_a_slight_contradiction_makes_at_least_a_small_step(monkeypatch):
    found = verified(monkeypatch, 1.02)
    assert len(found.runs) == 2
    assert found.runs[1].value == pytest.approx(1.03 * found.runs[0].value, rel=1e-5)
    assert found.answer is found.runs[1]


def test_errors_that_no_value_brings_within_the_limit(monkeypatch):
    """Up to the end of the range by the largest step, and no further."""
    found = verified(monkeypatch, lambda value: 2.0 * value)
    values = [run.value for run in found.runs]
    assert found.contradicted
    assert found.answer is None
    assert values[-1] == 30.0
    for less, more in pairwise(values):
        assert more == pytest.approx(min(1.5 * less, 30.0), rel=1e-5)
    told = found.to_dict()
    assert told["answer"] is None
    assert told["verification"]["value"] == 30.0
    assert len(told["verifications"]) == len(values)


def test_the_number_of_runs_is_limited(monkeypatch):
    found = verified(monkeypatch, lambda value: 1.0001 * value / 6.0, high=39.0)
    assert len(found.runs) == MOST_RUNS


def test_the_search_ends_where_no_larger_camera_is_possible(monkeypatch):
    found = verified(monkeypatch, 100.0, high=60.0)
    assert found.runs[-1].value < 40.0
    assert found.contradicted


def test_a_run_without_a_value_goes_on_by_a_fixed_step():
    """Nothing was solved: no factor can be derived."""
    found = search()
    first = replace(run_of(6.0, 2.0), judgement=Judgement((Verdict(YAW, Estimate(None, None, None, 9)),), "m", "t"))
    assert verification._next([first], found).value == pytest.approx(1.15 * 6.0)
    assert verification._next([replace(first, value=30.0)], found) is None


def test_the_upper_limit_of_an_error_gives_the_factor():
    """1.2 measured, known to 20 %: 1.44 of what was predicted, so 8.64."""
    found = verification._next([run_of(6.0, 1.2, spread=0.2)], search())
    assert 8.64 <= found.value <= 8.64 * 1.005


@pytest.mark.parametrize(
    ("failed", "confirmed", "following"),
    [
        ((), (8.0,), None),
        ((7.5,), (8.0,), None),
        ((9.0,), (8.0,), None),
        ((4.0,), (9.0,), 6.0),
        ((2.0, 4.0), (9.0, 25.0), 6.0),
    ],
)
def test_bisection_between_contradicted_and_confirmed(failed, confirmed, following):
    runs = [run_of(value, 100.0) for value in failed] + [run_of(value, 0.1) for value in confirmed]
    assert [run.accepted for run in runs] == [False] * len(failed) + [True] * len(confirmed)
    found = verification._next(runs, search())
    assert (found and found.value) == following


@pytest.mark.parametrize(
    ("value", "low", "high", "frames", "accepted"),
    [
        (9.0, 8.0, 10.0, 3000, True),  # met
        (9.0, 8.0, 11.0, 3000, False),  # undecided with enough trials
        (9.0, 8.0, None, 100, True),  # too few trials, and within the limit
        (10.5, 8.0, None, 100, False),
        (12.0, 11.0, 13.0, 100, False),  # not met
    ],
)
def test_what_confirms_a_value(value, low, high, frames, accepted):
    judged = Judgement((Verdict(YAW, Estimate(value, low, high, frames)),), "measured", "trials")
    bad = ("yaw",) if judged.state == NOT_MET else ()
    run = replace(run_of(6.0, 1.0), judgement=judged, contradictions=bad)
    assert run.accepted is accepted
    unknown = Verdict(YAW, Estimate(None, None, None, 0, "no frame at this rate"))
    assert replace(run, judgement=Judgement((unknown,), "measured", "trials"), contradictions=()).accepted
    assert not replace(run, contradictions=("anything",)).accepted


def test_an_answer_with_few_trials_is_not_contradicted_but_not_confirmed():
    few = replace(run_of(6.0, 0.5), judgement=Judgement((Verdict(YAW, Estimate(5.0, 4.0, None, 99)),), "m", "trials"))
    nothing = Design("a", "b", "sky", 1, 1, 1.0, (), (), (), None)
    found = verification.Verified(nothing, (replace(few, value=8.0), few, run_of(2.0, 9.0)))
    assert found.answer.value == 6.0
    assert found.confirmed == "not contradicted"
    assert verification.Verified(nothing, ()).confirmed == "not contradicted"
    assert not verification.Verified(nothing, ()).contradicted


@pytest.mark.parametrize(
    ("availability", "interval", "wrong", "words"),
    [
        (0.85, (0.80, 0.89), 0, ["85.00 % of the frames were solved (95 % interval 80.00 to 89.00 %), but 90 % are"]),
        (0.85, (0.80, 0.90), 0, []),
        (1.0, (0.99, 1.0), 2, ["2 of 50 accepted attitudes are wrong"]),
    ],
)
def test_contradictions_of_a_run(monkeypatch, availability, interval, wrong, words):
    """Measured over predicted, and what the summary of the run holds."""
    summary = {
        "trials": 60, "solved": 50, "misidentified": 1, "inconsistent": 3, "wrong": wrong,
        "availability": availability, "availability_interval95": interval,
        "errors_deg": {axis: {"three_sigma": k + 1.0, "p997": k + 5.0} for k, axis in enumerate(AXES)},
    }  # fmt: skip
    asked = []

    def fake(chosen, trials, workers):
        asked.append((trials, workers, chosen.study.sampling, chosen.detector.exposure_s))
        return SimpleNamespace(summary=summary, judgement=judgement(4.0, wrong=wrong))

    monkeypatch.setattr(verification, "run", fake)
    found = search()
    result = design(SCENARIO, found.trade, search=found)
    run = verify(SCENARIO, result, 400, 3, found.point(8.0))
    assert asked == [(400, 3, "sky", 8.0)]  # a tenth of so few would not tell
    assert len(run.contradictions) == len(words)
    for said, wanted in zip(run.contradictions, words, strict=True):
        assert said.startswith(wanted)
    assert run.ratio == {"yaw": pytest.approx(4.0 / 7.5)}
    assert run.three_sigma_deg == {"roll": 1.0, "pitch": 2.0, "yaw": 3.0}
    assert run.p997_deg == {"roll": 5.0, "pitch": 6.0, "yaw": 7.0}
    assert run.predicted_deg == dict.fromkeys(AXES, 7.5)
    assert (run.trials, run.solved, run.misidentified, run.inconsistent, run.wrong) == (60, 50, 1, 3, wrong)
    assert verify(SCENARIO, result, 400, 3).value == result.best.value


@pytest.mark.parametrize(
    ("trials", "first_state", "looks"), [(500, MET, [50, 500]), (500, NOT_MET, [50]), (499, NOT_MET, [499])]
)
def test_a_first_look_at_a_tenth_of_the_trials(monkeypatch, trials, first_state, looks):
    asked = []

    def fake(_chosen, count, workers):
        asked.append(count)
        none = {axis: {"three_sigma": 1.0, "p997": 1.0} for axis in AXES}
        summary = {"trials": count, "solved": count, "wrong": 0, "availability": 1.0, "errors_deg": none}
        summary["availability_interval95"] = (0.99, 1.0)
        return SimpleNamespace(summary=summary, judgement=judgement(4.0 if first_state == MET else 40.0))

    monkeypatch.setattr(verification, "run", fake)
    found = search()
    run = verify(SCENARIO, design(SCENARIO, found.trade, search=found), trials, point=found.point(8.0))
    assert asked == looks
    assert (run.trials, run.misidentified, run.inconsistent) == (looks[-1], 0, 0)
