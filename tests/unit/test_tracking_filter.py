"""The filter's update against a plain linear Kalman filter, and what it says to what cannot be."""

import math

import numpy as np
import pytest
from star_sequences import turned

from startracker.errors import InputError
from startracker.estimation import wahba_svd
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, Mekf, RateNoise
from startracker.tracking.kinematics import correct
from startracker.tracking.mekf import chi_square_limit
from startracker.tracking.watched import WatchedFilter

START = Attitude.from_radec_roll(10.0, -30.0, 200.0)


def directions(rng, n, half_deg=5.0):
    xy = rng.uniform(-1, 1, size=(n, 2)) * math.tan(math.radians(half_deg))
    v = np.column_stack([xy, np.ones(n)])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def running(noise):
    """A filter with correlations between its two states."""
    twin = Mekf(START, np.diag([1.0, 2.0, 30.0]) * 1e-8, noise)
    twin.predict(2.0, np.array([0.01, 0.02, -0.01]) if isinstance(noise, GyroNoise) else None)
    return twin


@pytest.mark.parametrize("noise", [GyroNoise(3e-5, 1e-6, 1e-4), RateNoise(1e-5, 1e-4)])
def test_update_is_the_linear_filters(noise):
    rng = np.random.default_rng(1)
    twin = running(noise)
    before, p = twin.attitude, twin.covariance
    second = twin.bias_rad_s if isinstance(noise, GyroNoise) else twin.rate_rad_s
    change = rng.normal(size=3) * 1e-6
    r = np.diag([3.0, 1.0, 50.0]) * 1e-9
    h = np.hstack([np.eye(3), np.zeros((3, 3))])
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
    found = twin.update_attitude(turned(before, change), r)
    np.testing.assert_allclose(before.rotation_vector_to(twin.attitude), (gain @ change)[:3], atol=1e-15)
    now = twin.bias_rad_s if isinstance(noise, GyroNoise) else twin.rate_rad_s
    np.testing.assert_allclose(now - second, (gain @ change)[3:], atol=1e-15)
    np.testing.assert_allclose(twin.covariance, (np.eye(6) - gain @ h) @ p, atol=1e-22)
    assert found.accepted
    assert found.distance2 == pytest.approx(change @ np.linalg.solve(p[:3, :3] + r, change))


def test_a_measurement_without_a_positive_covariance_changes_nothing():
    twin = running(RateNoise(1e-5, 1e-4))
    before, p = twin.attitude, twin.covariance
    indefinite = np.diag([1e-9, 1e-9, -1.0])
    with pytest.raises(InputError, match="positive definite"):
        twin.update_attitude(turned(before, np.full(3, 1e-5)), indefinite)
    assert math.isnan(correct(p, np.eye(3), np.full(3, 1e-5), indefinite)[0])
    assert np.array_equal(twin.attitude.quat, before.quat)
    assert np.array_equal(twin.covariance, p)


def test_directions_tell_what_their_attitude_tells():
    """Many stars at once, their Wahba attitude, and star by star: the same state; up to the errors' squares."""
    rng = np.random.default_rng(2)
    filters = [running(RateNoise(1e-5, 1e-4)) for _ in range(3)]
    truth = turned(filters[0].attitude, rng.normal(size=3) * 1e-5)
    sigma = np.full(8, 1e-5)
    seen = directions(rng, 8)
    reference = truth.inverse.apply(seen)
    seen = seen + rng.normal(size=seen.shape) * sigma[:, None]
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    filters[0].update_vectors(seen, reference, sigma)
    estimate = wahba_svd(seen, reference, sigma)
    filters[1].update_attitude(estimate.matrix, estimate.covariance)
    for k in range(8):
        assert filters[2].update_vectors(seen[k], reference[k], sigma[k]).freedom == 2
    for other in filters[1:]:
        np.testing.assert_allclose(other.attitude.rotation_vector_to(filters[0].attitude), 0.0, atol=2e-8)
        np.testing.assert_allclose(other.covariance, filters[0].covariance, rtol=2e-3, atol=1e-15)


def test_large_error_is_linearised_again():
    """Without that, 2° of error would leave some 2° × 0.035 rad / 2 = 2′, 6e-4 rad, and ten times that in roll.

    The last correction is below 3e-4 rad: its square, over the field's 0.07 rad, is 1e-6; the prior pulls by less.
    """
    rng = np.random.default_rng(3)
    truth = turned(START, np.radians([1.0, -1.5, 1.0]))
    seen = directions(rng, 10)
    twin = Mekf(START, np.eye(3) * math.radians(2.0) ** 2)
    twin.update_vectors(seen, truth.inverse.apply(seen), np.full(10, 1e-5))
    assert truth.angle_to(twin.attitude) < 1e-5


def test_one_star_leaves_the_turn_about_it_unknown():
    twin = Mekf(START, np.eye(3) * 1e-6)
    axis = np.array([0.0, 0.0, 1.0])
    twin.update_vectors(axis, START.inverse.apply(axis), 1e-6)
    assert np.diag(twin.attitude_covariance) == pytest.approx([1e-12, 1e-12, 1e-6], rel=1e-5)


def test_gate_refuses_and_changes_nothing():
    twin = running(RateNoise(1e-5, 1e-4))
    before, p = twin.attitude, twin.covariance
    far = turned(before, [0.1, 0.0, 0.0])
    assert not twin.update_attitude(far, np.eye(3) * 1e-10, 1e-3).accepted
    assert twin.attitude.angle_to(before) == 0.0
    np.testing.assert_array_equal(twin.covariance, p)
    assert twin.update_attitude(far, np.eye(3) * 1e-10).accepted  # without a gate
    assert chi_square_limit(2, 0.05) == pytest.approx(5.991, abs=1e-3)  # any table of chi-square


def test_bias_is_observed_and_leaves_the_rate():
    """With attitudes at hand the bias of all three axes shows; without, it never does.

    The rate is steady, where a scale factor's error is a bias and cannot be separated from it: it is taken as known.
    """
    rng = np.random.default_rng(5)
    bias, rate = np.array([1e-3, -5e-4, 2e-3]), np.array([0.01, 0.0, -0.02])
    twin = Mekf(START, np.eye(3) * 1e-10, GyroNoise(1e-6, 1e-9, 1e-2, scale_sigma=0.0))
    blind = twin.copy()
    truth = START
    for _ in range(200):
        truth = turned(truth, rate)
        gyro = rate + bias + rng.normal(size=3) * 1e-6
        for each in (twin, blind):
            each.predict(1.0, gyro)
        twin.update_attitude(turned(truth, rng.normal(size=3) * 1e-5), np.eye(3) * 1e-10)
    sigma = np.sqrt(np.diag(twin.covariance)[3:])
    assert (sigma < 1e-6).all()
    assert (np.abs(twin.bias_rad_s - bias) < 4.0 * sigma).all()
    np.testing.assert_allclose(twin.rate_rad_s, gyro - twin.bias_rad_s, atol=1e-15)
    assert (np.sqrt(np.diag(blind.covariance)[3:]) >= 1e-2).all()


def test_scale_factor_is_observed_where_the_rate_changes():
    """Rates of both signs separate it from the bias; without the state the filter believes in an attitude that is off.

    The last error's χ² of nine is above 40 with a probability of 1e-5. Without the state a rate of 0.02 rad/s that
    turns round leaves some 2e-4 rad/s of bias error that changes sign, many times the filter's own.
    """
    rng = np.random.default_rng(6)
    scale, bias = np.array([0.01, -0.01, 0.005]), np.array([1e-4, 2e-4, -1e-4])
    filters = [Mekf(START, np.eye(3) * 1e-10, GyroNoise(1e-6, 1e-9, 1e-3, scale_sigma=sigma)) for sigma in (0.01, 0.0)]
    truth = START
    for k in range(200):
        rate = 0.02 * np.sin(0.05 * k + np.array([0.0, 1.0, 2.0]))
        truth = turned(truth, rate)
        gyro = (1.0 + scale) * rate + bias + rng.normal(size=3) * 1e-6
        measured = turned(truth, rng.normal(size=3) * 1e-5)
        for each in filters:
            each.predict(1.0, gyro)
            each.update_attitude(measured, np.eye(3) * 1e-10)
    twin, blind = filters
    assert (twin.scale_sigma < 1e-4).all()
    assert (np.abs(twin.scale - scale) < 5.0 * twin.scale_sigma).all()
    np.testing.assert_allclose(twin.rate_rad_s, (gyro - twin.bias_rad_s) / (1.0 + twin.scale), atol=1e-9)
    nees = []
    for each in filters:
        error = np.concatenate([each.attitude.rotation_vector_to(truth), bias - each.bias_rad_s])
        nees.append(error @ np.linalg.solve(each.covariance, error))
    assert nees[0] < 40.0
    assert nees[1] > 1000.0
    assert not blind.scale.any()


def test_innovations_are_whitened():
    """Of a filter whose assumptions hold: three independent numbers of variance 1; sums of 300, five deviations."""
    rng = np.random.default_rng(7)
    twin, truth, white = Mekf(START, np.eye(3) * 1e-10, RateNoise(1e-9, 1e-6)), START, []
    for _ in range(300):
        twin.predict(1.0)
        r = np.diag([1.0, 2.0, 50.0]) * 1e-10
        found = twin.update_attitude(turned(truth, rng.normal(size=3) * np.sqrt(np.diag(r))), r)
        assert found.whitened @ found.whitened == pytest.approx(found.distance2)
        white.append(found.whitened)
    white = np.array(white)
    assert (np.abs(white.sum(axis=0)) < 5.0 * math.sqrt(300)).all()
    assert np.abs(white.T @ white / 300 - np.eye(3)).max() < 5.0 * math.sqrt(2.0 / 300)
    assert np.abs(white[1:].T @ white[:-1] / 299).max() < 5.0 / math.sqrt(299)


def test_gyro_that_falls_silent_costs_certainty():
    heard, silent = (Mekf(START, np.eye(3) * 1e-10, GyroNoise(1e-6, 1e-9, 1e-6)) for _ in range(2))
    heard.predict(10.0, [0.0, 0.0, 0.0])
    silent.predict(10.0)
    extra = np.diag(silent.attitude_covariance - heard.attitude_covariance)
    assert extra == pytest.approx(1e-3**2 * 10.0**3 / 3.0)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda f: f.predict(-1.0),
        lambda f: f.predict(math.nan),
        lambda f: f.predict(1.0, [0, 0, 0]),
        lambda f: f.update_vectors(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)),
        lambda f: f.update_vectors([0, 0, 1.0], [[0, 0, 1.0]] * 2, 1.0),
        lambda f: f.update_vectors([0, 0, 1.0], [0, 0, 1.0], 0.0),
        lambda f: f.reset(START, -np.eye(3)),
        lambda f: RateNoise(acceleration=-1.0),
        lambda f: Mekf(START, np.eye(3), GyroNoise()).predict(1.0, [0.0, math.nan, 0.0]),
    ],
)
def test_what_cannot_be_is_refused(wrong):
    with pytest.raises(InputError):
        wrong(Mekf(START, np.eye(3)))


def test_doubt_adds_the_variances_of_errors():
    """Of the attitude, of the bias or the rate, and of the scale factors by what was stated of them."""
    for noise in (GyroNoise(3e-5, 1e-6, 1e-4, scale_sigma=1e-3), GyroNoise(3e-5, scale_sigma=0.0), RateNoise()):
        twin = Mekf(START, np.diag([1.0, 2.0, 30.0]) * 1e-8, noise)
        before, scale = twin.covariance, twin.scale_sigma
        twin.doubt(3e-4, 2e-5)
        np.testing.assert_allclose(
            twin.covariance - before, np.diag(np.repeat([9e-8, 4e-10], 3)), rtol=1e-9, atol=1e-22
        )
        np.testing.assert_allclose(twin.scale_sigma, scale * math.sqrt(2.0))
        kept = twin.covariance
        twin.distrust(4.0)
        np.testing.assert_allclose(twin.covariance, 4.0 * kept)


def test_the_prior_of_a_prediction_is_five_standard_deviations_wide():
    """At least 0.1°; none if that is more than the limit."""
    watched = WatchedFilter(RateNoise(), 1e-6)
    assert watched.prior(10.0) == (None, 1.0)
    assert watched.uncertainty_rad == math.inf
    assert watched.covariance is None
    watched.begin(START, np.eye(3) * 1e-12)
    attitude, found = watched.prior(0.1)
    assert found == 0.1
    assert attitude.angle_to(START) < 1e-12
    assert watched.prior(0.0999) == (None, 1.0)
    watched.begin(START, np.diag([1.0, 4.0, 4.0]) * 1e-6)
    width = math.degrees(5.0 * 3e-3)
    attitude, found = watched.prior(1.001 * width)
    assert attitude.angle_to(START) < 1e-12
    assert found == pytest.approx(width)
    assert watched.prior(0.999 * width) == (None, 1.0)


def test_scale_factors_that_are_not_estimated_are_known_to_be_zero():
    for noise, expected in ((RateNoise(), 0.0), (GyroNoise(scale_sigma=0.0), 0.0), (GyroNoise(scale_sigma=0.02), 0.02)):
        mekf = Mekf(START, np.eye(3) * 1e-10, noise)
        assert mekf.scale.tolist() == [0.0] * 3
        assert mekf.scale_sigma.tolist() == pytest.approx([expected] * 3)


def test_a_bias_is_large_against_what_its_gyro_states():
    """6 σ of the stated and of the estimated variance together, which are equal at the beginning."""
    sigma = 1e-3
    mekf = Mekf(START, np.eye(3) * 1e-10, GyroNoise(1e-6, 1e-9, sigma))
    assert mekf.bias_excess == 0.0
    mekf._bias = np.array([0.0, -12.0, 6.0]) * math.sqrt(2.0) * sigma
    assert mekf.bias_excess == pytest.approx(2.0, rel=1e-12)
    assert Mekf(START, np.eye(3) * 1e-10, RateNoise()).bias_excess == 0.0


def test_a_prediction_beyond_a_right_angle_is_no_longer_one():
    watched = WatchedFilter(RateNoise(), 1e-6)
    watched.predict(1.0, None)
    for sigma, kept in ((0.999, True), (1.001, False)):
        watched.begin(START, np.eye(3) * (sigma * math.pi / 2.0) ** 2 / 3.0)
        watched.predict(0.0, None)
        assert (watched.mekf is not None) is kept
    watched.begin(START, np.eye(3))
    watched.forget()
    assert watched.mekf is None


def test_gyro_samples_that_cannot_be_are_ignored_with_a_remark():
    watched = WatchedFilter(GyroNoise(), 1e-6)
    assert watched.has_gyro
    assert not WatchedFilter(RateNoise(), 1e-6).has_gyro
    assert watched.sample(None) == (None, "")
    sample, remark = watched.sample([0.1, 0.2, -0.3])
    assert (sample.tolist(), remark) == ([0.1, 0.2, -0.3], "")
    assert watched.sample([0.1, math.nan, 0.0]) == (None, "the gyro sample is not finite and was ignored")
    sample, remark = watched.sample([0.0, -1e6, 0.0])
    assert sample is None
    assert remark.startswith("the gyro sample is beyond ")


@pytest.mark.parametrize("step_s", [0.25, 4.0])
def test_a_restart_knows_the_rate_from_the_last_two_attitudes(step_s):
    """Without a gyro the difference from the last solved attitude over the time bounds the rate; with one that from the
    prediction bounds the bias; either is at least as uncertain as stated at first."""
    covariance = np.eye(3) * 1e-14
    for noise, stated in ((RateNoise(1e-6, 1e-3), 1e-3), (GyroNoise(1e-6, 1e-8, 1e-4, scale_sigma=0.0), 1e-4)):
        for turn, expected in ((0.1, 0.1 / step_s), (1e-4 * step_s, stated)):
            watched = WatchedFilter(noise, 1e-6)
            innovation, restarted = watched.take_attitude(10.0, START, covariance)
            assert innovation is None
            assert restarted
            moved = turned(START, np.array([0.0, turn, 0.0]))
            watched.mekf = Mekf(START, covariance, noise)  # a prediction that is certain, so that the gate is narrow
            watched.mekf.reset(START, covariance, second_sigma_rad_s=0.0)
            innovation, restarted = watched.take_attitude(10.0 + step_s, moved, covariance)
            assert restarted
            assert not innovation.accepted
            second = np.sqrt(watched.mekf.covariance.diagonal()[3:])
            np.testing.assert_allclose(second, expected, rtol=1e-6)
            assert watched.mekf.attitude.angle_to(moved) < 1e-12
            assert watched.mekf.noise_factor == 10.0  # within a window of frames it is an alarm
    unsolved = WatchedFilter(RateNoise(1e-6, 1e-3), 1e-6)
    unsolved.begin(START, covariance)
    unsolved.take_attitude(1.0, turned(START, np.array([0.0, 0.1, 0.0])), covariance)
    np.testing.assert_allclose(np.sqrt(unsolved.mekf.covariance.diagonal()[3:]), 1e-3)


def test_contradictions_reduce_the_confidence_in_the_prediction():
    """Two attitudes that are each within the gate, and together beyond what a consistent filter gives: the second is
    weighed ten times as much, and the noise is raised."""
    watched = WatchedFilter(RateNoise(0.0, 0.0), 1e-6)
    covariance = np.eye(3) * 1e-10
    watched.begin(START, covariance)
    off = turned(START, np.array([4.5e-5 * math.sqrt(2.0), 0.0, 0.0]))  # 4.5 standard deviations of the innovation
    innovation, restarted = watched.take_attitude(1.0, off, covariance)
    assert innovation.accepted
    assert not restarted
    assert not watched.distrusted
    before = watched.mekf.attitude
    again = turned(before, np.array([4.5e-5 * math.sqrt(1.5), 0.0, 0.0]))
    innovation, restarted = watched.take_attitude(2.0, again, covariance)
    assert not restarted
    assert watched.distrusted
    assert watched.mekf.noise_factor == 10.0 - 9.0 / 256.0
    # variance of the prediction 5e-11, ten times as large: 5 parts of 6 of the difference are taken
    taken = before.angle_to(watched.mekf.attitude) / before.angle_to(again)
    assert taken == pytest.approx(5.0 / 6.0, rel=1e-3)
