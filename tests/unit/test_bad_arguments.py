"""What callers get wrong is one line of `InputError`, and what arrays can say is understood."""

import math

import numpy as np
import pytest

from startracker import (
    Attitude,
    Camera,
    DetectionSettings,
    IdentificationSettings,
    InputError,
    Observer,
    StarTracker,
    TrackingSettings,
)
from startracker.settings import AdaptiveSettings, CentroidSettings, OperationSettings, PyramidSettings

ATTITUDE = Attitude.from_radec_roll(85.0, -2.0, 123.0)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(Camera.from_fov(10.0, 512, 512), magnitude_limit=6.5)


@pytest.fixture(scope="module")
def field(tracker):
    index, _, xy = tracker.guide.in_field(ATTITUDE.as_matrix())
    return xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index])


def drawn(xy, flux):
    image = np.full((512, 512), 20.0)
    rows, columns = np.mgrid[:512, :512]
    for (x, y), f in zip(xy, flux, strict=True):
        image += 3e6 * f * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 1.1**2))
    return image + np.random.default_rng(1).normal(0.0, 3.0, image.shape)


@pytest.mark.parametrize("rate", [0.0, 1.0, 2.0, -1e-7, math.nan, math.inf, "1e-7", None.__class__])
def test_a_false_alarm_rate_lies_between_0_and_1(rate):
    with pytest.raises(InputError, match="false_alarm_rate is"):
        IdentificationSettings(false_alarm_rate=rate)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (IdentificationSettings, "min_stars", 0),
        (IdentificationSettings, "max_operations", 0),
        (IdentificationSettings, "max_centroids", -5),
        (AdaptiveSettings, "magnitude_tolerance", math.nan),
        (DetectionSettings, "threshold_sigma", 0.0),
        (DetectionSettings, "max_stars", 0),
        (DetectionSettings, "background_tile_px", 1),
        (CentroidSettings, "window_px", 4),
        (CentroidSettings, "flat_field_error", -0.1),
        (CentroidSettings, "camera_model_px", -0.1),
        (TrackingSettings, "false_rejection", 0.0),
        (TrackingSettings, "max_window_px", 0),
        (OperationSettings, "shorten", 1.0),
        (OperationSettings, "sun_share", math.nan),
    ],
)
def test_every_knob_is_looked_at(kind, name, value):
    with pytest.raises(InputError, match=f"{name} is"):
        kind(**{name: value})


@pytest.mark.parametrize("kind", [IdentificationSettings, DetectionSettings, CentroidSettings, TrackingSettings])
def test_defaults_and_numpy_numbers_are_fine(kind):
    kind()
    assert PyramidSettings(false_alarm_rate=np.float32(0.1), max_stars=np.int64(9)).max_stars == 9


@pytest.mark.parametrize(
    ("vector", "says"),
    [
        ([math.nan, 0.0, 0.0], "length nan"),
        ([29_000.0, 5_000.0, 100.0], r"is it in m/s\?"),
        ([[30.0, 0.0, 0.0]], r"shape \(1, 3\)"),
        ([30.0, 0.0], r"shape \(2,\)"),
        ("fast", "three numbers"),
        (30.0, r"shape \(\)"),
    ],
)
def test_an_observer_has_a_velocity_that_can_be(vector, says):
    with pytest.raises(InputError, match=says):
        Observer(velocity_km_s=vector)


def test_an_observer_has_a_position_and_an_epoch_that_can_be():
    with pytest.raises(InputError, match="position_au"):
        Observer(position_au=np.array([1.5e8, 0.0, 0.0]))
    for epoch in (math.nan, "now", 2.46e6):
        with pytest.raises(InputError, match="epoch_jyear"):
            Observer(epoch_jyear=epoch)
    assert Observer(2026.0, [20.0, -10.0, 5.0], (1.0, 0.0, 0.0)).velocity_km_s.shape == (3,)


@pytest.mark.parametrize("prior", ["M31", np.eye(3), (1.0, 0.0, 0.0, 0.0), 5])
def test_a_prior_is_an_attitude(tracker, field, prior):
    with pytest.raises(InputError, match="prior must be an Attitude"):
        tracker.solve_centroids(*field, prior=prior)


@pytest.mark.parametrize("prior_deg", [-1.0, math.nan, "wide", None])
def test_the_error_of_a_prior_is_a_positive_angle(tracker, field, prior_deg):
    with pytest.raises(InputError, match="prior_deg"):
        tracker.solve_centroids(*field, prior=ATTITUDE, prior_deg=prior_deg)


def test_centroids_are_numbers(tracker):
    with pytest.raises(InputError, match="must be numbers"):
        tracker.solve_centroids([["a", "b"]])
    with pytest.raises(InputError, match="must be numbers"):
        tracker.solve_centroids([[1.0, 2.0], [3.0]])


def test_a_contradicted_prior_is_a_field_of_the_solution(tracker, field):
    elsewhere = Attitude.from_radec_roll(185.0, 20.0, 3.0)
    assert tracker.solve_centroids(*field, prior=elsewhere).prior_contradicted
    assert not tracker.solve_centroids(*field, prior=ATTITUDE).prior_contradicted
    assert not tracker.solve_centroids(*field).prior_contradicted


def test_masked_pixels_are_bad_pixels(tracker, field):
    image = drawn(*field)
    bad = np.zeros(image.shape, bool)
    bad[200:260] = True
    bad[:, 400] = True
    spoilt = np.where(bad, 30000.0, image)
    for kind in (np.float64, np.uint16):
        solution = tracker.solve(np.ma.array(spoilt.astype(kind), mask=bad))
        assert solution.solved, solution.reason
        assert math.degrees(ATTITUDE.angle_to(solution.attitude)) * 3600 < 10.0
        told = tracker.solve(np.where(bad, np.nan, spoilt.astype(kind)))
        np.testing.assert_array_equal(solution.centroids, told.centroids)
    whole = np.ma.array(image, mask=False)
    np.testing.assert_array_equal(tracker.solve(whole).centroids, tracker.solve(image).centroids)


def test_masked_centroids_are_left_out(tracker, field):
    xy, flux = field
    away = np.concatenate([xy, [[100.0, 100.0]]])
    mask = np.zeros(away.shape, bool)
    mask[-1] = True
    solution = tracker.solve_centroids(np.ma.array(away, mask=mask), np.append(flux, 1.0))
    assert solution.solved
    assert len(solution.centroids) == len(xy)
