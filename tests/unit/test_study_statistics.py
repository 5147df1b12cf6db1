"""Statistics of a study against published figures and exact formulas."""

import json

import numpy as np
import pytest
from scipy import stats

from simulator.study.axes import AXES
from simulator.study.specification.measured import Measured
from simulator.study.specification.requirements import Requirement, Specification
from simulator.study.specification.verdicts import Estimate, Verdict, judge
from simulator.study.statistics import (
    axis_statistics,
    consistency,
    error_against,
    outliers,
    percentile_interval,
    summarise,
    wilson_interval,
)


def summary_of(columns, limits_deg, seed=0):
    specification = Specification.of_limits(limits_deg)
    return summarise(columns, judge(specification, Measured(columns, specification)), seed)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # R. G. Newcombe 1998, Statistics in Medicine 17, 857, Table I, method 3; printed to four digits
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_interval_as_published(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_wilson_interval_matches_scipy_everywhere():
    for trials in (1, 7, 500):
        for successes in {0, 1, trials // 2, trials - 1, trials}:
            theirs = stats.binomtest(successes, trials).proportion_ci(method="wilson")
            assert wilson_interval(successes, trials) == pytest.approx((theirs.low, theirs.high), abs=1e-12)


def test_no_trials_say_nothing():
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_axis_statistics_of_known_numbers():
    found = axis_statistics(np.array([-3.0, 4.0]))
    assert found["mean"] == pytest.approx(0.5)
    assert found["std"] == pytest.approx(np.sqrt(24.5))
    assert found["rms"] == pytest.approx(np.sqrt(12.5))
    assert found["three_sigma"] == pytest.approx(3 * np.sqrt(12.5))
    assert found["max"] == 4.0


def test_three_sigma_and_p997_meet_for_a_normal_distribution():
    errors = np.random.default_rng(5).normal(0, 2, 400_000)
    found = axis_statistics(errors)
    # σ of the 99.73rd percentile of |x|: √(p(1−p)/n)/density = 0.0082·σ here, times 4; 99.7 vs 99.73 % is −0.03 σ
    assert found["p997"] == pytest.approx(stats.norm.ppf(0.9985) * 2, abs=4 * 0.0088 * 2)
    assert found["three_sigma"] == pytest.approx(6.0, rel=4 / np.sqrt(2 * 400_000))


def test_nothing_solved_is_null_and_not_met():
    n = 3
    columns = {
        "index": np.arange(n),
        "status": np.array(["no_match"] * n, dtype=object),
        "wrong": np.zeros(n, bool),
        "stars_matched": np.zeros(n, int),
        "stars_misidentified": np.zeros(n, int),
        **{f"error_{axis}_deg": np.full(n, np.nan) for axis in AXES},
    }
    summary = summary_of(columns, {"roll": 0.1, "pitch": 0.1, "yaw": 0.1})
    assert summary["solved"] == 0
    assert summary["unsolved_by_status"] == {"no_match": 3}
    assert summary["errors_deg"]["roll"]["rms"] is None
    assert not any(entry["met"] for entry in summary["specification"].values())
    json.dumps(summary, allow_nan=False)


def test_a_wrong_attitude_is_no_identification():
    n = 10
    columns = {
        "index": np.arange(n),
        "status": np.array(["solved"] * n, dtype=object),
        "wrong": np.arange(n) == 4,
        "stars_matched": np.full(n, 8),
        "stars_misidentified": np.zeros(n, int),
        **{f"error_{axis}_deg": np.linspace(-1e-3, 1e-3, n) for axis in AXES},
    }
    summary = summary_of(columns, {"roll": 0.1, "pitch": 0.1, "yaw": 1e-4})
    assert (summary["wrong"], summary["identification_rate"]) == (1, 0.9)
    verdicts = [summary["specification"][axis]["verdict"] for axis in ("roll", "pitch", "yaw")]
    assert verdicts == ["undecided", "undecided", "not met"]  # ten trials show no 99.7 %
    assert not any(entry["met"] for entry in summary["specification"].values())


@pytest.mark.parametrize(
    ("n", "beyond", "expected"),
    [
        # P(no error beyond | 0.3 % are) = 0.997^n: 2.51 % at 1227, 2.499 % at 1228
        (1227, 0, "undecided"),
        (1228, 0, "met"),
        # P(Bin(2000, 0.003) <= 1) = 1.7 %, P(<= 2) = 6.2 %; P(>= 12) = 2.0 %, P(>= 11) = 4.2 %
        (2000, 1, "met"),
        (2000, 2, "undecided"),
        (2000, 11, "undecided"),
        (2000, 12, "not met"),
        # P(Bin(5, 0.003) >= 1) = 1.5 %
        (5, 0, "undecided"),
        (5, 1, "not met"),
    ],
)
def test_verdict_by_the_binomial_interval_of_the_percentile(n, beyond, expected):
    errors = np.linspace(0.0, 0.9, n)
    errors[n - beyond :] = 1.1
    columns = trials(n, **{f"error_{axis}_deg": errors for axis in ("roll", "pitch", "yaw")})
    found = summary_of(columns, {"roll": 1.0, "pitch": 1.0, "yaw": 1.0})["specification"]["yaw"]
    assert found["verdict"] == expected
    assert found["met"] == (expected == "met")
    assert found["p997_interval95_deg"] == list(percentile_interval(np.sort(errors), 99.7))


def test_verdicts_are_wrong_as_seldom_as_they_promise():
    """Of 2,000 runs of 3,000 trials with exactly 0.3 % of the errors beyond, at most 2.5 % each may be "met" or "not
    met": 50, and 4 sigma of the count, sqrt(2000 × 0.025 × 0.975) = 7, more."""
    beyond = np.random.default_rng(1).binomial(3000, 0.003, 2000)
    ends = [percentile_interval(np.repeat([0.5, 2.0], [3000 - k, k]), 99.7) for k in beyond]
    found = [Verdict(Requirement("roll", 1.0, 99.7, "roll"), Estimate(0.5, low, high, 3000)) for low, high in ends]
    counts = {verdict: sum(v.verdict == verdict for v in found) for verdict in ("met", "not met", "undecided")}
    assert counts["met"] <= 78
    assert counts["not met"] <= 78
    assert counts["undecided"] >= 1850


def trials(n, **changes):
    rng = np.random.default_rng(4)
    columns = {
        "index": np.arange(n) + 100,
        "status": np.array(["solved"] * n, dtype=object),
        "wrong": np.zeros(n, bool),
        "stars_matched": np.full(n, 8),
        "stars_misidentified": np.zeros(n, int),
        "nees": np.full(n, 3.0),
        **{f"error_{axis}_deg": rng.normal(0, 1e-4, n) for axis in AXES},
    }
    return columns | changes


def test_outliers_are_listed_with_their_trial():
    errors = np.random.default_rng(4).normal(0, 1e-4, 300)
    errors[7] = 8e-4  # 8 σ; of 300 normal numbers the largest is below 5 σ in all but 1.7e-4 of cases
    columns = trials(300, error_cross_y_deg=errors)
    columns["wrong"][20] = True
    columns["stars_misidentified"][30] = 2
    found = outliers(columns)
    assert [entry["index"] for entry in found] == [107, 120, 130]
    assert "cross_y error" in found[0]["why"]
    assert found[0]["errors_deg"]["cross_y"] == 8e-4
    assert [entry["why"] for entry in found[1:]] == ["wrong attitude", "misidentified stars: 2"]
    summary = summary_of(columns, {"roll": 0.1, "pitch": 0.1, "yaw": 0.1})
    assert summary["outliers_count"] == 3
    json.dumps(summary, allow_nan=False)


def test_an_outlier_is_counted_from_the_bias_of_the_camera():
    """All errors lie about a bias of 20 σ: the one 8 σ from the others is the outlier, and not those near zero or far
    from it on the same side."""
    errors = 2e-3 + np.random.default_rng(4).normal(0, 1e-4, 300)
    errors[7] = 2e-3 - 8e-4
    found = outliers(trials(300, error_cross_y_deg=errors))
    assert [entry["index"] for entry in found] == [107]


def test_errors_sorted_into_bins():
    n = 400
    stars = np.repeat([4.0, 6.0, 9.0, np.nan], n // 4)
    errors = np.where(stars == 4.0, 3e-4, 1e-4) * np.where(np.arange(n) % 2, 1, -1)
    columns = trials(n, stars=stars, error_roll_deg=errors)
    columns["status"][:50] = "no_match"
    binned = error_against(columns, "stars", [0.0, 5.0, 7.0, 9.0], axis="roll")
    assert binned.rms_deg == pytest.approx([3e-4, 1e-4, 1e-4])
    assert binned.centre == pytest.approx([4.0, 6.0, 9.0])
    assert list(binned.count) == [50, 100, 100]
    assert list(binned.trials) == [100, 100, 100]
    assert (binned.low_deg < binned.rms_deg).all()
    assert (binned.high_deg > binned.rms_deg).all()
    # equal shares, values that repeat, a single value, and nothing solved
    assert len(error_against(columns, "error_cross_x_deg", 8).count) == 8
    assert len(error_against(columns, "stars_matched").count) == 1
    nothing = error_against(trials(5, status=np.array(["no_match"] * 5, dtype=object)), "stars_matched")
    assert np.isnan(nothing.rms_deg).all()
    assert list(nothing.trials) == [5]


def test_consistency_needs_solved_trials_and_tells_the_side():
    assert consistency(trials(200))["inside"]
    assert not consistency(trials(200, nees=np.full(200, 2.4)))["inside"]
    assert consistency(trials(3, status=np.array(["no_match"] * 3, dtype=object))) is None


def test_intervals_stand_beside_their_statistics():
    found = summary_of(trials(300), {"roll": 0.1, "pitch": 0.1, "yaw": 0.1}, seed=3)["errors_deg"]["cross_x"]
    for name in ("mean", "std", "rms", "three_sigma", "p50", "p95"):
        low, high = found[f"{name}_interval95"]
        assert low < found[name] < high
    assert found["p997_interval95"][1] is None  # 300 trials do not reach that far
    assert found["three_sigma_interval95"][0] == 3 * found["rms_interval95"][0]
