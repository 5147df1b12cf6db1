"""The error function of the kernels against SciPy's, and the shares of pixels against its differences."""

import numpy as np
from numba import njit
from scipy.special import erf

from simulator.optics.error_function import error_function, shares_of_pixels


@njit
def _of_each(x):
    return np.array([error_function(value) for value in x])


def test_it_is_scipys_to_two_units_in_the_last_place():
    x = np.concatenate([np.linspace(-7.0, 7.0, 100_001), [0.0, -0.0, 1e-300, 1e300, -np.inf, np.inf]])
    np.testing.assert_allclose(_of_each(x), erf(x), rtol=0, atol=4.5e-16)  # 2 ulp of 1


def test_between_its_points_it_does_not_jump():
    edges = (np.arange(96) + 0.5) / 16  # where one series takes over from another
    below, above = _of_each(np.nextafter(edges, 0.0)), _of_each(edges)
    np.testing.assert_allclose(above, below, rtol=0, atol=4.5e-16)


def test_shares_of_pixels_are_differences_of_it():
    out = np.full(12, np.nan)
    shares_of_pixels(out[2:], 5, 12, 8.3, 0.7)
    edges = np.arange(5, 14) - 0.5
    np.testing.assert_allclose(out[2:10], np.diff(0.5 * erf((edges - 8.3) * 0.7)), rtol=0, atol=4.5e-16)
    assert np.isnan(out[[0, 1, 10, 11]]).all()
