"""The filter against theory: Farrenkopf's steady state, Van Loan's integrals, an integrated rotation.

Sources: Farrenkopf 1978, J. Guidance and Control 1, 282, in the form of Markley & Crassidis 2014, section 6.3 (attitude
after and before a measurement of a single axis); Van Loan 1978, IEEE Trans. Automatic Control 23, 395, with
scipy.linalg.expm; scipy.linalg.solve_discrete_are; scipy.integrate.solve_ivp. These are closed forms and converged
numerics, so that the tolerances are those of rounding, or of the integrator where one is used.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, Mekf, RateNoise
from startracker.tracking.kinematics import propagate


def cross(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.029, 0.031, 1.0, 20.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_step_is_van_loans(angle, sign):
    rng = np.random.default_rng(3)
    dt, angle_psd, rate_psd = 0.7, 0.09, 0.04
    axis = rng.normal(size=3)
    rate = axis / np.linalg.norm(axis) * angle / dt
    drift = np.zeros((6, 6))
    drift[:3, :3], drift[:3, 3:] = -cross(rate), sign * np.eye(3)
    noise = np.diag([angle_psd] * 3 + [rate_psd] * 3)
    block = np.zeros((12, 12))
    block[:6, :6], block[:6, 6:], block[6:, 6:] = -drift, noise, drift.T
    big = expm(block * dt)
    phi = big[6:, 6:].T
    start = rng.normal(size=(6, 6))
    start = start @ start.T
    _, found = propagate(np.array([0.0, 0.0, 0.0, 1.0]), start, rate, dt, sign, angle_psd, rate_psd, 0.0)
    np.testing.assert_allclose(found, phi @ start @ phi.T + phi @ big[:6, 6:], rtol=0, atol=2e-12 * np.trace(start))


@pytest.mark.parametrize(
    ("random_walk", "bias_walk", "dt"),
    [(2e-5, 3e-6, 2.0), pytest.param(1e-4, 1e-8, 0.1, marks=pytest.mark.slow), (1e-6, 1e-4, 1.0)],
)
def test_steady_state_is_farrenkopfs(random_walk, bias_walk, dt):
    sigma = 1e-4
    twin = Mekf(Attitude([0, 0, 0, 1]), np.eye(3) * 1e-4, GyroNoise(random_walk, bias_walk, 1e-3))
    phi = np.array([[1.0, -dt], [0.0, 1.0]])
    noise = np.array(
        [
            [random_walk**2 * dt + bias_walk**2 * dt**3 / 3.0, -(bias_walk**2) * dt**2 / 2.0],
            [-(bias_walk**2) * dt**2 / 2.0, bias_walk**2 * dt],
        ]
    )
    before_are = solve_discrete_are(phi.T, np.array([[1.0], [0.0]]), noise, np.array([[sigma**2]]))
    before = after = twin.covariance
    for _ in range(60_000):
        twin.predict(dt, np.zeros(3))
        previous, before = before, twin.covariance
        twin.update_attitude(Attitude([0, 0, 0, 1]), np.eye(3) * sigma**2)
        after = twin.covariance
        if np.allclose(previous, before, rtol=1e-13, atol=0):
            break
    s_u, s_v = bias_walk * dt**1.5 / sigma, random_walk * math.sqrt(dt) / sigma
    gamma = math.sqrt(1.0 + s_v**2 / 4.0 + s_u**2 / 48.0)
    zeta = gamma + s_u / 4.0 + 0.5 * math.sqrt(2.0 * gamma * s_u + s_v**2 + s_u**2 / 3.0)
    for axis in range(3):
        # the iteration stops at 1e-13 a step; slow modes leave up to a thousand times that
        assert before[axis, axis] == pytest.approx(sigma**2 * (zeta**2 - 1.0), rel=1e-7)
        assert after[axis, axis] == pytest.approx(sigma**2 * (1.0 - 1.0 / zeta**2), rel=1e-7)
        assert before[axis, axis] == pytest.approx(before_are[0, 0], rel=1e-6)
        assert before[3 + axis, 3 + axis] == pytest.approx(before_are[1, 1], rel=1e-6)


@pytest.mark.parametrize("gyro", [True, False])
def test_attitude_and_linear_error_follow_the_integrated_motion(gyro):
    """q' = ½ Ω(ω) q integrated to 1e-12; and a small wrong start stays what the transition matrix makes of it."""
    rate = np.array([0.02, -0.05, 0.03])
    start = Attitude.from_radec_roll(40.0, 20.0, 70.0)

    def motion(_, m):
        return (-cross(rate) @ m.reshape(3, 3)).ravel()

    end = solve_ivp(motion, (0, 9.0), start.as_matrix().ravel(), rtol=1e-12, atol=1e-13).y[:, -1].reshape(3, 3)
    noise = GyroNoise() if gyro else RateNoise()
    twin = Mekf(start, np.eye(3) * 1e-8, noise, rate)
    for _ in range(18):
        twin.predict(0.5, rate if gyro else None)
    np.testing.assert_allclose(twin.matrix, end, atol=1e-10)
    # the same filter from a start that is off by δθ, δr
    small, slow = np.array([1e-6, 2e-6, -1e-6]), np.array([2e-7, -1e-7, 3e-7])
    wrong = Mekf(Attitude.from_rotation_vector(small, "camera", "camera") @ start, np.eye(3) * 1e-8, noise, rate + slow)
    wrong.predict(9.0, rate + slow if gyro else None)
    drift = np.zeros((6, 6))
    drift[:3, :3], drift[:3, 3:] = -cross(rate), np.eye(3)
    error = (expm(drift * 9.0) @ np.concatenate([small, slow]))[:3]
    np.testing.assert_allclose(twin.attitude.rotation_vector_to(wrong.attitude), error, atol=3e-11)  # second order
