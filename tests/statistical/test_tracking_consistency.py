"""The filter is as wrong as it says: NEES of Monte Carlo runs within the bounds of χ².

The mean of n independent NEES of a state of m is χ²(n m)/n, of standard deviation √(2 m / n); runs are independent of
each other, and the last step of each is looked at. Five standard deviations are allowed: one seed in two million.
"""

import math

import numpy as np
import pytest
from star_sequences import turned

from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, Mekf, RateNoise

RUNS = 150


@pytest.mark.parametrize("rate", [0.0, 0.05])
@pytest.mark.parametrize(("with_gyro", "scale_sigma"), [(True, 0.0), (True, 0.01), (False, 0.0)])
def test_nees(rate, with_gyro, scale_sigma):
    """Bias and scale factors are drawn with the standard deviations that the filter is told."""
    rng = np.random.default_rng(11)
    dt, sigma, steps = 0.5, 5e-5, 25
    walk, drift, acceleration = 2e-5, 4e-6, 3e-5
    noise = GyroNoise(walk, drift, 1e-3, scale_sigma=scale_sigma) if with_gyro else RateNoise(acceleration, 1e-3)
    nees, innovations = [], []
    for _ in range(RUNS):
        truth = Attitude(rng.normal(size=4))
        w = rng.normal(size=3)
        w *= rate / np.linalg.norm(w)
        second = rng.normal(size=3) * 1e-3  # bias, or error of the rate
        scale = rng.normal(size=3) * scale_sigma
        r = np.diag([1.0, 1.0, 25.0]) * sigma**2
        twin = Mekf(turned(truth, rng.normal(size=3) * np.sqrt(np.diag(r))), r, noise, w if with_gyro else w - second)
        for _ in range(steps):
            if with_gyro:
                # the bias' mean over a step and its end, of a random walk: exact for small turns
                end = rng.normal(size=3) * drift * math.sqrt(dt)
                mean = 0.5 * end + rng.normal(size=3) * drift * math.sqrt(dt / 12.0)
                gyro = (1.0 + scale) * w + second + mean + rng.normal(size=3) * walk / math.sqrt(dt)
                second = second + end
                truth = turned(truth, w * dt)
                twin.predict(dt, gyro)
            else:
                end = rng.normal(size=3) * acceleration * math.sqrt(dt)
                mean = 0.5 * end + rng.normal(size=3) * acceleration * math.sqrt(dt / 12.0)
                truth = turned(truth, (w + mean) * dt)
                w = w + end
                twin.predict(dt)
            found = twin.update_attitude(turned(truth, rng.normal(size=3) * np.sqrt(np.diag(r))), r)
            innovations.append(found.distance2)
        error = np.concatenate(
            [twin.attitude.rotation_vector_to(truth), second - twin.bias_rad_s if with_gyro else w - twin.rate_rad_s]
        )
        nees.append(error @ np.linalg.solve(twin.covariance, error))
    assert abs(np.mean(nees) - 6.0) < 5.0 * math.sqrt(12.0 / RUNS)
    assert abs(np.mean(innovations) - 3.0) < 5.0 * math.sqrt(6.0 / len(innovations))
