"""The k-vector's ranges are those of `numpy.searchsorted`, to the last value."""

import numpy as np
import pytest

from startracker.identification.pairs import find_range, k_vector


@pytest.mark.parametrize(
    "values",
    [
        np.sort(np.random.default_rng(1).uniform(0, 0.25, 5000)),
        np.sort(np.random.default_rng(2).exponential(1.0, 5000)),  # far from a line
        np.repeat(np.arange(50.0), 20),  # ties
        np.full(30, 0.1),
        np.array([0.5]),
        np.array([-1e9, 0.0, 1e-9, 1e9]),
        np.empty(0),
    ],
    ids=["even", "exponential", "ties", "all equal", "one", "wild", "none"],
)
def test_equal_to_searchsorted(values):
    index = k_vector(values)
    rng = np.random.default_rng(3)
    low, high = (values[0], values[-1]) if len(values) else (0.0, 1.0)
    margin = 0.1 * (high - low) + 1e-3
    ends = rng.uniform(low - margin, high + margin, (3000, 2))
    if len(values):  # and exactly on values, and a rounding beside them
        on = rng.choice(values, (1000, 2))
        ends = np.concatenate([ends, on, np.nextafter(on, np.inf), np.nextafter(on, -np.inf)])
    ends.sort(axis=1)
    for a, b in ends:
        want = (np.searchsorted(values, a, "left"), np.searchsorted(values, b, "right"))
        assert find_range(index, a, b) == want


def test_an_empty_range_is_empty():
    index = k_vector(np.arange(10.0))
    first, last = find_range(index, 5.5, 4.5)
    assert first == last
