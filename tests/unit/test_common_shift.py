"""Errors that depend on the position in the pixel, and the shift of all stars that comes with them."""

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker
from startracker.centroid.result import Measured
from startracker.estimation import field_fit
from startracker.estimation.refine import refine
from startracker.observer import Observer

AMPLITUDE_PX, SIGMA_PX = 0.1, 0.01


@pytest.fixture(scope="module")
def fitted():
    """Covariance of a field of 40 stars with a cosine of the position in the pixel as error along x, in px² of the
    shift along x, with a given common error."""
    tracker = StarTracker(Camera.from_fov(12.0, 1024, 1024), magnitude_limit=6.5)
    rng, observer = np.random.default_rng(3), Observer(tracker.guide.epoch_jyear, np.zeros(3))
    guide = tracker.guide.apparent_to(observer)
    attitude = Attitude.from_radec_roll(85.0, 5.0, 30.0)
    index, _, xy = guide.in_field(attitude.as_matrix(), -2.0)
    assert len(index) > 40
    seen = xy[:40] + SIGMA_PX * rng.normal(size=(40, 2))
    seen[:, 0] += AMPLITUDE_PX * np.cos(2.0 * np.pi * xy[:40, 0])
    pairs = np.stack([np.arange(40), index[:40]], axis=1)

    def variance(common_px2):
        stars = Measured(seen, variance_px2=np.full(40, SIGMA_PX**2), common_px2=common_px2, misfit=50.0)
        found = refine(pairs, stars, tracker.camera, guide, field_fit, observer=observer)
        return found.covariance[1, 1] / tracker.camera.pixel_rad**2

    return variance


def test_a_shift_that_the_star_images_show_is_not_counted_twice(fitted):
    """A tenth of the cosine's amplitude stands for a common shift of which nothing else is known. Where star images
    show it, so that it is subtracted, 0.4 of it remains: with all of it, and the error of what is subtracted, the
    covariance was twice the errors (coma of 0.1 waves and 12 µm of defocus at f/1.4)."""
    unknown, shown, more = (fitted(common) for common in (None, np.zeros((2, 2)), np.diag([0.004**2, 0.0])))
    # of 40 stars the amplitude is known to 0.01 √(2/40) = 0.002 px; the cosine of the measured position is not quite
    # that of the true one
    assert np.sqrt((unknown - shown) / (1.0 - 0.4**2)) == pytest.approx(0.1 * AMPLITUDE_PX, rel=0.1)
    assert more - shown == pytest.approx(0.004**2, rel=0.01)
