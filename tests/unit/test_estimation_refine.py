"""What the refinement of an attitude assumes of its stars, and which stars it starts from."""

import math
from dataclasses import replace

import numpy as np
import pytest

from startracker import Attitude, Camera, Observer, StarTracker
from startracker.centroid.result import Measured
from startracker.estimation import refine as module
from startracker.estimation.image_errors import probability_as_assumed
from startracker.estimation.refine import _matched, refine

CAMERA = Camera.from_fov(10.0, 512, 512)
ATTITUDE = Attitude.from_radec_roll(83.0, -1.0, 20.0)


@pytest.fixture(scope="module")
def guide():
    return StarTracker(CAMERA, magnitude_limit=6.5).guide


def field(guide, noise_px=0.05, seed=1):
    """Positions of the stars of a field, and the pairs with their guide stars."""
    index, _, xy = guide.in_field(ATTITUDE.as_matrix(), -3.0)
    rng = np.random.default_rng(seed)
    return xy + rng.normal(0.0, noise_px, xy.shape), np.column_stack([np.arange(len(index)), index])


class Asked(Exception):
    """The fit was reached, with its field of stars."""


@pytest.mark.parametrize("free_focal", [False, True])
@pytest.mark.parametrize("observer", [None, Observer(2025.0), Observer(2025.0, velocity_km_s=(0.0, 30.0, 0.0))])
def test_errors_that_the_fit_is_given(guide, monkeypatch, free_focal, observer):
    """Covariances where they are stated, variances else, 1 px if nothing is; with the error of the catalogue. What may
    displace the stars in addition depends on what is known of the observer and of the shutter."""
    xy, pairs = field(guide)
    given, seen = [], []

    def matched(used, points, sigma, directions, camera, guides, known, free):
        seen.append((sigma, known, free, directions))
        return used, ATTITUDE.as_matrix(), camera

    def reached(*fields):
        given.append(fields)
        raise Asked

    monkeypatch.setattr(module, "_matched", matched)
    monkeypatch.setattr(module, "_Field", reached)
    variance = np.linspace(0.01, 0.04, len(xy))
    covariance = np.tile(np.array([[0.01, 0.004], [0.004, 0.09]]), (len(xy), 1, 1))
    floor2 = (guide.catalog.position_sigma_rad / CAMERA.pixel_rad) ** 2
    for stars, sigma2, stated in (
        (Measured(xy), np.ones(len(xy)), None),
        (Measured(xy, variance_px2=variance), variance + floor2, None),
        (Measured(xy, variance_px2=variance, covariance_px2=covariance, misfit=2.5), variance + floor2, covariance),
        (Measured(xy, covariance_px2=covariance), np.ones(len(xy)), None),
    ):
        for camera in (CAMERA, replace(CAMERA, row_time_s=1e-5)):
            with pytest.raises(Asked):
                refine(pairs, stars, camera, guide, None, free_focal, observer=observer)
            points, matrices, known, *_, as_assumed, displaced = given[-1]
            expected = sigma2[:, None, None] * np.eye(2) if stated is None else stated + floor2 * np.eye(2)
            np.testing.assert_allclose(matrices, expected, rtol=1e-12)
            np.testing.assert_allclose(seen[-1][0], np.sqrt(sigma2))
            np.testing.assert_allclose(seen[-1][3], camera.unproject(xy))
            assert known is seen[-1][1] is (stars.variance_px2 is not None)
            assert as_assumed == probability_as_assumed(stars.misfit)
            unknown = observer is None or observer.velocity_km_s is None
            assert tuple(displaced) == (camera is not CAMERA, observer is None, unknown and not free_focal)
            assert points is xy


def test_bright_stars_are_kept_at_first(guide):
    """Of small stated errors: a systematic one of many times theirs is not yet a reason to leave them out."""
    xy, pairs = field(guide, 0.2)
    sigma = np.full(len(xy), 0.2)
    sigma[:2] = 0.005
    xy[:2] += 0.1
    directions = CAMERA.unproject(xy)
    used, matrix, camera = _matched(pairs, xy, sigma, directions, CAMERA, guide, True, False)
    assert {0, 1} <= set(used[:, 0])
    assert camera is CAMERA
    assert Attitude.from_matrix(matrix).angle_to(ATTITUDE) < 0.2 * CAMERA.pixel_rad


@pytest.mark.parametrize("focal", [0.99, 1.0, 1.012])
def test_a_focal_length_that_is_free_is_fitted_from_the_start(guide, focal):
    """From the middle stars, which it hardly moves: those at the border are matched with the fitted one."""
    longer = Camera(CAMERA.fx * focal, CAMERA.fy * focal, CAMERA.cx, CAMERA.cy, 512, 512)
    index, vectors, _ = guide.in_field(ATTITUDE.as_matrix(), -20.0)
    xy = longer.project(vectors) + np.random.default_rng(2).normal(0.0, 0.03, (len(index), 2))
    middle = np.flatnonzero(np.hypot(*(xy - 255.5).T) < 180.0)
    pairs = np.column_stack([middle, index[middle]])
    sigma = np.full(len(xy), 0.05)
    used, matrix, camera = _matched(pairs, xy, sigma, CAMERA.unproject(xy), CAMERA, guide, False, True)
    assert camera.fx / CAMERA.fx == pytest.approx(focal, abs=2e-4)
    assert camera.fy / camera.fx == pytest.approx(1.0)
    inside = CAMERA.contains(xy)
    assert set(used[:, 0]) == set(np.flatnonzero(inside))
    assert (index[used[:, 0]] == used[:, 1]).all()
    # the roll is known to the error of a star over its distance, 150 px rms, and √N; four of these
    assert Attitude.from_matrix(matrix).angle_to(ATTITUDE) < 4.0 * 0.03 / (150.0 * math.sqrt(len(used)))
