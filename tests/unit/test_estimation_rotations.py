"""Common parts of the estimators against plain sums: frames, covariances, Newton's last steps, the best pair."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.estimation.rotations import common_frame, covariance_of, most_telling_pair, polish


def stars(seed, count, half_deg):
    rng = np.random.default_rng(seed)
    xy = np.tan(np.radians(half_deg)) * rng.uniform(-1.0, 1.0, (count, 2))
    b = np.column_stack([xy, np.ones(count)])
    b = Rotation.random(random_state=seed).apply(b)
    return b / np.linalg.norm(b, axis=1, keepdims=True), rng.uniform(0.5, 3.0, count) * 1e-5, rng


@pytest.mark.parametrize("half_deg", [0.01, 5.0, 60.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_covariance_is_the_inverse_of_the_information(seed, half_deg):
    b, sigma, _ = stars(seed, 6, half_deg)
    information = np.einsum("n,nij->ij", sigma**-2.0, np.eye(3) - b[:, :, None] * b[:, None, :])
    expected = np.linalg.inv(information)
    # at 0.01° the plain sum has lost eight digits about the axis
    np.testing.assert_allclose(covariance_of(b, sigma), expected, rtol=1e-6 if half_deg > 1.0 else 0.05, atol=1e-22)


def test_the_common_frame_has_the_weighted_mean_axis_first():
    b, sigma, _ = stars(1, 6, 10.0)
    weight = sigma**-2.0
    frame = common_frame(b, weight)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    axis = weight @ b
    np.testing.assert_allclose(frame[0], axis / np.linalg.norm(axis))
    # directions on the other side count with the opposite sign: an axis, seen from the heaviest star
    sign = np.where(np.arange(6) % 2, -1.0, 1.0)
    heaviest = sign[np.argmax(weight)]
    np.testing.assert_allclose(common_frame(sign[:, None] * b, weight)[0], heaviest * frame[0], atol=1e-15)


@pytest.mark.parametrize("off_rad", [1e-6, 0.05, 0.25])
def test_the_last_steps_end_at_the_minimum(off_rad):
    """Wahba's cost has no gradient there; from there the attitude does not move."""
    b, sigma, rng = stars(2, 7, 20.0)
    weight = (sigma.min() / sigma) ** 2
    truth = Rotation.random(random_state=5)
    r = truth.inv().apply(b + 1e-4 * rng.normal(size=b.shape))
    r /= np.linalg.norm(r, axis=1, keepdims=True)
    start = Rotation.from_rotvec(off_rad * np.array([0.6, 0.0, 0.8])) * truth
    found = polish(start.as_matrix(), b, r, weight)
    gradient = weight @ np.cross(r @ found.T, b)
    assert np.abs(gradient).max() < 1e-14
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-13)
    assert (truth.inv() * Rotation.from_matrix(found)).magnitude() < 1e-3
    np.testing.assert_allclose(polish(found, b, r, weight), found, atol=1e-15)


@pytest.mark.parametrize("seed", range(6))
def test_the_best_pair_has_the_least_mean_square_error(seed):
    """The more accurate star gives two angles, the other one the rotation about it, with the sine of their angle:
    2 σ₁² + (σ₂² + σ₁² cos²) / sin²."""
    b, sigma, _ = stars(seed, 8, 15.0)
    best = np.inf
    for i in range(8):
        for j in range(8):
            if i == j or sigma[i] > sigma[j]:
                continue
            cosine = b[i] @ b[j]
            error2 = 2.0 * sigma[i] ** 2 + (sigma[j] ** 2 + sigma[i] ** 2 * cosine**2) / (1.0 - cosine**2)
            if error2 < best:
                best, expected = error2, (i, j)
    assert most_telling_pair(b, sigma) == expected
