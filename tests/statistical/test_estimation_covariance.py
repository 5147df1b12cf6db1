"""Attitude errors of all estimators against their covariance."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.estimation import METHODS
from startracker.geometry.attitude import Attitude

ARCSEC = np.pi / 648000
TRIALS = 2000


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", ["field", "corner", "two", "unequal"])
def test_errors_have_the_covariance(method, case):
    rng = np.random.default_rng([3, len(case), len(method)])
    count = 2 if case == "two" else 7
    angles = rng.uniform(-0.08, 0.08, (count, 2))
    if case == "corner":
        angles = 0.08 + 0.1 * angles
    observed = np.column_stack([np.tan(angles), np.ones(count)])
    observed /= np.linalg.norm(observed, axis=1, keepdims=True)
    sigma = ARCSEC * (rng.uniform(2, 40, count) if case in ("unequal", "two") else np.full(count, 10.0))
    truth = Attitude.from_matrix(Rotation.random(rng=rng).as_matrix())
    reference = truth.inverse.apply(observed)
    expected = METHODS[method](observed, reference, sigma).covariance
    noise = rng.normal(size=(TRIALS, count, 3)) * sigma[:, None]
    noise -= (noise * observed).sum(axis=2, keepdims=True) * observed  # across the direction
    errors = np.empty((TRIALS, 3))
    for trial in range(TRIALS):
        found = METHODS[method](observed + noise[trial], reference, sigma).matrix
        errors[trial] = truth.rotation_vector_to(Attitude.from_matrix(found))
    # normalised errors: mean 0 ± 1/√N, variance 1 ± √(2/N), correlations 0 ± 1/√N; 4.5 of these for 9 numbers a case
    white = np.linalg.solve(np.linalg.cholesky(expected), errors.T)
    assert np.abs(white.mean(axis=1)).max() < 4.5 / np.sqrt(TRIALS)
    deviation = white @ white.T / TRIALS - np.eye(3)
    assert np.abs(np.diag(deviation)).max() < 4.5 * np.sqrt(2 / TRIALS)
    assert np.abs(deviation - np.diag(np.diag(deviation))).max() < 4.5 / np.sqrt(TRIALS)
