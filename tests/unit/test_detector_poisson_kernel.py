"""Poisson numbers are quantiles of their pixels' uniform numbers: every way to them against SciPy's distribution."""

from decimal import Context, Decimal, localcontext
from itertools import accumulate

import numpy as np
import pytest
from scipy import stats

from simulator.detector.gaussian import gaussian_from_bits
from simulator.detector.philox import fill_bits, further_bits
from simulator.detector.pixels import apply_steps
from simulator.detector.poisson import (
    HIGHEST,
    LARGEST_MEAN,
    LOWEST,
    compare,
    cumulative,
    exceeding,
    expand,
    probability,
    quantile,
    shot_noise,
)
from simulator.detector.steps import SHOT_NOISE, TILE, Step
from simulator.randomness import draw_key, stream
from startracker.errors import InputError

RATES = [6.0, 6.3, 7.9, 10.0, 15.2, 20.0, 33.3, 64.0, 300.0, 2000.0, 9e3, 65_000.0]


def draw_poisson(mean, rng):
    out = np.empty(np.shape(mean))
    apply_steps(np.ascontiguousarray(mean), [Step(SHOT_NOISE, rng=rng)], out)
    return out


def quantile_twin(word, fraction, mean):
    """Least n with P(≤ n) > (word + fraction)/2³², from whichever side is the smaller."""
    word, fraction, mean = np.broadcast_arrays(np.asarray(word, dtype=np.float64), fraction, mean)
    lower, upper = (word + fraction) / 2**32, (2.0**32 - 1 - word + (1.0 - fraction)) / 2**32
    n = stats.poisson.ppf(np.where(word < 2**31, lower, 1.0 - upper), mean)
    w = stats.norm.isf(np.minimum(upper, 0.5))
    far = mean + np.sqrt(mean) * w + w * w / 6  # where 1 − upper is 1 to a double
    n = np.where(np.isfinite(n), n, np.floor(far)).clip(0)

    def enough(k):
        return np.where(word < 2**31, stats.poisson.cdf(k, mean) > lower, stats.poisson.sf(k, mean) < upper)

    for _ in range(200):
        short, long = ~enough(n), (n > 0) & enough(n - 1)
        n = n + short - (long & ~short)
        if not (short | long).any():
            return n
    raise AssertionError("the twin found no quantile")


def test_further_bits_are_those_of_the_pixel():
    """The first word and the last leave all to further bits, which belong to the pixels."""
    rng, size = stream(4, "pixels"), 500
    key, first = draw_key(stream(4, "key")), 9
    words = rng.choice(np.array([0, 2**32 - 1], dtype=np.uint32), size)
    signal, rooms = np.full(size, 5000.0), (np.empty(size, dtype=np.float32) for _ in range(2))
    assert shot_noise(signal, key, first, words, *rooms)
    fraction = np.array([further_bits(key, first + i) for i in range(size)])
    assert np.array_equal(signal, quantile_twin(words, fraction, 5000.0))
    assert len(np.unique(signal)) > 50


def words_at_the_steps(mean, count, rng):
    """Words at and around those at which the quantile steps to the next number: the hardest ones."""
    low, high = (np.asarray(stats.poisson.ppf(u, mean)).astype(int) for u in (2e-5, 1 - 2e-5))
    steps = stats.poisson.cdf(rng.integers(low, high + 1, count), mean) * 2**32
    away = rng.choice([-1, 1], count) * 10.0 ** rng.uniform(0, 7, count) * rng.integers(0, 2, count)
    return np.clip(np.floor(steps + away), 0, 2**32 - 1).astype(np.uint32)


@pytest.mark.parametrize("mean", RATES)
def test_what_the_expansion_settles_is_right(mean):
    rng = stream(1, f"expansion {mean}")
    words = np.concatenate([words_at_the_steps(mean, 20_000, rng), rng.integers(0, 2**32, 40_000, dtype=np.uint32)])
    number, rate = np.empty(words.size, dtype=np.float32), np.full(words.size, mean, dtype=np.float32)
    gaussian_from_bits(words, number)
    expand(rate, number)
    settled = number >= 0
    for fraction in (0.0, 1.0):  # whatever the further bits
        np.testing.assert_array_equal(number[settled], quantile_twin(words[settled], fraction, mean))
    assert settled[20_000:].mean() > 0.998 - 6e-7 * mean


def test_what_the_expansion_settles_is_right_at_any_mean():
    rng = stream(1, "expansion")
    mean = np.float32(10.0 ** rng.uniform(np.log10(6.0), np.log10(65_000.0), 100_000)).clip(LOWEST)
    words = words_at_the_steps(mean.astype(np.float64), mean.size, rng)
    number = np.empty(words.size, dtype=np.float32)
    gaussian_from_bits(words, number)
    expand(mean, number)
    settled = number >= 0
    expected = quantile_twin(words[settled], 0.5, mean[settled].astype(np.float64))
    np.testing.assert_array_equal(number[settled], expected)
    assert settled.sum() > 20_000


@pytest.mark.parametrize("mean", [1e-9, 1e-3, 0.1, 0.9, 2.0, 3.7, 5.0, 5.999])
def test_what_the_comparison_settles_is_right(mean):
    rng = stream(2, f"comparison {mean}")
    words = np.concatenate([words_at_the_steps(mean, 20_000, rng), rng.integers(0, 2**32, 40_000, dtype=np.uint32)])
    number = np.full(words.size, np.nan, dtype=np.float32)
    compare(words, np.full(words.size, mean, dtype=np.float32), number)
    settled = number >= 0
    for fraction in (0.0, 1.0):
        np.testing.assert_array_equal(number[settled], quantile_twin(words[settled], fraction, mean))
    assert settled[20_000:].mean() > 0.999
    compare(words, np.full(words.size, LOWEST), number)
    assert np.array_equal(number >= 0, settled)  # others are left alone


@pytest.mark.parametrize("mean", [1e-300, 1e-3, 0.7, 5.0, 20.0, 150.0, 4095.0, 4097.0, 1e5, 3e6])
def test_the_search_is_exact(mean):
    rng = stream(3, f"search {mean}")
    words = np.concatenate(
        [words_at_the_steps(mean, 300, rng), rng.integers(0, 2**32, 300), [0, 1, 2**31 - 1, 2**31, 2**32 - 1]]
    ).astype(np.uint32)
    fraction = rng.random(words.size)
    found = np.array([quantile(w, f, mean) for w, f in zip(words, fraction, strict=True)])
    np.testing.assert_array_equal(found, quantile_twin(words, fraction, mean))


def test_the_search_in_the_far_tails():
    for mean in (0.01, 3.0, 20.0, 5e3, 1e6):
        for word, fraction in ((0, 2.0**-54), (0, 1e-9), (2**32 - 1, 1.0 - 2.0**-53), (2**32 - 1, 1.0 - 1e-9)):
            assert quantile(np.uint32(word), fraction, mean) == quantile_twin(word, fraction, mean)


def test_probabilities_against_fifty_digits():
    for mean in (1e-3, 0.5, 7.0, 150.0, 1e4):
        numbers = np.unique(np.rint(mean + np.sqrt(mean) * np.linspace(-6, 8, 9)).clip(0))
        last = int(numbers[-1] + 10 * np.sqrt(mean) + 30)
        with localcontext(Context(prec=50)):
            terms = [(-Decimal(mean)).exp()]
            for n in range(1, last):
                terms.append(terms[-1] * Decimal(mean) / n)
            sums = list(accumulate(terms))
            above = list(accumulate(reversed(terms)))[::-1]
        for n in map(int, numbers):
            # Some ten roundings, and one of each term of the sums.
            assert probability(float(n), mean) == pytest.approx(float(terms[n]), rel=1e-14)
            assert cumulative(float(n), mean) == pytest.approx(float(sums[n]), rel=1e-13)
            assert exceeding(float(n), mean) == pytest.approx(float(above[n + 1]), rel=1e-13)


def test_an_image_is_the_quantiles_of_its_words():
    rng = stream(4, "image")
    means = 10.0 ** rng.uniform(-3, 5.5, (90, 1111))
    means[3:9] = rng.uniform(5.5, 6.5, (6, 1111))
    means[20:22, 50:900] = 0.0
    means[30:32] = rng.uniform(0.0, 5.0, (2, 1111))
    means[40, ::97] = HIGHEST
    numbers = draw_poisson(means, stream(4, "draws")).ravel()
    key, quarter = draw_key(stream(4, "draws")), TILE // 4
    k = np.arange(means.size)
    blocks = np.empty((4, (means.size // TILE + 1) * quarter), dtype=np.uint32)
    fill_bits(key, np.uint64(0), np.uint64(0), blocks.reshape(-1))
    words = blocks[k % TILE // quarter, k // TILE * quarter + k % quarter]
    fraction = np.array([further_bits(key, pixel) for pixel in k])
    expected = np.zeros(means.size)
    some = means.ravel() > 0
    expected[some] = quantile_twin(words[some], fraction[some], means.ravel()[some])
    np.testing.assert_array_equal(numbers, expected)


def test_zero_stays_zero_and_shapes_stay():
    assert not draw_poisson(np.zeros((5, 7)), stream(3, "zero")).any()
    assert draw_poisson(np.ones((2, 3, 4)), stream(3, "shape")).shape == (2, 3, 4)


def test_a_star_changes_no_other_pixel():
    sky = np.full((200, 300), 20.3)
    starry = sky.copy()
    starry[100, 50:54] = [500.0, 20_000.0, 1e12, 0.5]
    same = np.ones(sky.shape, dtype=bool)
    same[100, 50:54] = False
    a, b = draw_poisson(sky, stream(5, "star")), draw_poisson(starry, stream(5, "star"))
    np.testing.assert_array_equal(a[same], b[same])


@pytest.mark.parametrize("wrong", [-1e-9, np.nan, np.inf, 2 * LARGEST_MEAN])
def test_means_that_cannot_be_counted(wrong):
    mean = np.ones(10)
    mean[3] = wrong
    with pytest.raises(InputError, match="must be in 0 to 1e"):
        draw_poisson(mean, stream(6, "wrong"))


def test_the_largest_mean_can_be_counted():
    assert draw_poisson(np.array([LARGEST_MEAN]), stream(6, "largest"))[0] == pytest.approx(LARGEST_MEAN, rel=1e-8)
