"""Wahba's problem against SciPy's `Rotation.align_vectors` (scipy ≥ 1.14), and the thesis' accuracy of a star pair.

SciPy solves the same least squares by its own SVD (Kabsch): the two agree to rounding, 1e-16 over the squared extent of
the field. Its sensitivity matrix times the measurement's variance is the same covariance to first order
in the noise, hence the agreement to a part in a thousand at 1e-5 rad.

Greyling 1995, eq. 5.13: 0.0458° for stars 10° apart along both axes, 7.62° for three pixels (0.06°), and 1.6° for the
specification of 0.286°, all for positions accurate to 0.002°. The full digits, 0.0458, 7.628 and 1.6027, are the
equation's own; the thesis prints 7.62 and 1.6.
"""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from startracker.estimation import METHODS, pitch_error_deg, wahba_svd


@pytest.mark.parametrize("method", ["svd", "davenport", "quest", "esoq2"])
@pytest.mark.parametrize("half_width", [0.05, 0.5, 3.0])
def test_align_vectors(method, half_width):
    rng = np.random.default_rng(int(half_width * 100))
    for count in (2, 3, 5, 30):
        for truth in Rotation.random(10, rng=rng):
            observed = np.column_stack([rng.uniform(-half_width, half_width, (count, 2)), np.ones(count)])
            observed /= np.linalg.norm(observed, axis=1, keepdims=True)
            reference = truth.inv().apply(observed)
            sigma = rng.uniform(1e-5, 1e-3, count)
            noisy = observed + sigma[:, None] * rng.normal(size=(count, 3))
            noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
            twin = Rotation.align_vectors(noisy, reference, sigma**-2)[0].as_matrix()
            extent = np.linalg.norm(noisy - noisy.mean(axis=0), axis=1).max()
            assert np.abs(METHODS[method](noisy, reference, sigma).matrix - twin).max() < 1e-13 / extent**2


def test_sensitivity_of_align_vectors():
    rng = np.random.default_rng(3)
    observed = np.column_stack([rng.uniform(-0.1, 0.1, (15, 2)), np.ones(15)])
    observed /= np.linalg.norm(observed, axis=1, keepdims=True)
    sigma = 1e-5
    noisy = observed + sigma * rng.normal(size=observed.shape)
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    weights = np.full(15, 1 / 15)
    _, _, sensitivity = Rotation.align_vectors(noisy, observed, weights, return_sensitivity=True)
    # SciPy's notes: the covariance is the sensitivity times the (harmonic mean) variance of an observation
    twin = sensitivity * sigma**2
    found = wahba_svd(noisy, observed, np.full(15, sigma)).covariance
    assert np.allclose(found, twin, rtol=1e-3, atol=1e-3 * np.abs(twin).min())


def test_pitch_accuracy_of_the_thesis():
    assert float(pitch_error_deg(10, 10, 0.002)) == pytest.approx(0.0458, abs=5e-5)
    assert float(pitch_error_deg(0.06, 0.06, 0.002)) == pytest.approx(7.628, abs=5e-4)
    needed = brentq(lambda side: float(pitch_error_deg(side, side, 0.002)) - 0.286, 0.1, 10)
    assert needed == pytest.approx(1.6027, abs=5e-5)
