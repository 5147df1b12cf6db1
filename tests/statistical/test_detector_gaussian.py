"""Normal numbers of the pixels against the exact distribution: 10⁷ of them, middle and tails.

The seed is fixed, so that a p-value is one number; a right sampler gives less than 1e-4 once in 10⁴ seeds. The last
test is the control: an error of a few parts in a thousand would be found out.
"""

import numpy as np
import pytest
from scipy import stats

from simulator.detector.gaussian import TAIL, add_gaussian
from simulator.detector.pixels import apply_steps
from simulator.detector.steps import GAUSSIAN_NOISE, TILE, Step
from simulator.randomness import stream

N = 10_000_000
P_LIMIT = 1e-4


@pytest.fixture(scope="module")
def numbers():
    numbers = np.empty(N)
    apply_steps(np.zeros(N), [Step(GAUSSIAN_NOISE, (1.0,), rng=stream(1, "normal"))], numbers)
    return numbers


def chi_square_p(numbers):
    edges = stats.norm.ppf(np.arange(1, 1000) / 1000)
    observed = np.bincount(np.searchsorted(edges, numbers), minlength=1000)
    return stats.chisquare(observed).pvalue


def test_kolmogorov_smirnov(numbers):
    assert stats.kstest(numbers, "norm").pvalue > P_LIMIT


def test_chi_square_of_a_thousand_bins(numbers):
    assert chi_square_p(numbers) > P_LIMIT


def test_tail(numbers):
    """Beyond 3.66 the tail has its own algorithm: how many (Poisson, 4σ), and how they lie."""
    tail = np.abs(numbers)[np.abs(numbers) > TAIL]
    expected = N * 2 * stats.norm.sf(float(TAIL))
    assert abs(tail.size - expected) < 4 * np.sqrt(expected)
    assert stats.kstest(stats.norm.sf(tail) / stats.norm.sf(float(TAIL)), "uniform").pvalue > P_LIMIT


def test_one_word_of_the_tail_by_itself():
    """The lowest word alone: half a million numbers below Φ⁻¹(2⁻³²) = −6.23, told apart by their further bits."""
    n = 500_000
    tail = np.zeros(n)
    key, words = np.array([3, 4], dtype=np.uint64), np.zeros(n, np.uint32)
    add_gaussian(tail, 1.0, key, 0, words, np.empty(n, np.float32))
    assert tail.max() <= stats.norm.ppf(2.0**-32) * (1 - 1e-7)
    # Single precision, 4e-7, is 2e-5 of the tail's own scale 1/6.2: far below what half a million numbers can tell.
    assert stats.kstest(stats.norm.cdf(tail) * 2.0**32, "uniform").pvalue > P_LIMIT


def test_moments(numbers):
    # σ of the mean √(1/N), of the variance √(2/N), of the third moment √(15/N), of the fourth √(96/N); 4σ each.
    for power, value, spread in [(1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)]:
        assert abs(np.mean(numbers**power) - value) < 4 * np.sqrt(spread / N)


def test_neighbours_are_uncorrelated(numbers):
    for lag in (1, 2, TILE // 4, TILE):
        for power in (1, 2):
            a = numbers**power
            assert abs(np.corrcoef(a[:-lag], a[lag:])[0, 1]) < 4 / np.sqrt(N)


def test_an_error_of_some_thousandths_would_be_found_out(numbers):
    assert chi_square_p(numbers * 1.005) < 1e-6
    assert stats.kstest(numbers + 4e-3, "norm").pvalue < 1e-6
