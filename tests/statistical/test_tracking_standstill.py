"""A picture that stands still while the gyro moves is not a solution; a bias as stated is not a contradiction.

A frozen camera with fresh noise. Before, all frames were solved for ever, and the filter took the rate of the body for
a bias of the gyro.
"""

import math

import numpy as np
import pytest
from star_sequences import DT, LARGE, Session, motion, nees_of, stars

from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, TrackingSession

WALK = 3e-5
GYRO = GyroNoise(WALK, 1e-7, 1e-4)  # a bias of 0.006°/s


def watch(tracker, seed, frames, rate_deg_s, frozen=(), noise=GYRO, bias_sigmas=1.0):
    """Truth, solution and session of each frame; `frozen` are the frames that show what the first of them does."""
    rng = np.random.default_rng(seed)
    session, shown, runs = Session(tracker, noise), None, []
    bias = bias_sigmas * noise.bias_sigma_rad_s * rng.normal(size=3)
    scale = noise.scale_sigma * rng.normal(size=3)
    for k, (truth, mean) in enumerate(motion(rng, frames, rate_deg_s)):
        shown = shown if k in frozen and k - 1 in frozen else truth
        gyro = (1.0 + scale) * mean + bias + rng.normal(size=3) * WALK / math.sqrt(DT)
        runs.append((truth, session.update_centroids(*stars(rng, tracker, shown), k * DT, gyro_rad_s=gyro)))
    return runs, session


@pytest.mark.parametrize(("rate_deg_s", "delay"), [(1.0, 1), (0.2, 2), (0.05, 8)])
def test_picture_that_stands_still(tracker, rate_deg_s, delay):
    """It is found when the rotation exceeds 4 standard deviations of the stated errors, or 2 and 8 of those of the bias
    that had been estimated; the attitude is that of the gyro until the picture moves again."""
    runs, session = watch(tracker, 1, 60, rate_deg_s, range(20, 45))
    status = [str(found.status) for _, found in runs]
    assert set(status[:21]) == {"solved"}
    assert set(status[20 + delay : 45]) == {"gyro_mismatch"}
    refused = runs[40][1]
    assert refused.attitude is None
    assert "the stars were static for" in refused.reason
    assert set(status[45:]) == {"solved"}
    assert all(nees_of(*run) < LARGE for run in runs[45:])
    assert (np.abs(session.bias_rad_s) < 5.0 * GYRO.bias_sigma_rad_s).all()


def test_gyro_is_believed_meanwhile(tracker):
    """The filter is that of the last moving frame, propagated: off by no more than its standard deviations."""
    runs, session = watch(tracker, 2, 30, 0.5, range(20, 60))
    assert str(runs[-1][1].status) == "gyro_mismatch"
    assert session.state.mode == "coasting"
    error = runs[-1][0].rotation_vector_to(session.filter_attitude)
    assert error @ np.linalg.solve(session.covariance[:3, :3], error) < LARGE


@pytest.mark.parametrize("bias_sigmas", [0.0, 1.0])
@pytest.mark.parametrize("rate_deg_s", [0.0, 1e-4, 0.003])
def test_body_at_rest_with_a_bias_of_its_stated_size(tracker, bias_sigmas, rate_deg_s):
    for seed in range(2):
        runs, _ = watch(tracker, 10 + seed, 60, rate_deg_s, bias_sigmas=bias_sigmas)
        assert {str(found.status) for _, found in runs} == {"solved"}


def test_picture_that_stands_still_from_the_start(tracker):
    """Nothing is known of the bias yet: 0.1°/s is 17 of its stated standard deviations."""
    status = [str(found.status) for _, found in watch(tracker, 3, 20, 0.1, range(20))[0]]
    assert status[0] == "solved"
    assert set(status[3:]) == {"gyro_mismatch"}


@pytest.mark.parametrize(
    "wrong", [np.array([1j, 0.0, 0.0]), [True, False, True], "fast", [["a"] * 3], [[1.0], [1.0, 2.0]], np.zeros((3, 1))]
)
def test_a_rate_that_is_not_one_is_refused_and_the_session_is_as_before(tracker, wrong):
    _, session = watch(tracker, 4, 5, 0.1)
    before = session.filter_attitude.quat.tobytes(), session.covariance.tobytes(), session.state
    with pytest.raises(InputError, match="three numbers"):
        session.update_centroids(np.ones((4, 2)), None, 5.0, gyro_rad_s=wrong)
    for given in (
        {"attitude": "x"},
        {"attitude": Attitude([0, 0, 0, 1], "body", "camera")},
        {"attitude": Attitude([0, 0, 0, 1]), "rate_rad_s": wrong},
        {"attitude": Attitude([0, 0, 0, 1]), "rate_rad_s": [1e308, 0.0, 0.0]},
        {"attitude": Attitude([0, 0, 0, 1]), "sigma_deg": "x"},
    ):
        with pytest.raises(InputError):
            session.reset(**given)
    assert (session.filter_attitude.quat.tobytes(), session.covariance.tobytes(), session.state) == before
    with pytest.raises(InputError, match="noise must be"):
        TrackingSession(tracker, "x")


def test_absurd_rate_is_ignored_and_said(tracker):
    rng = np.random.default_rng(5)
    session = Session(tracker, GYRO)
    for k, (truth, mean) in enumerate(motion(rng, 4, 0.1)):
        gyro = [1e308, 0.0, 0.0] if k == 3 else mean
        found = session.update_centroids(*stars(rng, tracker, truth), k * DT, gyro_rad_s=gyro)
    assert found.solved
    assert "beyond 1000 rad/s and was ignored" in found.reason


def test_prediction_that_is_too_uncertain_is_not_followed(tracker):
    """Half of the field's diagonal is the limit; a wider one would place windows by chance."""
    truth = Attitude.from_radec_roll(80.0, 10.0, 20.0)
    rng = np.random.default_rng(6)
    half_deg = math.degrees(tracker.guide.half_diagonal_rad)
    for sigma_deg, followed in ((half_deg / 40.0, True), (half_deg, False)):
        session = Session(tracker, GYRO)
        session.reset(truth, sigma_deg)
        session.update_centroids(*stars(rng, tracker, truth), 0.0)
        assert (session.state.mode == "tracking") == followed
