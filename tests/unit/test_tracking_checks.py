"""A static picture against the gyro, the size of the centroids' errors, and what a filter is given, at their limits."""

import math

import numpy as np
import pytest
from scipy.special import chdtri
from star_sequences import turned

from startracker import Attitude, Camera
from startracker.errors import InputError
from startracker.estimation.wahba import attitude_covariance
from startracker.tracking import GyroNoise, Mekf, RateNoise
from startracker.tracking.checked import checked_attitude, checked_covariance, checked_rate, checked_time
from startracker.tracking.consistency import Scatter, at_least_stated
from startracker.tracking.following import _fitting
from startracker.tracking.standstill import StandstillWatch

START = Attitude.from_radec_roll(10.0, -30.0, 200.0)
SIGMA = 1e-5
COVARIANCE = SIGMA**2 * np.eye(3)
PERFECT = GyroNoise(1e-9, 0.0, 1e-9, scale_sigma=0.0)
NOISE = GyroNoise(angle_random_walk=1e-6, rate_random_walk=1e-7, bias_sigma_rad_s=1e-5, scale_sigma=0.01)


# ---------------------------------------------------------------------- a static picture
def watched(rate, steps, noise=NOISE, bias_sigma=None, dt=2.0):
    """A watch that began at `START`, after some steps of a constant measured rate about x."""
    mekf = Mekf(START, COVARIANCE, noise)
    if bias_sigma is not None:
        mekf.reset(START, COVARIANCE, second_sigma_rad_s=bias_sigma)
    watch = StandstillWatch(noise)
    watch.add(mekf, START.quat, COVARIANCE)
    for _ in range(steps):
        watch.predict(dt, np.array([rate, 0.0, 0.0]))
    return watch


def stated_sigma(rate, t, noise=NOISE):
    drift = (noise.bias_sigma_rad_s * t) ** 2 + noise.rate_random_walk**2 * t**3 / 3.0
    return math.sqrt(2.0 * SIGMA**2 + drift + noise.angle_random_walk**2 * t) + noise.scale_sigma * abs(rate) * t


@pytest.mark.parametrize(
    "noise", [NOISE, GyroNoise(1e-4, 0.0, 0.0, scale_sigma=0.0), GyroNoise(0.0, 1e-5, 0.0), PERFECT]
)
def test_a_rotation_that_the_stars_do_not_show_is_at_most_four_stated_errors(noise):
    """Attitudes, bias, its random walk, the walk of the angle, and the scale factor in proportion to the rotation."""
    t = 40.0
    for share, contradicts in ((3.97, False), (4.03, True)):
        rate = share * stated_sigma(0.0, t, noise) / t / (1.0 - share * noise.scale_sigma)
        watch = watched(rate, 20, noise, bias_sigma=1.0)  # nothing was learnt of the bias
        found = watch.contradiction(START.quat, COVARIANCE)
        assert (found != "") is contradicts
        if contradicts:
            assert f"static for 40 s while the gyro measured {math.degrees(rate * t):.3g}°, 4.0 times" in found


@pytest.mark.parametrize(("stated", "learnt", "contradicts"), [(2.2, 8.5, True), (1.8, 8.5, False), (2.2, 7.5, False)])
def test_a_bias_that_was_learnt_may_change_less(stated, learnt, contradicts):
    """By two stated standard deviations and eight of those of the estimate."""
    t = 40.0
    rate = stated * stated_sigma(0.0, t) / t / (1.0 - stated * NOISE.scale_sigma)
    angle = rate * t
    wanted2 = (angle / learnt) ** 2 - 2.0 * SIGMA**2  # of the filter after the time
    base = watched(rate, 20, bias_sigma=0.0).filter.attitude_covariance[0, 0]
    watch = watched(rate, 20, bias_sigma=math.sqrt(max(wanted2 - base, 0.0)) / t)
    assert watch.filter.attitude_covariance[0, 0] == pytest.approx(wanted2, rel=1e-3)
    assert (watch.contradiction(START.quat, COVARIANCE) != "") is contradicts


def test_a_picture_that_moves_is_believed():
    """Beyond the errors of both attitudes, χ² of three with 1e-4; from there the watch begins again."""
    limit = math.sqrt(2.0 * chdtri(3, 1e-4)) * SIGMA
    for share, still in ((0.99, True), (1.01, False)):
        watch = watched(0.1, 20)
        moved = turned(START, np.array([0.0, share * limit, 0.0]))
        assert (watch.contradiction(moved.quat, COVARIANCE) != "") is still
        before = watch.filter
        watch.add(Mekf(moved, COVARIANCE, NOISE), moved.quat, COVARIANCE)
        assert (watch.filter is before) is still
        assert watch.contradiction(moved.quat, COVARIANCE) == "" or still


def test_without_a_sample_nothing_is_said():
    for dt, sample in ((2.0, None), (1.1e5, np.array([0.1, 0.0, 0.0]))):
        watch = watched(0.1, 20)
        watch.predict(dt, sample)
        assert watch.filter is None
        assert watch.contradiction(START.quat, COVARIANCE) == ""
        watch.predict(2.0, np.zeros(3))
        assert watch.filter is None
    assert watched(0.0, 20).contradiction(START.quat, COVARIANCE) == ""


# ---------------------------------------------------------------------- errors of the centroids
def residuals(count, size):
    """Residuals (count, 2) of a length of `size` stated errors each."""
    return np.tile([0.6 * size, -0.8 * size], (count, 1)) * 0.2, np.full(count, 0.2)


def test_the_ratio_of_actual_to_stated_errors_fades_with_the_freedom():
    scatter = Scatter()
    chi2 = freedom = 6.0
    for count, size in ((10, 3.0), (1, 50.0), (2, 0.5), (40, 1.0)):
        scatter.add(*residuals(count, size))
        degrees = 2 * count - 3
        if degrees > 0:
            chi2 = math.exp(-degrees / 200.0) * chi2 + count * size**2
            freedom = math.exp(-degrees / 200.0) * freedom + degrees
        assert scatter.factor == pytest.approx(math.sqrt(chi2 / freedom))
    for size, factor in ((1e-4, 0.05), (1e4, 22.0)):
        scatter.begin(*residuals(10, size))
        assert scatter.factor == factor


@pytest.mark.parametrize(("count", "freedom"), [(1, 0), (4, 5), (5, 7), (10, 17)])
def test_a_frame_of_few_stars_begins_with_the_weight_of_the_stated_errors(count, freedom):
    scatter = Scatter()
    scatter.add(*residuals(10, 9.0))
    scatter.begin(*residuals(count, 3.0))
    chi2 = 9.0 * count if freedom else 0.0
    missing = max(6.0 - freedom, 0.0)
    assert scatter.factor == pytest.approx(math.sqrt((chi2 + missing) / (freedom + missing)))


def test_few_stars_are_at_least_as_uncertain_as_stated():
    camera = Camera.from_fov(10.0, 512, 512)
    xy = np.random.default_rng(1).uniform(0.0, 511.0, (6, 2))
    for count in (5, 6):
        stated = attitude_covariance(camera.unproject(xy[:count]), np.full(count, 0.3 * camera.pixel_rad))
        small = at_least_stated(0.25 * stated, camera, xy[:count], 0.3)
        np.testing.assert_allclose(small, stated if count == 5 else 0.25 * stated)
        np.testing.assert_allclose(at_least_stated(4.0 * stated, camera, xy[:count], 0.3), 4.0 * stated)


def test_stars_that_do_not_fit_are_those_beyond_the_errors_of_the_frame():
    """3.7 stated errors, or 3.7 of those of the frame (median over 1.177) if these are larger."""
    sigma = np.full(6, 0.2)

    def fitting(*lengths):
        residual = np.outer(lengths, [0.12, 0.16])
        return _fitting(residual, sigma[: len(lengths)])

    assert fitting(1.0, 1.0, 1.0, 1.0, 1.0, 3.69) is None
    assert fitting(1.0, 1.0, 1.0, 1.0, 1.0, 3.71).tolist() == [True] * 5 + [False]
    rayleigh = math.sqrt(2.0 * math.log(2.0))
    wide = 2.0 * rayleigh  # the frame's errors are twice those stated
    assert fitting(wide, wide, wide, wide, wide, 7.39).all()
    assert fitting(wide, wide, wide, wide, wide, 7.41).tolist() == [True] * 5 + [False]
    few = [fitting(*([1.0] * (count - 1)), 9.0) for count in range(2, 7)]
    fewest = next(count for count, found in zip(range(2, 7), few, strict=True) if found is not None)
    assert [found is None for found in few] == [count < fewest for count in range(2, 7)]
    assert few[fewest - 2].tolist() == [True] * (fewest - 1) + [False]


# ---------------------------------------------------------------------- what a filter is given
def test_rates_times_and_variances_up_to_their_limits():
    np.testing.assert_array_equal(checked_rate([1e3, -1e3, 0.0], "a rate"), [1e3, -1e3, 0.0])
    with pytest.raises(InputError, match="a rate must be below 1000 rad/s"):
        checked_rate([0.0, 0.0, -1000.1], "a rate")
    assert checked_time(-1e11, "a time") == -1e11
    assert checked_time(1e11, "a time") == 1e11
    for beyond in (1.1e11, -1.1e11, math.nan):
        with pytest.raises(InputError):
            checked_time(beyond, "a time")
    for good in (1e6, 1e-27):
        np.testing.assert_array_equal(checked_covariance(good * np.eye(3)), good * np.eye(3))
    for bad in (1.1e6, 0.9e-28):
        with pytest.raises(InputError, match="positive definite"):
            checked_covariance(bad * np.eye(3))
    with pytest.raises(InputError, match="positive definite"):
        checked_covariance(np.diag([1.0, 1.0, -1e-9]))


def test_a_covariance_is_symmetric_to_single_precision():
    given = np.eye(3)
    given[0, 1], given[1, 0] = 0.5, 0.5 + 0.9e-6
    found = checked_covariance(given)
    assert found[0, 1] == found[1, 0] == pytest.approx(0.5 + 0.45e-6, rel=1e-12)
    given[1, 0] = 0.5 + 1.1e-6
    with pytest.raises(InputError, match="symmetric"):
        checked_covariance(given)


def test_an_attitude_is_between_the_frames_of_the_filter():
    assert checked_attitude(START, "icrs", "camera") is START
    for source, target in (("icrs", "body"), ("body", "camera")):
        with pytest.raises(InputError, match=f"from {source} to {target}; got icrs → camera"):
            checked_attitude(START, source, target)


@pytest.mark.parametrize("name", ["acceleration", "rate_sigma_rad_s"])
def test_noise_may_be_zero_and_not_negative(name):
    assert getattr(RateNoise(**{name: 0.0}), name) == 0.0
    with pytest.raises(InputError, match=f"RateNoise.{name}"):
        RateNoise(**{name: -1e-12})
