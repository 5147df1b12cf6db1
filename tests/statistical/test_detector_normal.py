"""Normal numbers of the ziggurat against the exact distribution: 10⁷ of them, middle and tails.

The seed is fixed, so that a p-value is one number; a right sampler gives less than 1e-4 once in 10⁴ seeds. The last
test is the control: an error of a few parts in a thousand would be found out.
"""

import numpy as np
import pytest
from scipy import stats

from simulator.detector.normal import TAIL_START, draw_normal, slow_path, ziggurat
from simulator.detector.philox import draw_key
from simulator.randomness import stream

N = 10_000_000
P_LIMIT = 1e-4


@pytest.fixture(scope="module")
def numbers():
    return draw_normal((N,), stream(1, "normal"))


def chi_square_p(numbers):
    edges = stats.norm.ppf(np.arange(1, 1000) / 1000)
    observed = np.bincount(np.searchsorted(edges, numbers), minlength=1000)
    return stats.chisquare(observed).pvalue


def test_kolmogorov_smirnov(numbers):
    assert stats.kstest(numbers, "norm").pvalue > P_LIMIT


def test_chi_square_of_a_thousand_bins(numbers):
    assert chi_square_p(numbers) > P_LIMIT


def test_layers_by_themselves(numbers):
    """χ² with bins at the layers' own edges, where an error of the wedges would show."""
    edges = np.unique(np.concatenate([-ziggurat()[0][1:], ziggurat()[0][1:]]))
    expected = N * np.diff(np.concatenate([[0.0], stats.norm.cdf(edges), [1.0]]))
    observed = np.bincount(np.searchsorted(edges, numbers), minlength=edges.size + 1)
    assert stats.chisquare(observed, expected).pvalue > P_LIMIT


def test_tail(numbers):
    """Beyond 3.65 the tail has its own algorithm: how many (Poisson, 4σ), and how they lie."""
    tail = np.abs(numbers)[np.abs(numbers) > TAIL_START]
    expected = N * 2 * stats.norm.sf(TAIL_START)
    assert abs(tail.size - expected) < 4 * np.sqrt(expected)
    assert stats.kstest(stats.norm.sf(tail) / stats.norm.sf(TAIL_START), "uniform").pvalue > P_LIMIT


def test_tail_by_itself():
    """Half a million numbers of the tail alone, each from the word that leads there (lowest layer, largest place)."""
    key, tables = draw_key(stream(2, "tail")), ziggurat()
    up, down = np.uint64((2**53 - 1) << 11), np.uint64(((2**53 - 1) << 11) | 0x100)
    tail = np.array([slow_path(up, np.uint64(k), key, *tables) for k in range(500_000)])
    assert tail.min() >= TAIL_START
    assert stats.kstest(stats.norm.sf(tail) / stats.norm.sf(TAIL_START), "uniform").pvalue > P_LIMIT
    assert slow_path(down, np.uint64(7), key, *tables) == -tail[7]


def test_wedges_by_themselves():
    """Places in a layer that stick out over the curve: as often kept as the curve's height there, f(x), asks for."""
    key, (width, sure, height) = draw_key(stream(3, "wedge")), ziggurat()
    rng = stream(3, "places")
    kept, asked = [], []
    for k in range(300_000):
        layer = rng.integers(1, 256)
        place = int((sure[layer] + rng.random() * (1.0 - sure[layer])) * 2**53)
        x = place * 2.0**-53 * width[layer]
        word = np.uint64(place << 11 | int(layer))
        kept.append(slow_path(word, np.uint64(k), key, width, sure, height) == x)
        asked.append((np.exp(-0.5 * x * x) - height[layer]) / (height[layer + 1] - height[layer]))
    kept, asked = np.array(kept), np.array(asked)
    # Bernoulli draws of their own probabilities: σ² = Σ p (1 − p); 4σ, which is 0.3 % of the rate.
    assert abs(kept.sum() - asked.sum()) < 4 * np.sqrt(np.sum(asked * (1 - asked)))
    assert 0.4 < kept.mean() < 0.6


def test_moments(numbers):
    # σ of the mean √(1/N), of the variance √(2/N), of the third moment √(15/N), of the fourth √(96/N); 4σ each.
    for power, value, spread in [(1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)]:
        assert abs(np.mean(numbers**power) - value) < 4 * np.sqrt(spread / N)


def test_neighbours_are_uncorrelated(numbers):
    for lag in (1, 2, 4096, 8192):
        for power in (1, 2):
            a = numbers**power
            assert abs(np.corrcoef(a[:-lag], a[lag:])[0, 1]) < 4 / np.sqrt(N)


def test_an_error_of_some_thousandths_would_be_found_out(numbers):
    assert chi_square_p(numbers * 1.005) < 1e-6
    assert stats.kstest(numbers + 4e-3, "norm").pvalue < 1e-6
