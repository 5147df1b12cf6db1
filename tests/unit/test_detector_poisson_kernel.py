"""The Poisson kernel and its tables against SciPy's distribution and a plain NumPy twin; no randomness involved."""

import numpy as np
import pytest
from scipy import stats

from simulator.detector.poisson import (
    LARGEST_MEAN,
    STEPS,
    SUPPORT,
    TABLE_LIMIT,
    alias_tables,
    draw_poisson,
    poisson_from_words,
)
from simulator.randomness import stream
from startracker.errors import InputError


def words(uniform):
    """Random words whose upper 53 bits are the given uniform numbers."""
    return (np.asarray(uniform) * 2.0**53).astype(np.uint64) << np.uint64(11)


def unpacked():
    table = alias_tables()
    return (table >> np.uint64(8)) / 2.0**53, (table & np.uint64(255)).astype(int)


def test_tables_hold_the_distribution():
    keep, alias = unpacked()
    rows = np.arange(TABLE_LIMIT * STEPS)
    probability = keep / SUPPORT
    np.add.at(probability, (np.repeat(rows, SUPPORT), alias.ravel()), ((1.0 - keep) / SUPPORT).ravel())
    expected = stats.poisson.pmf(np.arange(SUPPORT), rows[:, None] / STEPS)
    # The rest of 1 − k·(1/256) leaves rounding of about 256 × 1e-16 in a column.
    np.testing.assert_allclose(probability, expected, rtol=0, atol=1e-13)
    assert keep.min() >= 0.0
    assert keep.max() <= 1.0


def test_the_rest_is_inverted_exactly():
    # Below 1/STEPS the table gives zero, and the number is the quantile of the second uniform number.
    rng = stream(1, "rest")
    mean = rng.uniform(0.0, 1.0 / STEPS, 20_000)
    uniform = rng.random((2, mean.size))
    uniform[1, ::4] = 1.0 - rng.uniform(0, 1e-6, mean[::4].size)
    uniform[1, ::400] = 1.0 - 1e-12
    out = np.empty(mean.size)
    poisson_from_words(mean, *words(uniform), alias_tables(), out)
    np.testing.assert_array_equal(out, stats.poisson.ppf(uniform[1], mean))
    assert out.max() >= 4


def test_kernel_against_its_twin():
    rng = stream(2, "twin")
    mean = rng.uniform(0.0, TABLE_LIMIT, 50_000)
    uniform = rng.random((2, mean.size))
    keep, alias = unpacked()
    row = np.floor(mean * STEPS).astype(int)
    first, second = words(uniform)
    column = (first >> np.uint64(56)).astype(int)
    place = ((first << np.uint64(8)) >> np.uint64(11)) / 2.0**53
    base = np.where(place < keep[row, column], column, alias[row, column])
    out = np.empty(mean.size)
    poisson_from_words(mean, first, second, alias_tables(), out)
    np.testing.assert_array_equal(out, base + stats.poisson.ppf(uniform[1], mean - row / STEPS))


def test_largest_words_end():
    largest = np.full(4, 2**64 - 1, dtype=np.uint64)
    out = np.empty(4)
    poisson_from_words(np.array([0.0624999, 20.0624, 63.9999, 127.9999]), largest, largest, alias_tables(), out)
    assert np.all((out >= 0) & (out < SUPPORT + 20))


def test_in_place_gives_the_same_numbers():
    mean = stream(4, "in place").uniform(0, 100, (300, 200))
    expected = draw_poisson(mean, stream(4, "draws"))
    assert draw_poisson(mean, stream(4, "draws"), in_place=True) is not expected
    np.testing.assert_array_equal(mean, expected)
    with pytest.raises(ValueError, match="in place"):
        draw_poisson(np.asfortranarray(mean), stream(4, "draws"), in_place=True)


def test_zero_stays_zero_and_shapes_stay():
    assert not draw_poisson(np.zeros((5, 7)), stream(3, "zero")).any()
    assert draw_poisson(np.ones((2, 3, 4)), stream(3, "shape")).shape == (2, 3, 4)
    assert draw_poisson(np.ones((0, 4)), stream(3, "empty")).shape == (0, 4)


def test_any_layout_gives_the_same_numbers_and_is_left_alone():
    mean = stream(4, "layout").uniform(0, 100, (300, 200))
    kept = mean.copy()
    expected = draw_poisson(mean, stream(4, "draws"))
    np.testing.assert_array_equal(draw_poisson(np.asfortranarray(mean), stream(4, "draws")), expected)
    np.testing.assert_array_equal(mean, kept)
    assert np.all(expected == np.rint(expected))


def test_a_star_changes_no_other_pixel():
    sky = np.full((200, 300), 20.3)
    starry = sky.copy()
    starry[100, 50:53] = [500.0, 20_000.0, 1e12]
    same = np.ones(sky.shape, dtype=bool)
    same[100, 50:53] = False
    a, b = draw_poisson(sky, stream(5, "star")), draw_poisson(starry, stream(5, "star"))
    np.testing.assert_array_equal(a[same], b[same])


@pytest.mark.parametrize("wrong", [-1e-9, np.nan, np.inf, 2 * LARGEST_MEAN])
def test_means_that_cannot_be_counted(wrong):
    mean = np.ones(10)
    mean[3] = wrong
    with pytest.raises(InputError, match="they must lie in 0 to 1e"):
        draw_poisson(mean, stream(6, "wrong"))


def test_the_largest_mean_can_be_counted():
    assert draw_poisson(np.array([LARGEST_MEAN]), stream(6, "largest"))[0] == pytest.approx(LARGEST_MEAN, rel=1e-8)
