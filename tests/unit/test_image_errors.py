"""Position errors common to a field: columns, the shift that they hide, and whether images are as assumed."""

import numpy as np
import pytest
from scipy.stats import exponnorm, norm

from startracker import Camera
from startracker.estimation.image_errors import (
    AMPLITUDE_SIGMA,
    AS_ASSUMED,
    NO_IMAGE_ERRORS,
    ImageErrors,
    error_columns,
    probability_as_assumed,
    rotation_of_shift,
    shared_shift,
)


def test_columns_are_two_harmonics_of_each_axis_and_the_cubic_of_the_field():
    rng = np.random.default_rng(1)
    xy, field = rng.uniform(0.0, 1000.0, (5, 2)), rng.uniform(-0.8, 0.8, (5, 2))
    found = error_columns(xy, field)
    x, y = 2.0 * np.pi * xy.T
    expected = np.zeros((5, 2, 9))
    expected[:, 0, :4] = np.stack([np.sin(x), np.cos(x), np.sin(2 * x), np.cos(2 * x)], axis=1)
    expected[:, 1, 4:8] = np.stack([np.sin(y), np.cos(y), np.sin(2 * y), np.cos(2 * y)], axis=1)
    expected[:, :, 8] = field * (field[:, :1] ** 2 + field[:, 1:] ** 2)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_array_equal(AMPLITUDE_SIGMA, [1.4, 1.4, 0.7, 0.7, 1.4, 1.4, 0.7, 0.7, 3.0])


def test_cosines_beyond_their_noise_shift_all_stars():
    """A tenth of both cosines of an axis, less their variances; sines and the radial term do not count."""
    amplitudes = np.array([9.0, 0.3, 9.0, 0.4, 9.0, 0.1, 9.0, 0.2, 9.0])
    variance = np.full(9, 0.01)
    variance[7] = 0.06
    found = shared_shift(ImageErrors(amplitudes, variance), measured=False)
    np.testing.assert_allclose(found, np.diag([0.01 * (0.08 + 0.15), 0.0]), atol=1e-15)
    variance[5] = 0.0
    variance[7] = 0.04
    np.testing.assert_allclose(shared_shift(ImageErrors(amplitudes, variance), measured=False)[1, 1], 0.01 * 0.01)
    measured = shared_shift(ImageErrors(amplitudes, variance), measured=True)
    np.testing.assert_allclose(measured[1, 1], 0.4**2 * 0.01 * 0.01)
    np.testing.assert_array_equal(shared_shift(NO_IMAGE_ERRORS, measured=False), np.zeros((2, 2)))


@pytest.mark.parametrize("misfit", [-5.0, -1.0, 0.0, 1.0, 2.5, 4.0, 5.0])
def test_the_misfit_of_the_brightest_against_both_hypotheses(misfit):
    """A normal deviate, or an exponential one of mean 20 with the same noise (`scipy.stats.exponnorm`)."""
    clean = AS_ASSUMED * norm.pdf(misfit)
    expected = clean / (clean + (1.0 - AS_ASSUMED) * exponnorm.pdf(misfit, 20.0))
    assert probability_as_assumed(misfit) == pytest.approx(min(expected, 1.0 - 1e-6), rel=1e-6)


def test_the_probability_stays_off_its_ends():
    assert probability_as_assumed(None) == 0.5
    assert probability_as_assumed(-20.0) == probability_as_assumed(-5.0)
    for misfit in (10.0, 1000.0):
        assert probability_as_assumed(misfit) == 1e-6


def test_the_rotation_of_a_common_shift():
    """By a shift along x the camera turns about y by 1/f, and the other way round; nothing about the boresight."""
    camera = Camera(2000.0, 1000.0, 49.5, 49.5, 100, 100)
    found = rotation_of_shift(np.diag([0.04, 0.09]), camera)
    np.testing.assert_allclose(found, np.diag([0.3**2 / 1000.0**2, 0.2**2 / 2000.0**2, 0.0]), atol=1e-18)
