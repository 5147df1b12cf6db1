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
    poisson_from_uniform,
)
from simulator.randomness import stream
from startracker.errors import InputError


def test_tables_hold_the_distribution():
    keep, alias = alias_tables()
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
    uniform = rng.random((mean.size, 2))
    uniform[::4, 1] = 1.0 - rng.uniform(0, 1e-6, mean[::4].size)
    uniform[::400, 1] = 1.0 - 1e-12
    out = np.empty(mean.size)
    poisson_from_uniform(mean, uniform, *alias_tables(), out)
    np.testing.assert_array_equal(out, stats.poisson.ppf(uniform[:, 1], mean))
    assert out.max() >= 4


def test_kernel_against_its_twin():
    rng = stream(2, "twin")
    mean = rng.uniform(0.0, TABLE_LIMIT, 50_000)
    uniform = rng.random((mean.size, 2))
    keep, alias = alias_tables()
    row = np.floor(mean * STEPS).astype(int)
    column = np.floor(uniform[:, 0] * SUPPORT).astype(int)
    base = np.where(uniform[:, 0] * SUPPORT - column < keep[row, column], column, alias[row, column])
    out = np.empty(mean.size)
    poisson_from_uniform(mean, uniform, keep, alias, out)
    np.testing.assert_array_equal(out, base + stats.poisson.ppf(uniform[:, 1], mean - row / STEPS))


def test_largest_uniform_number_ends():
    uniform = np.full((3, 2), np.nextafter(1.0, 0.0))
    out = np.empty(3)
    poisson_from_uniform(np.array([0.124999, 20.1249, 63.9999]), uniform, *alias_tables(), out)
    assert np.all((out >= 0) & (out < SUPPORT + 20))


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
