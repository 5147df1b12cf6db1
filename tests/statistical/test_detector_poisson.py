"""Poisson numbers of the detector by χ² against scipy.stats.poisson, at low, middle and high rates and at the seams.

A fixed seed makes each p-value one number; a right sampler gives less than 1e-4 once in 10⁴ seeds. The last test is the
control: with the same numbers of draws the normal approximation fails beyond doubt, so that these tests can fail.
"""

import numpy as np
import pytest
from scipy import stats

from simulator.detector.pixels import apply_steps
from simulator.detector.poisson import HIGHEST, LOWEST
from simulator.detector.steps import SHOT_NOISE, TILE, Step
from simulator.randomness import stream

P_LIMIT = 1e-4


def draw_poisson(mean, rng):
    numbers = np.empty(mean.shape)
    apply_steps(mean, [Step(SHOT_NOISE, rng=rng)], numbers)
    return numbers


def chi_square_p(numbers, mean):
    """p-value against Poisson(mean); bins of at least 30 expected events, both tails included."""
    n = numbers.size
    low, high = stats.poisson.ppf([30.0 / n, 1.0 - 30.0 / n], mean).astype(int)
    edges = np.unique(np.linspace(low, high, min(high - low, 200) + 1).astype(int))  # bins (-inf, e0], (e0, e1], …
    cumulative = np.concatenate([[0.0], stats.poisson.cdf(edges, mean), [1.0]])
    observed = np.bincount(np.searchsorted(edges, numbers, side="left"), minlength=edges.size + 1)
    return stats.chisquare(observed, n * np.diff(cumulative)).pvalue


@pytest.mark.parametrize(
    "mean",
    [
        0.01,
        0.1,
        1.0,
        3.06,
        5.999,
        float(LOWEST),
        6.5,
        8.0,
        10.0,
        15.0,
        20.0,
        64.0,
        300.0,
        5000.0,
        13_500.0,
        65_535.0,
        float(HIGHEST),
        1e5,
    ],
)
def test_distribution_at_a_rate(mean):
    numbers = draw_poisson(np.full(1_000_000, mean), stream(7, f"chi-square {mean}"))
    assert chi_square_p(numbers, mean) > P_LIMIT


def test_distribution_where_every_pixel_has_another_mean():
    # P(N ≤ n) + u·P(N = n) with uniform u is uniform for each pixel's own mean: one Kolmogorov–Smirnov test for all.
    rng = stream(8, "means")
    mean = 10.0 ** rng.uniform(-2, 4, 400_000)
    numbers = draw_poisson(mean, stream(8, "draws"))
    below = stats.poisson.cdf(numbers - 1, mean)
    uniform = below + rng.random(mean.size) * stats.poisson.pmf(numbers, mean)
    assert stats.kstest(uniform, "uniform").pvalue > P_LIMIT


@pytest.mark.parametrize("mean", [0.1, 20.0, 20.1, 5000.0])
def test_mean_and_variance(mean):
    # σ of the mean: √(λ/N). Fourth central moment of Poisson: λ + 3λ², so σ of the variance: √((λ + 2λ²)/N). 4σ each.
    n = 1_000_000
    numbers = draw_poisson(np.full(n, mean), stream(9, f"moments {mean}"))
    assert abs(numbers.mean() - mean) < 4 * np.sqrt(mean / n)
    assert abs(numbers.var() - mean) < 4 * np.sqrt((mean + 2 * mean**2) / n)


@pytest.mark.parametrize("mean", [1e9, 1e13, 1e17])
def test_huge_means(mean):
    # Far beyond any full well. The Poisson distribution is normal there to 1/√λ, 1e-5: Kolmogorov–Smirnov sees it not.
    numbers = draw_poisson(np.full(20_000, mean), stream(12, f"huge {mean}"))
    assert np.array_equal(numbers, np.rint(numbers))
    assert stats.kstest((numbers - mean) / np.sqrt(mean), "norm").pvalue > P_LIMIT


def test_neighbours_are_uncorrelated():
    # Correlation of independent numbers: σ = 1/√N; 4σ. Lag 1 would show a uniform number used twice.
    numbers = draw_poisson(np.full(1_000_000, 20.06), stream(10, "neighbours"))
    for lag in (1, 2, TILE // 4, TILE, 16384):
        assert abs(np.corrcoef(numbers[:-lag], numbers[lag:])[0, 1]) < 4 / np.sqrt(numbers.size)


def test_a_normal_approximation_would_be_found_out():
    rng = stream(11, "control")
    assert chi_square_p(np.rint(rng.normal(20.0, np.sqrt(20.0), 1_000_000)), 20.0) < 1e-12
    assert chi_square_p(np.rint(rng.normal(300.0, np.sqrt(300.0), 1_000_000)), 300.0) < 1e-12
