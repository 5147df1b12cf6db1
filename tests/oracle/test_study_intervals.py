"""Intervals against SciPy's own bootstrap, published tables, and simulated coverage.

SciPy's BCa (`scipy.stats.bootstrap`, SciPy 1.17) draws other resamples than ours: the ends of two bootstraps of B
samples differ by the sampling error of a quantile, √(p(1 − p)/B) / density = 2.7 s/√B at p = 0.025 for a nearly normal
distribution of standard deviation s, so 2.7 s √(1/1000 + 1/20000) = 0.087 s between the two; BCa's own bias estimate
adds 2 × 1.25 s/√1000 = 0.08 s. Four times their root sum of squares is 0.47 s.
"""

import json

import numpy as np
import pytest
from scipy import stats

from simulator.study.intervals import (
    LARGE,
    _binomial_quantile,
    _central_chi_square,
    effective_number,
    mean_chi_square_bounds,
    moment_intervals,
    percentile_interval,
    ratios_of_rms,
    spread_interval,
)
from simulator.study.specification.measured import Measured
from simulator.study.specification.requirements import Specification
from simulator.study.specification.verdicts import judge
from simulator.study.statistics import summarise


def summary_of(columns, limits_deg, seed=0):
    specification = Specification.of_limits(limits_deg)
    return summarise(columns, judge(specification, Measured(columns, specification)), seed)


def rms(x, axis=-1):
    return np.sqrt(np.mean(x * x, axis=axis))


@pytest.mark.parametrize(
    ("name", "statistic"),
    [("mean", np.mean), ("rms", rms), ("std", lambda x, axis=-1: np.std(x, ddof=1, axis=axis))],
)
def test_bca_as_scipys(name, statistic):
    values = np.random.default_rng(3).standard_t(5, 120) * 1e-4 + 3e-5  # skewed estimators, small numbers
    theirs = stats.bootstrap(
        (values,), statistic, n_resamples=20_000, method="BCa", rng=np.random.default_rng(0), vectorized=True
    )
    ours = moment_intervals(np.stack([values, -2 * values], axis=1), seed=4)[name]
    limits = np.array([theirs.confidence_interval.low, theirs.confidence_interval.high])
    assert ours[0] == pytest.approx(limits, abs=0.47 * theirs.standard_error)
    # a second column goes along: the same rows are drawn
    other = -2 * ours[0][::-1] if name == "mean" else 2 * ours[0]
    assert ours[1] == pytest.approx(other, rel=1e-6 if name != "mean" else 1e-2)


def test_intervals_are_the_same_for_the_same_seed():
    values = np.random.default_rng(1).normal(0, 1, (50, 2))
    first, again, other = (moment_intervals(values, seed)["rms"] for seed in (7, 7, 8))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_resampling_and_moments_meet():
    """At `LARGE` rows the two ways agree to the scatter of the resampling, 0.09 s at each end (above), 4 times over;
    s = σ/√n for the mean, σ/√(2n) for the rms."""
    values = np.random.default_rng(2).normal(0, 2.0, (LARGE + 1, 1))
    resampled = moment_intervals(values[:LARGE])
    direct = moment_intervals(values)
    for name, s in (("mean", 2 / np.sqrt(LARGE)), ("rms", 2 / np.sqrt(2 * LARGE)), ("std", 2 / np.sqrt(2 * LARGE))):
        # the one row more moves them by its own share at most: 4σ/n
        assert resampled[name][0] == pytest.approx(direct[name][0], abs=0.47 * s + 4 * 2 / LARGE)


def test_percentile_interval_of_the_median_as_published():
    # Conover 1999, Practical Nonparametric Statistics, table A3: n = 20, p = 0.5: x₍₆₎ and x₍₁₅₎ hold 0.9586
    assert percentile_interval(np.arange(1.0, 21.0), 50.0) == (6.0, 15.0)


def test_a_percentile_out_of_reach_has_no_end():
    # 0.997^n ≤ 0.025 from n = 1228 on
    assert percentile_interval(np.arange(1227.0), 99.7)[1] is None
    assert percentile_interval(np.arange(1229.0), 99.7)[1] == 1228.0
    assert percentile_interval(np.empty(0), 50.0) == (None, None)


def test_consistency_bounds_as_published():
    # Bar-Shalom, Li & Kirubarajan 2001, section 5.4.2: 50 runs of 2 degrees of freedom: [1.5, 2.6]
    assert mean_chi_square_bounds(50, 2) == pytest.approx((1.5, 2.6), abs=0.05)
    assert mean_chi_square_bounds(0, 3) is None


def test_spread_of_normal_numbers_is_the_chi_square_interval():
    values = np.random.default_rng(8).normal(0, 1, 30)
    values *= 1 / np.sqrt(np.mean(values**2))
    if np.mean((values**2 - 1) ** 2) > 2:
        pytest.fail("the sample should have short tails, so that ν = n")
    low, high = stats.chi2.ppf([0.025, 0.975], 30)
    assert spread_interval(values) == pytest.approx((np.sqrt(30 / high), np.sqrt(30 / low)))
    assert np.isnan(spread_interval(np.empty(0))).all()


def test_ratio_of_what_is_known():
    """Errors of twice the bound's size. ln of the ratio has the standard deviation ½ √Σ(share of a trial in Σe² less
    that in Σb²)²; the ends of the bootstrap scatter by 0.09 of it each (above), their difference by 0.13."""
    n = 2000
    bounds = np.random.default_rng(5).uniform(0.5, 1.5, (n, 2))
    errors = 2 * bounds * np.random.default_rng(6).normal(0, 1, (n, 2))
    ratio, interval = ratios_of_rms(errors, bounds)
    share = errors**2 / (errors**2).sum(axis=0) - bounds**2 / (bounds**2).sum(axis=0)
    sigma = 0.5 * np.sqrt((share**2).sum(axis=0))
    assert ratio == pytest.approx([2.0, 2.0], rel=4 * sigma.max())
    assert interval[:, 1] / interval[:, 0] == pytest.approx(np.exp(2 * 1.96 * sigma), rel=4 * 0.13 * sigma.max())
    assert ratios_of_rms(errors[:4], bounds[:4])[1] is None


def test_coverage():
    """Of 200 samples of 60 normal numbers 95 % of the intervals hold the truth. The share found scatters by √(0.95 ×
    0.05 / 200) = 0.0154; BCa falls short by terms of 1/n, 0.02 at n = 60 (Efron & Tibshirani 1993, table 14.2)."""
    rng = np.random.default_rng(11)
    held = dict.fromkeys(("mean", "std", "rms", "spread"), 0)
    for k in range(20):
        values = rng.normal(0.0, 3.0, (60, 10))
        for name, truth in (("mean", 0.0), ("std", 3.0), ("rms", 3.0)):
            ends = moment_intervals(values, k)[name]
            held[name] += int(np.sum((ends[:, 0] <= truth) & (truth <= ends[:, 1])))
        spreads = [spread_interval(column) for column in values.T]
        held["spread"] += sum(low <= 3.0 <= high for low, high in spreads)
    for name, count in held.items():
        assert count / 200 == pytest.approx(0.95, abs=4 * 0.0154 + 0.02), name


def test_a_summary_finds_what_was_drawn_and_is_json():
    n = 10_000
    rng = np.random.default_rng(0)
    axes = ("roll", "pitch", "yaw", "cross_x", "cross_y", "about_boresight")
    columns = {
        "index": np.arange(n),
        "status": np.array(["solved"] * n, dtype=object),
        "wrong": np.zeros(n, bool),
        "stars_matched": np.full(n, 9),
        "stars_misidentified": np.zeros(n, int),
        "nees": rng.chisquare(3, n),
        **{f"error_{axis}_deg": rng.normal(0, 1e-4, n) for axis in axes},
        **{f"bound_{axis}_deg": np.full(n, 1e-4) for axis in axes[3:]},
    }
    found = summary_of(columns, {"roll": 1.0, "pitch": 1.0, "yaw": 1.0}, seed=1)
    json.dumps(found, allow_nan=False)
    # Σe²/n over 10,000: relative standard deviation √(2/n) / 2 = 0.007
    assert found["bound_ratio"]["cross_x"]["ratio"] == pytest.approx(1.0, abs=4 * 0.0071)
    assert found["nees"]["mean"] == pytest.approx(3.0, abs=4 * np.sqrt(6 / n))


def test_quantiles_are_those_of_scipy_stats():
    """SciPy 1.17's distributions, whose package is too heavy to load for two functions."""
    for trials in (1, 2, 7, 100, 1227, 1228, 250_000):
        for p in (0.003, 0.5, 0.95, 0.997):
            for q in (1e-6, 0.025, 0.4, 0.975):  # a half is a tie of symmetric ones, which rounding decides
                assert _binomial_quantile(q, trials, p) == max(0, stats.binom.ppf(q, trials, p))
    for freedom in (0.4, 3.0, 1500.0, 3e6):
        np.testing.assert_allclose(_central_chi_square(freedom), stats.chi2.ppf([0.025, 0.975], freedom), rtol=1e-12)


def initial_positive_sequence(values):
    """Geyer's estimate from sums over the lags, term by term."""
    n, centred = len(values), values - values.mean()
    rho = [float(np.sum(centred[: n - k] * centred[k:])) / float(np.sum(centred**2)) for k in range(n)]
    total = 1.0
    for k in range(1, n - 1, 2):
        if rho[k] + rho[k + 1] <= 0.0:
            break
        total += 2.0 * (rho[k] + rho[k + 1])
    return min(max(n / total, 1.0), n)


@pytest.mark.parametrize("n", [4, 5, 6, 7, 30, 31])
def test_effective_number_is_the_sum_over_positive_pairs(n):
    steps = np.repeat([0.0, 1.0], [n // 2, n - n // 2])
    walk = np.cumsum(np.random.default_rng(n).normal(size=n))
    for values in (steps, walk, walk - 1e6, 1e-100 * walk):
        assert effective_number(values) == pytest.approx(initial_positive_sequence(values), rel=1e-6)
    assert n < 30 or effective_number(walk) < 0.8 * n
    assert effective_number(np.arange(1.0, 4.0)) == 3.0  # too few for a pair of lags
    assert effective_number(np.empty(0)) == 0.0


def test_effective_number_of_a_constant_is_all_of_them():
    """Also where its mean is off by rounding; differences of ten times that are a series."""
    for value in (0.0, 1.0, 0.1, 1.0 / 3.0):
        assert effective_number(np.full(100, value)) == 100.0
    walk = np.cumsum(np.random.default_rng(1).normal(size=100))
    assert effective_number(1.0 + 1e-10 * walk) < 50.0
    assert effective_number(1.0 + 1e-15 * walk) == 100.0


def test_independent_ranks_of_a_percentile():
    """An effective number below 1 is one, above that of the values all, and a fraction is rounded down."""
    values = np.arange(1.0, 101.0)
    assert percentile_interval(values, 50.0, 20.9) == percentile_interval(values, 50.0, 20.0) == (26.0, 75.0)
    assert percentile_interval(values, 50.0, 1e9) == percentile_interval(values, 50.0)
    assert percentile_interval(values, 50.0, 0.3) == percentile_interval(values, 50.0, 1.0) == (None, None)
