"""Order and ranks within kernels, against NumPy's."""

import math

import numpy as np
import pytest

from startracker.sorting import finite_medians, median, order_of, order_of_columns, ranked, sort


def numbers(kind, count, seed=3):
    rng = np.random.default_rng([seed, count])
    if kind == "equal":
        return np.full(count, -2.5)
    if kind == "ties":
        return rng.integers(-3, 4, count).astype(float)
    values = rng.normal(0.0, 10.0, count) * 10.0 ** rng.integers(-8, 9, count)
    if kind == "infinite":
        values[:: max(count // 3, 1)] = rng.choice([-np.inf, np.inf], len(values[:: max(count // 3, 1)]))
    return values


KINDS = pytest.mark.parametrize("kind", ["equal", "ties", "scattered", "infinite"])


@KINDS
def test_sorted_in_place(kind):
    for count in range(18):
        values = numbers(kind, count)
        expected = np.sort(values)
        sort(values)
        assert values.tolist() == expected.tolist()


@KINDS
def test_median_is_that_of_numpy(kind):
    for count in range(1, 18):
        values = numbers(kind, count)
        with np.errstate(invalid="ignore"):
            expected = np.median(values)
        np.testing.assert_equal(median(values.copy()), expected)
        values[count // 2] = np.nan
        assert math.isnan(median(values))


@pytest.mark.parametrize("kind", ["equal", "ties", "scattered"])
def test_value_at_every_rank_and_the_next(kind):
    for count in range(1, 18):
        values = numbers(kind, count).astype(np.float32)
        ordered = np.sort(values).tolist()
        found = [ranked(values, rank) for rank in range(count)]
        assert found == list(zip(ordered, [*ordered[1:], ordered[-1]], strict=True))


def test_medians_of_the_finite_rows():
    rows = np.array([[3.0, 10.0], [np.nan, 0.0], [1.0, 40.0], [7.0, 20.0], [0.0, -np.inf], [2.0, 30.0]])
    assert finite_medians(rows) == (2.5, 25.0)
    assert finite_medians(rows[:4]) == (3.0, 20.0)
    assert all(map(math.isnan, finite_medians(rows[[1, 4]])))
    assert len(finite_medians(rows[[1, 4]])) == 2


def test_order_of_a_few_numbers_is_stable():
    for count in range(12):
        values, order = numbers("ties", count), np.empty(count, np.int64)
        order_of(values, order)
        assert order.tolist() == np.argsort(values, kind="stable").tolist()


@pytest.mark.parametrize("keys", [1, 2, 3])
def test_order_of_columns_is_that_of_all_rows(keys):
    """By the first row, then by the next ones, then by the index."""
    for count in (0, 1, 2, 3, 5, 13, 40, 121, 200):
        columns = np.random.default_rng([keys, count]).integers(0, 4, (keys, count)).astype(float)
        assert order_of_columns(columns).tolist() == np.lexsort(columns[::-1]).tolist()
