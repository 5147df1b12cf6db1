"""What a linear theory expects of an attitude loop on a star tracker: pointing and knowledge errors, and the NEES.

About a fixed attitude, with small errors θ (rotation vector, body axes) and rates ω, at the frames k of step h:

    plant     θ' = θ + h ω + h²/2 J⁻¹(u + d),  ω' = ω + h J⁻¹(u + d)
    tracker   y = θ + v, cov v = R; steady-state Kalman filter of θ and ω with white angular acceleration
    control   s += K h θ̂/4,  u = −K θ̂/4 − P ω̂ − P Kᵢ (s + J ω̂), on the filter's prediction from the frame before

which is Basilisk's ``mrpFeedback`` with σ = θ/4. The covariance of the closed loop solves its discrete Lyapunov
equation (Kwakernaak & Sivan 1972, *Linear Optimal Control Systems*, section 6.2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov
from scipy.stats import chi2

FloatArray = NDArray[np.float64]

I3, O3 = np.eye(3), np.zeros((3, 3))


class Loop(NamedTuple):
    """A spacecraft, its controller and the filter of its tracker."""

    inertia_kg_m2: FloatArray
    """(3, 3): Body axes."""
    attitude_gain: float
    rate_gain: float
    integral_gain: float
    """K, P and Kᵢ of ``mrpFeedback``, N m, N m s and 1/s."""
    step_s: float
    """Time between frames, and between commands."""
    acceleration: float
    """Process noise of the filter, rad/s/√s."""


class Expected(NamedTuple):
    """Steady state of the closed loop; covariances (3, 3) in body axes, rad²."""

    closed: FloatArray
    state: FloatArray
    """Transition matrix (15, 15) of (θ, ω, θ̂, ω̂, s) with the filter's prediction, and covariance of this state."""
    error: FloatArray
    next_error: FloatArray
    """(3, 15): The filter's error after a frame from the state before it; (15, 3): covariance of the next state with
    that error."""
    of_frame: FloatArray
    """R, of the attitude of a single frame."""
    pointing: FloatArray
    """Of θ at the frames."""
    knowledge: FloatArray
    """Of the filter's error after each frame."""
    stated: FloatArray
    """What the filter states of it, not knowing of the torques."""

    @property
    def nees(self) -> float:
        """Mean of eᵀ P⁻¹ e of the filter's error with its stated covariance; 3 for a filter that knows everything."""
        return float(np.trace(np.linalg.solve(self.stated, self.knowledge)))

    def pointing_limits(self, frames: int, chance: float) -> FloatArray:
        """Limits (2, 3) of the ratio of the mean square of θ over a number of frames to its expectation; each has a
        chance of being exceeded."""
        lags, power = [], self.state
        for _ in range(frames):
            lags.append(power[:3, :3])
            power = self.closed @ power
        single = [np.array([[c[k, k]] for c in lags])[:, :, None] for k in range(3)]
        return np.stack([_limits(c, np.linalg.inv(c[0]), chance) for c in single], axis=1)

    def nees_limits(self, frames: int, chance: float) -> FloatArray:
        """Limits (2,) of the ratio of the mean NEES over a number of frames to `nees`."""
        lags, power = [self.knowledge], self.next_error
        for _ in range(frames - 1):
            lags.append(self.error @ power)
            power = self.closed @ power
        return _limits(np.array(lags), np.linalg.inv(self.stated), chance)


def _limits(lags: FloatArray, weight: FloatArray, chance: float) -> FloatArray:
    """Limits (2,) of the mean of xᵀ W x over N steps of a Gaussian process, relative to its expectation.

    With the autocovariance C (N, n, n), the variance of the mean is 2/N² Σ Σ tr(W C(j−k) W C(j−k)ᵀ); its distribution
    is taken as χ² of the same mean and variance (Satterthwaite 1946, Biometrics Bulletin 2, 110).
    """
    number = len(lags)
    pairs = np.append(number, 2 * np.arange(number - 1, 0, -1))
    variance = 2.0 * float(pairs @ np.einsum("ij,kjl,lm,kim->k", weight, lags, weight, lags)) / number**2
    freedom = 2.0 * float(np.trace(weight @ lags[0])) ** 2 / variance
    return np.array([chi2.ppf(chance, freedom), chi2.isf(chance, freedom)]) / freedom


def frame_covariance(loop: Loop, before: FloatArray, after: FloatArray) -> FloatArray:
    """R (3, 3), rad², of the frame that took a filter's covariance (6, 6) from `before` to `after`: the difference of
    information, in the axes of both."""
    step, noise = _motion(loop)
    gained = np.linalg.inv(np.linalg.inv(after) - np.linalg.inv(step @ before @ step.T + noise))[:3, :3]
    return 0.5 * (gained + gained.T)


def _motion(loop: Loop) -> tuple[FloatArray, FloatArray]:
    """Transition and process noise of attitude and rate over a step, (6, 6)."""
    h = loop.step_s
    noise = loop.acceleration**2 * np.kron([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]], I3)
    return np.block([[I3, h * I3], [O3, I3]]), noise


def expected(loop: Loop, of_frame: FloatArray) -> Expected:
    """Steady state of a loop.

    Parameters
    ----------
    loop : Loop
        The loop.
    of_frame : array, shape (3, 3)
        R: of the attitude of a single frame, body axes, rad².
    """
    h, inverse = loop.step_s, np.linalg.inv(loop.inertia_kg_m2)
    seen = np.hstack([I3, O3])
    step, noise = _motion(loop)
    predicted = solve_discrete_are(step.T, seen.T, noise, of_frame)
    gain = predicted @ seen.T @ np.linalg.inv(seen @ predicted @ seen.T + of_frame)

    torque = np.hstack([I3 * loop.attitude_gain / 4.0, loop.rate_gain * (I3 + loop.integral_gain * loop.inertia_kg_m2)])
    summed = np.hstack([I3 * loop.attitude_gain * h / 4.0, O3])
    per_sum = loop.rate_gain * loop.integral_gain * I3
    pushed = np.vstack([h**2 / 2.0 * inverse, h * inverse])
    closed = np.block(
        [
            [step, -pushed @ (torque + per_sum @ summed), -pushed @ per_sum],
            [step @ gain @ seen, step @ (np.eye(6) - gain @ seen), np.zeros((6, 3))],
            [np.zeros((3, 6)), summed, I3],
        ]
    )
    if np.abs(np.linalg.eigvals(closed)).max() >= 1.0:
        raise ValueError("the loop is not stable: lower the gains of the controller")
    driven = np.vstack([np.zeros((6, 3)), step @ gain, O3])
    state = solve_discrete_lyapunov(closed, driven @ of_frame @ driven.T)
    blind = I3 - gain[:3]
    error = np.hstack([-blind, np.zeros((3, 3)), blind, np.zeros((3, 6))])
    knowledge = error @ state @ error.T + gain[:3] @ of_frame @ gain[:3].T
    following = closed @ state @ error.T + driven @ of_frame @ gain[:3].T
    return Expected(closed, state, error, following, of_frame, state[:3, :3], knowledge, blind @ predicted[:3, :3])
