"""Verdicts, evidence, outliers and intervals at their edges: what has no frame, no value, no limit, and what is just
within."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from scipy import stats

from simulator.build import build_orbit
from simulator.scenario import Scenario
from simulator.study.axes import AXES
from simulator.study.budget.effects import EFFECTS
from simulator.study.budget.error_budget import Budget, Contribution, _contribution, _Run
from simulator.study.budget.outliers import Outlier, find_outliers, lines_of
from simulator.study.intervals import (
    effective_number,
    mean_chi_square_bounds,
    moment_intervals,
    percentile_interval,
    plain,
    ratios_of_rms,
    spread_interval,
    wilson_interval,
)
from simulator.study.pages.parts import provenance, verdict_table
from simulator.study.pictures import Shades, draw_solution
from simulator.study.process_noise import process_noise
from simulator.study.specification.measured import Measured, Setting
from simulator.study.specification.predicted import Predicted
from simulator.study.specification.requirements import Requirement, Specification
from simulator.study.specification.verdicts import Estimate, Judgement, Verdict
from simulator.study.statistics import against_bound, axis_statistics, consistency, error_against, outliers
from simulator.study.style import PICTURE_STYLE, Panel, figure_of, new_figure
from simulator.study.texts import deg_text, percent_text
from simulator.study.trials import columns as columns_module
from startracker.solution import MatchedStars, Solution, Status
from startracker.tracking import GyroNoise, RateNoise

ROLL = Requirement("roll", 1.0, 99.7, "roll")
AVAILABILITY, WRONG = Requirement("availability", 0.99), Requirement("wrong_rate", 0.01)
INCONSISTENT, ACQUISITION = Requirement("inconsistent_rate", 0.01), Requirement("acquisition", 2.0, 50.0)


# ---------------------------------------------------------------------- words and limits
@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (math.inf, "–"), (0.1, "0.1000°"), (-0.1, "-0.1000°"), (0.09999, "359.96″"), (0.0, "0.00″")],
)
def test_angles_in_words(value, text):
    assert deg_text(value) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (None, "–"), (0.0, "0.00 %"), (1.0, "100.00 %"), (0.5, "50.00 %"), (1e-4, "0.01 %"), (9e-5, "0.009 %"),
        (1.0 - 1e-5, "99.999 %"), (1e-6, "0.0001 %"), (1e-9, "0.000000 %"), (2e-6, "0.0002 %"),
    ],
)  # fmt: skip
def test_fractions_in_words(share, text):
    assert percent_text(share) == text


@pytest.mark.parametrize(
    ("requirement", "value", "margin"),
    [
        (ROLL, 0.5, 2.0), (ROLL, None, None), (ROLL, 0.0, None), (AVAILABILITY, 0.995, 2.0), (AVAILABILITY, 1.0, None),
        (WRONG, 0.02, 0.5),
    ],
)  # fmt: skip
def test_margins(requirement, value, margin):
    found = Verdict(requirement, Estimate(value, value, value, 9)).margin
    assert found == (None if margin is None else pytest.approx(margin))


def test_a_verdict_in_words_and_as_data():
    """The limit itself is met; a common unit is written once; an interval of one value is none."""
    verdict = Verdict(ROLL, Estimate(0.002, 0.001, 1.0, 2000))
    assert (verdict.verdict, verdict.interval_text) == ("met", "3.60″ to 1.0000°")
    close = Verdict(ROLL, Estimate(0.002, 0.001, 0.003, 2000))
    assert close.interval_text == "3.60 to 10.80″"
    assert close.text == "roll: 99.7 % below 7.20″ (95 % interval 3.60 to 10.80″), specified 1.0000°: met"
    assert Verdict(ROLL, Estimate(0.002, 0.002, 0.002, 9)).interval_text == ""
    assert Verdict(ROLL, Estimate(1.1, 1.0, 1.2, 9)).verdict == "undecided"  # it may be the limit
    unknown = Verdict(ROLL, Estimate(None, None, None, 0, "no frame"))
    assert (unknown.value_text, unknown.interval_text) == ("no frame", "")
    assert unknown.to_dict()["unknown"] == "no frame"
    data = close.to_dict(0.004)
    assert data | {"text": ""} == {
        "specified_deg": 1.0, "value_deg": 0.002, "interval95_deg": [0.001, 0.003], "percentile": 99.7, "frames": 2000,
        "frames_needed": 1228, "verdict": "met", "met": True, "text": "", "p997_deg": 0.002,
        "p997_interval95_deg": [0.001, 0.003], "three_sigma_deg": 0.004,
    }  # fmt: skip
    other = Verdict(replace(ROLL, percent=95.0), Estimate(math.inf, None, math.inf, 9)).to_dict()
    assert (other["value_deg"], other["interval95_deg"], other["met"]) == (None, [None, None], False)
    assert "p997_deg" not in other
    late = Verdict(ACQUISITION, Estimate(math.inf, 0.5, None, 9))
    assert (late.value_text, late.interval_text) == ("50 % below never", "0.5 s to –")
    assert late.to_dict()["specified_s"] == 2.0
    share = Verdict(AVAILABILITY, Estimate(0.992, 0.99, 0.995, 900))
    assert (share.verdict, share.to_dict()["specified"]) == ("met", 0.99)  # its lower end is the limit


@pytest.mark.parametrize(
    ("verdicts", "given", "state", "text"),
    [
        ((0.5,), {}, "met", "Specification: met: smallest margin roll, 2 ×"),
        ((0.5, 0.8), {"basis": "predicted"}, "met", "Specification: met (predicted): smallest margin roll, 1.25 ×"),
        ((0.0,), {}, "met", "Specification: met"),
        ((1.5, 0.5), {}, "not met", "Specification: not met: roll 99.7 % below 1.5000° (specified 1.0000°)"),
        ((0.5,), {"wrong": 1, "misidentified": 1}, "not met", "Specification: not met: 1 wrong attitude (1 misid"),
        ((0.5,), {"wrong": 3, "gross": 2}, "not met", "Specification: not met: 3 wrong attitudes (2 inconsistent and"),
        ((0.5,), {"wrong": 2}, "not met", "Specification: not met: 2 wrong attitudes"),
        ((0.5,), {"untested": ("no such rate",)}, "undecided", "Specification: undecided: no such rate"),
    ],
)
def test_a_judgement_in_one_line(verdicts, given, state, text):
    made = tuple(Verdict(ROLL, Estimate(value, value, value, 2000)) for value in verdicts)
    judgement = Judgement(made, **{"basis": "measured", "unit": "trials"} | given)
    assert judgement.state == state
    assert judgement.text.startswith(text)
    assert (", " in judgement.kinds) is False
    both = replace(judgement, misidentified=1, gross=2)
    assert both.kinds == " (1 misidentified, 2 inconsistent and beyond the specification)"
    assert judgement.to_dict()["untested"] == list(given.get("untested", ()))
    assert judgement.by_name({"roll": 7.0})["roll"]["three_sigma_deg"] == 7.0


# ---------------------------------------------------------------------- evidence
def frames(statuses, **columns):
    n = len(statuses)
    known = {f"error_{axis}_deg": np.linspace(0.1, 1.0, n) for axis in AXES}
    flags = {name: np.zeros(n, bool) for name in ("wrong", "misidentified", "inconsistent")}
    rates = {"rate_deg_s": np.full(n, 1.0)}
    return {"status": np.array(statuses, dtype=object), **known, **flags, **rates, **columns}


def measured(columns, setting=None, **conditions):
    return Measured(columns, Specification((ROLL,), **conditions), setting or Setting())


def test_frames_that_count():
    """At an exclusion angle and at the edges of the band of rates they do."""
    columns = frames(["solved"] * 4, rate_deg_s=np.array([0.9, 1.1, 0.89, 1.11]))
    angles = Setting(angles_deg={"sun": np.array([30.0, 29.9, 30.1, 31.0])})
    assert measured(columns, angles, exclusion_deg=(("sun", 30.0),)).counted.tolist() == [True, False, True, True]
    assert measured(columns, rate_deg_s=1.0).counted.tolist() == [True, True, False, False]
    both = measured(columns, angles, exclusion_deg=(("sun", 30.0),), rate_deg_s=1.0)
    assert both.counted.tolist() == [True, False, False, False]
    assert both.untested == ()
    far = measured(columns, rate_deg_s=5.0)
    said = "no frame turns at the 5°/s of specification.rate_deg_s (within 10 %), but at 0.89"
    assert far.untested[0].startswith(said)
    assert far.estimate(ROLL) == Estimate(None, None, None, 0, "no frame in the specified conditions")
    none = measured(columns, angles, exclusion_deg=(("sun", 90.0),))
    assert none.untested == ("every frame is excluded by specification.sun_exclusion_deg 90",)
    assert measured(columns, angles, exclusion_deg=(("sun", 90.0),), rate_deg_s=1.0).untested == none.untested
    empty = measured(frames([]), rate_deg_s=1.0)
    assert (empty.untested, empty.estimate(ROLL).unknown) == ((), "no frame")
    axes = {f"true_rate_{axis}_deg_s": np.array([value]) for axis, value in zip("xyz", (2.0, 3.0, 6.0), strict=True)}
    sequence = frames(["solved"]) | axes
    del sequence["rate_deg_s"]
    assert measured(sequence, rate_deg_s=7.0).counted.tolist() == [True]
    assert measured(sequence, rate_deg_s=11.0).counted.tolist() == [False]


def test_shares_of_the_frames():
    """Ten frames: eight solved, of which two are misidentified, one of them gross as well, and one only gross; those
    outside the conditions are not counted."""
    status = ["solved"] * 8 + ["no_match"] * 2
    number = np.arange(10)
    flags = {"wrong": number < 3, "misidentified": number < 2, "inconsistent": np.isin(number, [1, 2, 5])}
    found = measured(frames(status, **flags))
    assert (found.wrong, found.misidentified, found.gross, found.unit) == (3, 2, 1, "trials")
    assert found.estimate(AVAILABILITY) == Estimate(0.5, *wilson_interval(5, 10), 10)
    assert found.estimate(WRONG) == Estimate(0.3, *wilson_interval(3, 10), 10)
    assert found.estimate(INCONSISTENT) == Estimate(0.3, *wilson_interval(3, 10), 10)
    angles = Setting(angles_deg={"sun": np.where(np.arange(10) < 2, 0.0, 90.0)})
    part = measured(frames(status, **flags), angles, exclusion_deg=(("sun", 30.0),))
    assert (part.wrong, part.misidentified, part.gross) == (1, 0, 1)
    assert part.estimate(AVAILABILITY).value == 5.0 / 8.0
    assert measured(frames(["no_match"] * 3)).estimate(ROLL) == Estimate(None, None, None, 0)


def test_percentiles_and_acquisition():
    columns = frames(["solved"] * 40 + ["no_match"] * 10)
    errors = np.sort(np.abs(columns["error_roll_deg"][:40]))
    found = measured(columns).estimate(replace(ROLL, percent=50.0))
    assert found == Estimate(errors[19], *percentile_interval(errors, 50.0), 40)
    prior = measured(columns).estimate(ACQUISITION)
    assert prior.unknown.startswith("not measured: the tracker has a prior")
    lost = Setting(exposure_s=0.5, lost_in_space=True)
    alone = measured(columns, lost).estimate(ACQUISITION)
    assert (alone.value, alone.high, alone.frames) == (0.5, 0.5, 50)
    few = measured(frames(["solved"] * 4 + ["no_match"] * 6), lost).estimate(ACQUISITION)
    assert few.value == math.inf
    sequence = replace(lost, step_s=2.0)
    late = frames(["no_match", "solved", "solved"], wrong=np.array([False, True, False]))
    assert measured(late, sequence).estimate(ACQUISITION).value == 2 * 2.0 + 0.5
    assert measured(late, sequence).unit == "independent frames"
    assert measured(frames(["no_match"] * 3), sequence).estimate(ACQUISITION).value == math.inf
    assert measured(frames(["no_match"] * 3), sequence).estimate(AVAILABILITY).frames == 3


def test_frames_of_a_sequence_count_by_the_most_correlated_axis():
    rng = np.random.default_rng(1)
    slow = np.repeat(rng.normal(size=30), 10)
    columns = frames(["solved"] * 300, error_cross_x_deg=rng.normal(size=300), error_cross_y_deg=slow)
    columns["error_about_boresight_deg"] = rng.normal(size=300)
    found = measured(columns, Setting(step_s=1.0)).estimate(AVAILABILITY)
    number = effective_number(slow)
    assert number < 60.0
    assert found.frames == round(number, 1)
    assert (found.low, found.high) == pytest.approx(wilson_interval(number, number))


@pytest.mark.parametrize("share", [0, 3])
def test_what_a_prediction_says(share):
    turned = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # body x, y, z are camera z, x, y
    covariance = np.tile(np.diag([1.0, 4.0, 100.0]) * 1e-12, (share, 1, 1))
    found = Predicted(covariance, turned, 4, Specification((ROLL,)), 0.1)
    assert found.estimate(AVAILABILITY) == Estimate(share / 4, share / 4, share / 4, 4)
    assert found.estimate(WRONG) == Estimate(None, None, None, 0, "not predicted")
    if not share:
        assert found.estimate(ROLL) == Estimate(None, None, None, 0)
        return
    for axis, sigma in (("cross_x", 1.0), ("cross_y", 2.0), ("roll", 10.0), ("pitch", 1.0), ("yaw", 2.0)):
        assert found.rms_deg(axis) == pytest.approx(math.degrees(sigma * 1e-6))
        q = found.estimate(Requirement(axis, 1.0, 95.0, axis))
        assert q.value == q.low == q.high == pytest.approx(math.degrees(1e-6 * sigma * stats.norm.ppf(0.975)))
        assert q.frames == 3
    assert found.rms_deg("across") == pytest.approx(math.degrees(math.sqrt(5.0) * 1e-6))
    drawn = np.random.default_rng(2).normal(size=(200_000, 2)) * [1.0, 2.0]
    expected = np.percentile(np.hypot(*drawn.T), 95.0)  # ± 0.3 %
    assert found.percentile_deg("across", 95.0) == pytest.approx(math.degrees(1e-6 * expected), rel=0.012)
    none = replace(found, attitudes=0)
    assert none.untested == ("every attitude is excluded",)
    assert none.estimate(ROLL).unknown == none.estimate(AVAILABILITY).unknown == "every attitude is excluded"


# ---------------------------------------------------------------------- outliers of a budget
def outlier(**changes):
    known = Outlier(7, "cross_x", 0.01, 12.4, False, ("all effects on",), ("a",), 6)
    return replace(known, **changes)


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({}, "caused by 'a'"),
        ({"gone": ("a", "b", "c")}, "caused by 'a' together with 'b' together with 'c'"),
        ({"gone": ("a", "b", "c", "d")}, "gone whichever of 4 effects is off: at a threshold of the tracker"),
        ({"of": 2}, "caused by the scene, independent of the effects"),
        ({"of": 3}, "caused by 'a'"),
        ({"runs": ("x", "y", "z")}, "only without 'x', 'y', 'z'"),
        ({"runs": ("x", "y", "z", "w")}, "only without 'x', 'y', 'z' and others"),
    ],
)
def test_cause_of_an_outlier(changes, cause):
    assert outlier(**changes).cause == cause


def test_outliers_in_words():
    assert str(outlier()) == "trial 7: off by 36.000″ cross x, 12 sigma, in 1 of 6 runs; caused by 'a'"
    assert str(outlier(wrong=True, axis="about_boresight")).startswith("trial 7: wrong by 36.000″ about boresight, 12")
    assert lines_of(()) == []
    assert lines_of((outlier(),))[0].startswith("Excluded from the values above: 1 trial with")
    assert len(lines_of((outlier(),) * 10)) == 11
    many = lines_of((outlier(),) * 12)
    assert (len(many), many[0][:46], many[-1]) == (
        12, "Excluded from the values above: 12 trials with", "  and 2 more, in budget.json"
    )  # fmt: skip


def test_what_is_an_outlier():
    """±1″ in 20 trials or more: 1.4826″ are a standard deviation, and more than eight of them are far; a wrong trial of
    the first run is one whatever its error, one that is not solved is none."""
    errors = np.where(np.arange(60).reshape(20, 3) % 2, 1.0, -1.0) / 3600.0
    yes = np.ones(20, bool)
    for size, found in ((8.0 * 1.4826 * 0.999, 0), (8.0 * 1.4826 * 1.001, 1)):
        one = errors.copy()
        one[4, 1] = -size / 3600.0
        assert len(find_outliers(["on"], [one], [yes], [yes])) == found
        assert len(find_outliers(["on"], [one[:19]], [yes[:19]], [yes[:19]])) == 0
    (far,) = find_outliers(["on"], [one], [yes], [yes])
    assert (far.axis, far.of, far.runs, far.gone) == ("cross_y", 1, ("on",), ())
    assert (far.error_deg, far.sigmas) == (pytest.approx(-size / 3600.0), pytest.approx(8.0 * 1.001))
    unsolved = yes & (np.arange(20) != 4)
    assert find_outliers(["on"], [one], [unsolved], [unsolved]) == ()
    (wrong,) = find_outliers(["on", "off"], [errors] * 2, [unsolved, yes], [yes, yes], None, ["off"])
    assert (wrong.index, wrong.wrong, wrong.runs, wrong.gone) == (4, True, ("on",), ("off",))
    assert find_outliers(["on", "off"], [errors] * 2, [yes, unsolved], [yes, yes], None, ["off"]) == ()
    still = np.zeros((20, 3))
    assert find_outliers(["on"], [still], [yes], [yes]) == ()
    known = np.full((20, 3), np.nan)
    known[0] = 1.0
    assert len(find_outliers(["on"], [one], [yes], [yes], known)) == 1
    known[:, 2] = np.nan  # no bound about an axis: none is used
    known[4] = 1e9
    assert len(find_outliers(["on"], [one], [yes], [yes], known)) == 1


def test_a_contribution_and_its_numbers():
    """10″ with and 8″ without: 6″, and −6″ the other way round; nothing solved in both has no number."""

    def run(size, solved=True):
        yes = np.full(6, solved)
        return _Run(np.full((6, 3), size / 3600.0), yes, yes, np.full((6, 3), np.nan))

    made = _contribution("shot", "temporal", run(10.0), run(8.0), 1)
    assert made.added_rms_deg("cross_x") * 3600.0 == pytest.approx(6.0)
    assert made.rms_off_deg["cross_y"] * 3600.0 == pytest.approx(8.0)
    assert (made.trials, made.solved) == (6, 6)
    less = _contribution("shot", "temporal", run(8.0), run(10.0), 1)
    assert less.added_rms_deg("cross_x") * 3600.0 == pytest.approx(-6.0)
    none = _contribution("shot", "temporal", run(8.0), run(10.0, solved=False), 1)
    assert (none.trials, none.solved) == (0, 0)
    assert math.isnan(none.added_deg2["cross_x"])
    assert math.isnan(none.rms_off_deg["cross_x"])
    by_axis = dict.fromkeys(("cross_x", "cross_y", "about_boresight"), 1e-3)
    interval = {axis: [1e-6 / 3600.0**2 * -4.0, None] for axis in by_axis}
    row = Contribution("noise", "temporal", by_axis, dict.fromkeys(by_axis, 9.0 / 3600.0**2), interval, 5, 6)
    whole = replace(row, name="sure", interval_deg2={axis: [4.0 / 3600.0**2, 16.0 / 3600.0**2] for axis in by_axis})
    budget = Budget("test", 1, 10, 9, by_axis, by_axis, (row, whole), (), None)
    text = budget.table()
    assert f"  {'noise':32}{'3.000':>26}" in text
    assert "3.000 (2.000 to 4.000)" in text
    assert "all effects off" not in text
    assert "Interrupted" not in text
    data = budget.to_dict()
    assert data["remainder"] is None
    entry = data["effects"][1]["axes"]["cross_y"]
    assert entry["added_rms_interval95_deg"] == pytest.approx([2.0 / 3600.0, 4.0 / 3600.0])
    assert data["effects"][0]["axes"]["cross_y"]["added_rms_interval95_deg"][1] is None
    assert (data["effects"][0]["trials"], data["effects"][0]["solved"]) == (5, 6)
    rest = replace(budget, remainder=row, rms_with_outliers_deg=by_axis, interrupted=True)
    assert rest.to_dict()["remainder"]["name"] == "noise"
    for words in (f"{'all effects off':34}{'3.600':>26}", "outliers included", "Interrupted"):
        assert words in rest.table()


# ---------------------------------------------------------------------- intervals and statistics
def test_intervals_of_few_and_of_equal_values():
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert (wilson_interval(0, 5)[0], wilson_interval(5, 5)[1]) == (0.0, 1.0)
    assert set(moment_intervals(np.ones((4, 2)))) == {"mean", "std", "rms"}
    assert all(value is None for value in moment_intervals(np.ones((4, 2))).values())
    equal = moment_intervals(np.full((5, 1), 3.0))
    np.testing.assert_allclose(equal["mean"], [[3.0, 3.0]])
    np.testing.assert_allclose(equal["std"], [[0.0, 0.0]], atol=1e-7)
    assert not moment_intervals(np.zeros((5, 1)))["rms"].any()
    assert all(math.isnan(v) for v in spread_interval([]))
    assert spread_interval([0.0, 0.0]) == (0.0, 0.0)
    assert plain(None) == [None, None]
    assert plain([1, np.nan, None, np.inf]) == [1.0, None, None, None]
    assert percentile_interval(np.empty(0), 50.0) == (None, None)
    assert mean_chi_square_bounds(0, 3) is None
    assert mean_chi_square_bounds(4, 3) == pytest.approx(stats.chi2.ppf([0.025, 0.975], 12) / 4)
    ratio, interval = ratios_of_rms(np.full((4, 1), 2.0), np.ones((4, 1)))
    assert (ratio.tolist(), interval) == ([2.0], None)
    assert ratios_of_rms(np.full((5, 1), 2.0), np.ones((5, 1)))[1] == pytest.approx(np.full((1, 2), 2.0))


def test_intervals_above_the_number_that_is_resampled():
    """5,001 values: the normal interval of the mean, and the delta method of a ratio."""
    x = np.random.default_rng(3).normal(1.0, 2.0, (5001, 1))
    found = moment_intervals(x)
    half = 1.959964 * x.std(ddof=1) / math.sqrt(5001)
    np.testing.assert_allclose(found["mean"], [[x.mean() - half, x.mean() + half]], rtol=1e-6)
    # of a normal distribution 1.96 σ/√(2 n)
    np.testing.assert_allclose(np.diff(found["std"])[0], 2.0 * 1.96 * 2.0 / math.sqrt(2 * 5001), rtol=0.06)
    np.testing.assert_allclose(found["std"].mean(), x.std(), rtol=1e-3)
    assert found["rms"].mean() == pytest.approx(math.sqrt(np.mean(x**2)), rel=1e-3)
    bounds = np.abs(np.random.default_rng(4).normal(size=(5001, 1))) + 1.0
    ratio, interval = ratios_of_rms(x, bounds)
    e2, b2 = x**2 / np.sum(x**2), bounds**2 / np.sum(bounds**2)
    half = 1.959964 * 0.5 * math.sqrt(np.sum((e2 - b2) ** 2))
    np.testing.assert_allclose(interval, ratio * np.exp([[-half, half]]), rtol=1e-6)


def test_spread_of_heavy_tails():
    """ν = 2 n m₂²/(m₄ − m₂²) degrees of freedom, and n for tails that are no heavier than normal ones."""
    heavy = np.array([0.1] * 9 + [5.0])
    m2, m4 = np.mean(heavy**2), np.mean(heavy**4)
    freedom = 2.0 * 10 * m2**2 / (m4 - m2**2)
    expected = np.sqrt(m2 * freedom / stats.chi2.ppf([0.975, 0.025], freedom))
    assert spread_interval(heavy) == pytest.approx(expected)
    even = np.ones(10)
    assert spread_interval(even) == pytest.approx(np.sqrt(10.0 / stats.chi2.ppf([0.975, 0.025], 10)))


def test_statistics_of_one_axis():
    assert set(axis_statistics(np.empty(0)).values()) == {None}
    one = axis_statistics(np.array([-2.0]))
    assert (one["std"], one["mean"], one["rms"], one["max"], one["p50"]) == (None, -2.0, 2.0, 2.0, 2.0)
    assert axis_statistics(np.array([1.0, 3.0]))["std"] == pytest.approx(math.sqrt(2.0))


def trials(n, **columns):
    known = frames(["solved"] * n)
    return (
        known
        | {"index": np.arange(n) + 100, "stars_matched": np.full(n, 9), **columns}
        | ({"stars_misidentified": np.zeros(n, int)} if "stars_misidentified" not in columns else {})
    )


def test_errors_in_bins():
    """A bin has its lower limit, the last one both; what is outside or unknown is in none."""
    value = np.array([0.0, 1.0, 2.0, 3.0, -0.1, 3.1, np.nan, 1.5])
    columns = trials(8, value=value, error_cross_x_deg=np.arange(8.0))
    found = error_against(columns, "value", [0.0, 1.0, 2.0, 3.0])
    assert (found.count.tolist(), found.trials.tolist()) == ([1, 2, 2], [1, 2, 2])
    np.testing.assert_allclose(found.rms_deg, [0.0, math.sqrt((1.0 + 49.0) / 2), math.sqrt((4.0 + 9.0) / 2)])
    np.testing.assert_allclose(found.centre, [0.0, 1.25, 2.5])
    columns["wrong"][1] = columns["misidentified"][1] = True
    columns["status"][7] = "no_match"
    empty = error_against(columns, "value", [0.0, 1.0, 2.0, 3.0])
    assert (empty.count.tolist(), empty.trials.tolist()) == ([1, 0, 2], [1, 2, 2])
    assert (empty.centre[1], math.isnan(empty.rms_deg[1])) == (1.5, True)
    same = error_against(trials(3, value=np.full(3, 7.0)), "value")
    assert (same.edges.tolist(), same.count.tolist()) == ([6.5, 7.5], [3])
    none = error_against(trials(2, value=np.full(2, np.nan)), "value")
    assert (none.edges.tolist(), none.count.tolist()) == ([-0.5, 0.5], [0])
    unsolved = trials(4, value=np.arange(4.0))
    unsolved["status"][:] = "no_match"
    assert error_against(unsolved, "value", 2).edges.tolist() == [0.0, 1.5, 3.0]


def test_errors_beside_their_bounds():
    columns = trials(6, **{f"bound_{axis}_deg": np.full(6, 0.5) for axis in ("cross_x", "cross_y", "about_boresight")})
    columns["bound_cross_x_deg"][1], columns["bound_cross_y_deg"][2] = 0.0, np.nan
    columns["error_cross_x_deg"][3] = np.nan
    found = against_bound(columns)
    used = columns["error_cross_y_deg"][[0, 4, 5]]
    rms = math.sqrt(np.mean(used**2))
    assert found["cross_y"]["trials"] == 3
    assert (found["cross_y"]["rms_deg"], found["cross_y"]["bound_rms_deg"]) == (pytest.approx(rms), 0.5)
    assert (found["cross_y"]["ratio"], found["cross_y"]["interval95"]) == (pytest.approx(rms / 0.5), [None, None])
    columns["status"][:] = "no_match"
    assert against_bound(columns) is None
    del columns["bound_cross_x_deg"]
    assert against_bound(columns) is None


def test_consistency_of_solved_trials():
    columns = trials(5, nees=np.array([3.0, 4.0, np.nan, 900.0, 2.0]))
    columns["status"][3] = "no_match"
    found = consistency(columns)
    low, high = stats.chi2.ppf([0.025, 0.975], 9) / 3
    assert (found["trials"], found["freedom"], found["mean"], found["inside"]) == (3, 3, 3.0, True)
    assert found["bounds95"] == pytest.approx([low, high])
    for nees in (0.99 * low, 1.01 * high):
        assert consistency(trials(3, nees=np.full(3, nees)))["inside"] is False
    del columns["nees"]
    assert consistency(columns) is None
    assert consistency(trials(2, nees=np.full(2, np.nan))) is None


def test_listed_outliers():
    """Of ±1° with a bias of 10°: beyond 5 × 1.4826° of the median."""
    error = np.where(np.arange(9) % 2, 11.0, 9.0)
    error[8] = 10.0
    for size, far in ((7.4, False), (7.42, True)):
        error[2] = 10.0 - size
        columns = trials(9, error_cross_y_deg=error, stars_misidentified=np.array([0, 0, 0, 2, 0, 0, 0, 0, 0]))
        for axis in ("cross_x", "about_boresight"):
            columns[f"error_{axis}_deg"] = np.full(9, 3.0)
        columns["wrong"][8] = columns["inconsistent"][8] = True
        columns["index"] = 100 - np.arange(9)
        listed = {entry["index"]: entry["why"] for entry in outliers(columns)}
        assert listed[97] == "misidentified stars: 2"
        assert listed[92] == "wrong attitude; inconsistent with the stated covariance"
        assert (98 in listed) is far
        assert list(listed) == sorted(listed)
    assert listed[98] == "cross_y error 5.0 robust sigma"
    entry = outliers(columns)[-1]
    assert (entry["errors_deg"]["cross_y"], entry["stars_matched"], entry["nees"]) == (pytest.approx(2.58), 9, None)


def test_noise_of_a_filter_follows_the_motion():
    """Changes of the rate between frames, three times; white acceleration of a jitter's second differences."""
    gyro = SimpleNamespace(use=False)
    section = SimpleNamespace(rate_walk_deg_s_sqrt_s="auto", step_s=4.0, rate_sigma_deg_s=0.5, gyro=gyro)
    states = [SimpleNamespace(rate_camera_rad_s=np.array([0.0, 0.0, rate])) for rate in (0.0, 1e-3, 5e-3)]
    found = process_noise(section, states, [], 0.1)
    assert found == RateNoise(3.0 * 4e-3 / 4.0 * 2.0, math.radians(0.5))
    assert process_noise(section, states[:1], [], 0.1).acceleration == 1e-6
    rng = np.random.default_rng(5)
    angles = 1e-3 * rng.normal(size=(8, 3))
    shaking = [SimpleNamespace(mean=lambda exposure_s, a=a: a * exposure_s / 0.1) for a in angles]
    assert process_noise(section, states[:1], shaking[:7], 0.1).acceleration == 1e-6
    second = np.mean(np.diff(angles, 2, axis=0) ** 2, axis=0).max()
    assert process_noise(section, states[:1], shaking, 0.1).acceleration == pytest.approx(
        math.sqrt(1.5 * second / 64.0)
    )
    section.rate_walk_deg_s_sqrt_s = 0.25
    section.gyro = SimpleNamespace(
        use=True, angle_random_walk_deg_sqrt_h=0.6, bias_deg_h=3.0, bias_instability_deg_h=4.0, bias_time_s=50.0,
        scale_factor_ppm=20.0,
    )  # fmt: skip
    known = process_noise(section, states, shaking, 0.1)
    hour = math.radians(1.0) / 3600.0
    assert isinstance(known, GyroNoise)
    assert known.angle_random_walk == pytest.approx(math.radians(0.01))
    assert known.rate_random_walk == pytest.approx(4.0 * hour * 0.2)
    assert known.bias_sigma_rad_s == pytest.approx(5.0 * hour)
    assert known.acceleration == pytest.approx(math.radians(0.25))
    assert known.scale_sigma == pytest.approx(2e-5)
    section.gyro.bias_deg_h = section.gyro.bias_instability_deg_h = 0.0
    assert process_noise(section, states, shaking, 0.1).bias_sigma_rad_s == 1e-9


# ---------------------------------------------------------------------- effects that depend on the scenario
EFFECT = {effect.name: effect for effect in EFFECTS}
SPIN = {"pointing.spin.rate_deg_s": 2.0, "pointing.rate_deg_s": (0.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("name", "keys", "changes"),
    [
        (
            "faint neighbours",
            {"sky.magnitude_limit": 9.0, "tracker.magnitude_limit": 6.0},
            {"sky.magnitude_limit": 6.0},
        ),
        ("faint neighbours", {"sky.magnitude_limit": 5.0, "tracker.magnitude_limit": 6.0}, None),
        ("catalogue errors", {"sky.catalog": "bsc5", "tracker.catalog": "hipparcos"}, {"sky.catalog": "hipparcos"}),
        ("catalogue errors", {}, None),
        ("gain of the intensifier", {}, None),
        ("cosmic rays", {"detector.cosmic_rays.rate_cm2_s": 2.0}, {"detector.cosmic_rays.rate_cm2_s": 0.0}),
        ("cosmic rays", {"detector.cosmic_rays.rate_cm2_s": 0.0}, None),
        ("radiation damage", {}, None),
        ("smear by rates", SPIN, {"pointing.rate_deg_s": (0.0, 0.0, -2.0)}),
        ("smear by rates", {"pointing.target": [10.0, 20.0, 0.0], "pointing.rate_deg_s": [0, 0, 0]}, None),
        (
            "smear by rates",
            {"pointing.target": [10.0, 20.0, 0.0], "pointing.rate_deg_s": [0.1, 0, 0]},
            {"pointing.rate_deg_s": (0.0, 0.0, 0.0)},
        ),
        ("quantisation", {"detector.adc_bits": 12}, {"detector.adc_bits": None}),
        ("quantisation", {"detector.adc_bits": 12, "tracker.engine": "flight"}, None),
    ],
)
def test_what_switches_an_effect_off(name, keys, changes):
    """None where the scenario does not have it; after the change it has not."""
    scenario = Scenario.load("cubesat_ideal", overrides=["detector.pixel_pitch_um=6"]).changed(keys)
    found = EFFECT[name].off(scenario)
    if changes is None:
        assert found == {}
        return
    assert changes.items() <= found.items()
    assert EFFECT[name].off(scenario.changed(found)) == {}


def test_the_local_level_stands_still_at_the_orbital_rate():
    """360° per period about +Y, against its rotation about −Y."""
    scenario = Scenario.load("cubesat_ideal")
    rate = EFFECT["smear by rates"].off(scenario)["pointing.rate_deg_s"]
    assert rate == (0.0, pytest.approx(360.0 / build_orbit(scenario).period_s), 0.0)


# ---------------------------------------------------------------------- parts of pages
def test_panels_as_wide_as_their_place():
    """A wide one is narrow, and no higher than 3 inches, on a phone."""
    for wide, narrow, height, size in (
        (False, False, 5.0, (4.2, 5.0)), (True, False, 5.0, (7.6, 5.0)), (True, True, 5.0, (4.2, 3.0)),
        (True, True, 2.0, (4.2, 2.0)),
    ):  # fmt: skip
        panel = Panel("title", "note", lambda ax: None, height, wide)
        assert figure_of(panel, narrow).get_size_inches().tolist() == pytest.approx(size)


def test_verdicts_as_a_table():
    made = [Verdict(ROLL, Estimate(0.5, 0.5, 0.5, 9)), Verdict(AVAILABILITY, Estimate(1.0, 0.9, 1.0, 9))]
    table = verdict_table(Judgement(tuple(made), "measured", "trials"))
    assert table.rows[0] == ("roll", "99.7 % below 0.5000°", "–", "1.0000°", "2 ×", "met")
    assert table.rows[1][2:] == ("90.00 % to 100.00 %", "99.00 %", "–", "undecided")
    assert "upper limits need 1228 trials" in table.note
    assert "need 0 trials" in verdict_table(Judgement((), "measured", "trials")).note
    known = {"name": "a", "seed": 3, "version": "1", "finished_utc": "2026-01-02T03:04:05"}
    said = "Scenario a, digest 0123456789ab, seed 3, boresight 1"
    assert provenance(known, "0123456789abcdef") == f"{said}, 2026-01-02 03:04 UTC"
    del known["finished_utc"]
    assert provenance(known, "0123456789abcdef") == said


# ---------------------------------------------------------------------- memory of columns
def test_columns_that_stay_in_memory(monkeypatch):
    """Numbers by their bytes, text by ten pointers each: what was used last stays, alone if need be."""
    text = [f"star {k}" for k in range(50)]
    table = pa.table({"a": text, "b": text, "x": np.arange(50.0), "y": np.arange(50.0), "z": np.arange(50.0)})
    monkeypatch.setattr(columns_module, "CACHE_BYTES", 2 * 8 * 50)
    columns = columns_module.Columns(table)
    for name, kept in (("x", "x"), ("y", "xy"), ("x", "yx"), ("z", "xz"), ("a", "a"), ("b", "b"), ("x", "x")):
        assert len(columns[name]) == 50
        assert "".join(columns._cache) == kept
    monkeypatch.setattr(columns_module, "CACHE_BYTES", 10 * 8 * 50)
    assert (len(columns["a"]), "".join(columns._cache)) == (50, "a")


# ---------------------------------------------------------------------- a picture
@pytest.mark.parametrize(("centroids", "stars"), [(2, 1), (2, 0), (0, 0)])
def test_a_drawn_solution(centroids, stars):
    """All shades from black to white, the first pixel's centre at (0, 0), and a mark for each kind there is."""
    _, ax = new_figure(PICTURE_STYLE, 1, 1, (4.0, 3.0))
    xy = np.array([[10.0, 5.0], [30.0, 12.0]])
    matched = MatchedStars(
        xy[:stars], np.arange(stars), np.array(["Vega"] * stars), np.zeros(stars), np.ones(stars), np.zeros((stars, 2))
    )
    solution = Solution(Status.NO_MATCH, "nothing", None, None, matched, xy[:centroids])
    draw_solution(ax, Shades(np.zeros((10, 20), np.uint8), 40, 20), solution, "title")
    (image,) = ax.images
    assert image.get_clim() == (0, 255)
    assert image.get_extent() == [-0.5, 39.5, 19.5, -0.5]
    assert (ax.get_xlim(), ax.get_ylim(), ax.axison) == ((-0.5, 39.5), (19.5, -0.5), False)
    legend = ax.get_legend()
    words = [] if legend is None else [text.get_text() for text in legend.get_texts()]
    assert words == ["detected (2)"] * (centroids > 0) + ["identified (1)"] * (stars > 0)
    assert legend is None or legend._ncols == len(words)
