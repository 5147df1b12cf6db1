"""Statistics of a study against published figures and exact formulas."""

import json

import numpy as np
import pytest
from scipy import stats

from simulator.study.statistics import AXES, axis_statistics, summarise, wilson_interval


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
    summary = summarise(columns, {"roll": 0.1, "pitch": 0.1, "yaw": 0.1})
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
    summary = summarise(columns, {"roll": 0.1, "pitch": 0.1, "yaw": 1e-4})
    assert (summary["wrong"], summary["identification_rate"]) == (1, 0.9)
    assert [summary["specification"][axis]["met"] for axis in ("roll", "pitch", "yaw")] == [True, True, False]
