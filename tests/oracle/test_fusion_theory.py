"""The filter of several heads against Shuster and Oh's covariance, and against batch least squares.

Sources: Shuster & Oh 1981, J. Guidance and Control 4, 70 (covariance of an attitude from directions, P⁻¹ = Σ (1 − b
bᵀ)/σ²); a batch least-squares estimate of all states at all times, with discrete noise by Van Loan 1978 (IEEE Trans.
Automatic Control 23, 395) from scipy.linalg.expm, whose last state is that of a Kalman filter with the same data.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from two_heads import ALONG_X, ALONG_Z, ARCSEC, turned

from startracker.estimation import wahba_svd
from startracker.fusion import FusionFilter, Head
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise

RUNS = 3000
BODY = Attitude([0.2, -0.5, 0.3, 0.7], "icrs", "body")


def directions(rng, n, half_deg=8.0):
    xy = rng.uniform(-1, 1, size=(n, 2)) * math.tan(math.radians(half_deg))
    v = np.column_stack([xy, np.ones(n)])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def shuster_oh(vectors, sigma):
    return np.linalg.inv(sum((np.eye(3) - np.outer(b, b)) / sigma**2 for b in vectors))


@pytest.fixture(scope="module")
def two_heads():
    """Stars of both heads in their own axes and in the body's, with their standard errors."""
    rng = np.random.default_rng(4)
    seen, sigma = [directions(rng, 9), directions(rng, 6)], [5 * ARCSEC, 8 * ARCSEC]
    body = [mounting.inverse.apply(v) for mounting, v in zip((ALONG_Z, ALONG_X), seen, strict=True)]
    combined = np.linalg.inv(sum(np.linalg.inv(shuster_oh(v, s)) for v, s in zip(body, sigma, strict=True)))
    return seen, sigma, combined


def fuse(body, seen, sigma, rng=None):
    """Filter of both heads' attitudes at one time, each by Wahba's loss from its own stars."""
    fusion = FusionFilter([Head("a", ALONG_Z), Head("b", ALONG_X)], GyroNoise())
    for h, head in enumerate(fusion.heads):
        camera = head.mounting @ body
        observed = seen[h]
        if rng is not None:
            observed = observed + rng.normal(size=observed.shape) * sigma[h]
            observed = observed / np.linalg.norm(observed, axis=1, keepdims=True)
        found = wahba_svd(observed, camera.inverse.apply(seen[h]), np.full(len(observed), sigma[h]))
        fusion.add_attitude(h, 0.0, Attitude.from_matrix(found.matrix), shuster_oh(seen[h], sigma[h]))
    return fusion.estimate(0.0)


def test_covariance_of_two_heads_is_shuster_and_ohs(two_heads):
    seen, sigma, combined = two_heads
    found = fuse(BODY, seen, sigma).attitude_covariance
    np.testing.assert_allclose(found, combined, rtol=0, atol=1e-9 * np.trace(combined))
    # the weak axis of each head is a strong one of the other: all axes are as good as across a boresight
    across = max(np.linalg.eigvalsh(shuster_oh(v, s))[1] for v, s in zip(seen, sigma, strict=True))
    assert np.linalg.eigvalsh(found)[2] < across


def test_scatter_of_fused_attitudes_is_shuster_and_ohs(two_heads):
    """Sample covariances of N Gaussian errors scatter by √((Pii Pjj + Pij²)/N) (Wishart); five of them are allowed."""
    seen, sigma, combined = two_heads
    rng = np.random.default_rng(5)
    errors = np.array([BODY.rotation_vector_to(fuse(BODY, seen, sigma, rng).attitude) for _ in range(RUNS)])
    spread = np.sqrt((np.outer(np.diag(combined), np.diag(combined)) + combined**2) / RUNS)
    assert (np.abs(errors.T @ errors / RUNS - combined) < 5.0 * spread).all()


def cross(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def step_of(noise, rate, dt):
    """Transition and noise of (θ, b) over a step at a measured rate (Van Loan)."""
    drift = np.zeros((6, 6))
    drift[:3, :3], drift[:3, 3:] = -cross(rate), -np.eye(3)
    density = np.diag([noise.angle_random_walk**2] * 3 + [noise.rate_random_walk**2] * 3)
    big = expm(np.block([[-drift, density], [np.zeros((6, 6)), drift.T]]) * dt)
    phi = big[6:, 6:].T
    return phi, phi @ big[:6, 6:]


def least_squares(noise, heads, rate, times, nominal, seen, covariance):
    """Estimate and covariance of (θ, b) at the last time and of the alignment of head b: all times in one system.

    Errors refer to a nominal attitude with the measured rate; unknown are (θ, b) at each time, and the alignment.
    """
    n = 6 * len(times) + 3
    rows, right, weight = [], [], []

    def equation(matrix, value, spread):
        rows.append(matrix), right.append(value), weight.append(np.linalg.inv(spread))

    prior = np.zeros((6, n))
    prior[:3, 3:6], prior[3:, -3:] = np.eye(3), np.eye(3)
    equation(prior, np.zeros(6), np.diag([noise.bias_sigma_rad_s**2] * 3 + [heads[1].alignment_sigma_rad ** 2] * 3))
    for k in range(1, len(times)):
        phi, spread = step_of(noise, rate, times[k] - times[k - 1])
        matrix = np.zeros((6, n))
        matrix[:, 6 * k - 6 : 6 * k], matrix[:, 6 * k : 6 * k + 6] = -phi, np.eye(6)
        equation(matrix, np.zeros(6), spread)
    for k, h, z in seen:
        matrix = np.zeros((3, n))
        matrix[:, 6 * k : 6 * k + 3] = heads[h].mounting.as_matrix()
        if h == 1:
            matrix[:, -3:] = np.eye(3)
        equation(matrix, z, covariance[h])
    unit = 1e-6
    a, w = np.concatenate(rows) * unit, block_diag(*weight)
    inverse = np.linalg.inv(a.T @ w @ a)
    solution = unit * (inverse @ (a.T @ w @ np.concatenate(right)))
    return solution[-9:], unit**2 * inverse[-9:, -9:]


@pytest.mark.parametrize("late", [False, True])
def test_estimate_is_that_of_batch_least_squares(late):
    """Errors of 1e-6 rad: what the filter linearises is 1e-6 of σ; and the system of 129 unknowns, whose weights differ
    by 1e8, is solved to some 1e-7."""
    noise = GyroNoise(1e-7, 1e-8, 1e-6, scale_sigma=0.0)
    heads = [Head("a", ALONG_Z), Head("b", ALONG_X, 3e-6)]
    rng, rate = np.random.default_rng(6), np.array([0.02, -0.01, 0.03])
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 0.6, 20))])
    nominal = [BODY]
    for dt in np.diff(times):
        nominal.append(turned(nominal[-1], rate * dt))
    covariance = [np.diag([1.0, 2.0, 60.0]) * 1e-12, np.diag([3.0, 2.0, 90.0]) * 1e-12]
    # the heads measure the nominal attitude up to z; head a every time, b every second
    seen = [(k, h, rng.normal(size=3) * 2e-6) for k in range(len(times)) for h in (0, 1) if h == 0 or k % 2]
    fusion = FusionFilter(heads, noise)
    data = [(end, fusion.add_gyro, (start, end, rate * (end - start))) for start, end in pairwise(times)]
    data += [
        (times[k], fusion.add_attitude, (h, times[k], turned(heads[h].mounting @ nominal[k], z), covariance[h]))
        for k, h, z in seen
    ]
    order = rng.permutation(len(data)) if late else np.argsort([t_s for t_s, *_ in data], kind="stable")
    for i in order:
        _, add, given = data[i]
        add(*given)
    state, spread = least_squares(noise, heads, rate, times, nominal, seen, covariance)
    found = fusion.estimate(times[-1])
    sigma = np.sqrt(np.diag(spread))
    estimate = [nominal[-1].rotation_vector_to(found.attitude), found.bias_rad_s, found.alignment_rad(1)]
    np.testing.assert_allclose(np.concatenate(estimate) / sigma, state / sigma, rtol=0, atol=1e-5)
    kept, unit = np.r_[0:6, 9:12], np.outer(sigma, sigma)
    np.testing.assert_allclose(found.full_covariance[np.ix_(kept, kept)] / unit, spread / unit, rtol=0, atol=1e-5)
