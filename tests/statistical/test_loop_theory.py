"""The linear theory of the example's attitude loop against loops that are stepped one by one."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

EXAMPLES = str(Path(__file__).parents[2] / "examples" / "live")
sys.path.insert(0, EXAMPLES)
from loop_theory import Loop, expected, frame_covariance  # noqa: E402

sys.path.remove(EXAMPLES)

INERTIA = np.array([[0.22, 0.01, 0.0], [0.01, 0.13, -0.02], [0.0, -0.02, 0.25]])
LOOP = Loop(INERTIA, attitude_gain=0.0088, rate_gain=0.04, integral_gain=0.75, step_s=0.5, acceleration=5e-6)
OF_FRAME = np.array([[1.0, 0.3, 0.0], [0.3, 50.0, -1.0], [0.0, -1.0, 2.0]]) * 1e-12
LOOPS, STEPS, SETTLED = 100, 1400, 600
CHANCE = 1e-4


def stepped(loop, of_frame, rng):
    """(LOOPS, N, 3): θ, and errors of the filter; and the filter's covariance before and after its last frame.

    Written from Basilisk's control law and the textbook filter, without the matrices of the theory.
    """
    h, shape = loop.step_s, (LOOPS, 3)
    theta, omega, told, told_rate, summed = (np.zeros(shape) for _ in range(5))
    # process noise by van Loan's exponential (1978, IEEE Trans. Automatic Control 23, 395)
    f, g = np.kron([[0, 1], [0, 0]], np.eye(3)), np.diag([0.0] * 3 + [loop.acceleration**2] * 3)
    big = expm(np.block([[-f, g], [np.zeros((6, 6)), f.T]]) * h)
    move = big[6:, 6:].T
    noise = move @ big[:6, 6:]
    covariance = np.diag([1e-9] * 3 + [1e-9] * 3)
    noise_of_frames = np.linalg.cholesky(of_frame)
    thetas, errors = [], []
    for _ in range(STEPS):
        summed = summed + loop.attitude_gain * h * told / 4.0
        integral = summed + told_rate @ loop.inertia_kg_m2
        torque = -loop.attitude_gain * told / 4.0 - loop.rate_gain * (told_rate + loop.integral_gain * integral)
        measured = theta + rng.standard_normal(shape) @ noise_of_frames.T
        before = covariance
        gain = covariance[:, :3] @ np.linalg.inv(covariance[:3, :3] + of_frame)
        covariance = covariance - gain @ covariance[:3]
        correction = (measured - told) @ gain.T
        now, rate = told + correction[:, :3], told_rate + correction[:, 3:]
        thetas.append(theta)
        errors.append(now - theta)
        after, covariance = covariance, move @ covariance @ move.T + noise
        told, told_rate = now + h * rate, rate
        acceleration = np.linalg.solve(loop.inertia_kg_m2, torque.T).T
        theta, omega = theta + h * omega + h**2 / 2.0 * acceleration, omega + h * acceleration
    kept = slice(SETTLED, None)
    return np.stack(thetas, 1)[:, kept], np.stack(errors, 1)[:, kept], before, after


@pytest.fixture(scope="module")
def loops():
    return stepped(LOOP, OF_FRAME, np.random.default_rng(3))


def test_mean_squares_and_their_scatter(loops):
    """Over all loops the mean square has a relative error √(2/ν N); of the loops, as many as expected are beyond their
    limits."""
    theory = expected(LOOP, OF_FRAME)
    theta, errors, _, after = loops
    frames = theta.shape[1]
    ratio = np.mean(theta**2, axis=1) / theory.pointing.diagonal()
    for chance in (0.05, 0.2):
        low, high = theory.pointing_limits(frames, chance)
        for beyond in ((ratio < low).sum(), (ratio > high).sum()):
            assert abs(beyond - 3 * LOOPS * chance) < 5.0 * np.sqrt(3 * LOOPS * chance)  # axes are correlated
    spread = ratio.std(axis=0) / np.sqrt(LOOPS)
    assert (np.abs(ratio.mean(axis=0) - 1.0) < 4.0 * spread).all()
    np.testing.assert_allclose(after[:3, :3], theory.stated, rtol=1e-6)
    nees = np.einsum("lni,ij,lnj->ln", errors, np.linalg.inv(theory.stated), errors).mean(axis=1) / theory.nees
    assert abs(nees.mean() - 1.0) < 4.0 * nees.std() / np.sqrt(LOOPS)
    low, high = theory.nees_limits(frames, 0.1)
    for beyond in ((nees < low).sum(), (nees > high).sum()):
        assert abs(beyond - 0.1 * LOOPS) < 4.0 * np.sqrt(0.1 * LOOPS)


def test_error_of_a_frame_from_the_covariances_of_the_filter():
    *_, after = stepped(LOOP, OF_FRAME, np.random.default_rng(3))
    np.testing.assert_allclose(frame_covariance(LOOP, after, after), OF_FRAME, atol=1e-6 * OF_FRAME.max())


def test_an_unstable_loop_is_refused():
    with pytest.raises(ValueError, match="not stable"):
        expected(LOOP._replace(attitude_gain=100.0 * LOOP.attitude_gain), OF_FRAME)
