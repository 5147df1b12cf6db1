"""Statistics of a sequence, and the gyro's noise, against what is known of them in closed form."""

import math

import numpy as np
import pytest

from simulator.mission.gyro import DEG_H, DEG_SQRT_H, gyro_samples
from simulator.mission.parameters import Gyro
from simulator.study.intervals import effective_number
from simulator.study.sequence.statistics import longest_run, nees_test


@pytest.mark.parametrize(("text", "longest"), [("", 0), ("...", 0), ("##.#", 2), (".###", 3), ("#.####.##", 4)])
def test_longest_run(text, longest):
    assert longest_run(np.array([c == "#" for c in text], dtype=bool)) == longest


def test_effective_number_of_a_first_order_process():
    """x' = φ x + w: N (1 − φ)/(1 + φ). The estimate of Σρ scatters by some 2 √(2 M/N) of itself, M = 1/(1 − φ) lags."""
    rng = np.random.default_rng(3)
    n, phi = 40_000, 0.8
    x = np.empty(n)
    x[0] = rng.normal()
    for k in range(1, n):
        x[k] = phi * x[k - 1] + math.sqrt(1 - phi**2) * rng.normal()
    expected = n * (1 - phi) / (1 + phi)
    assert abs(effective_number(x) / expected - 1.0) < 5 * 2 * math.sqrt(2 * 5 / n)
    assert effective_number(rng.normal(size=2000)) > 1800


def test_nees_bounds_hold_what_they_say():
    """Means of 50 χ²(3): of 2000 of them 95 % within, to 4 √(0.05 · 0.95 / 2000) = 2 %; a wrong σ is told."""
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(2000):
        values = rng.chisquare(3, 50)
        low, high = nees_test(np.full(50, values.mean()))["bounds95"]  # no variance: all 50 count
        inside += low <= values.mean() <= high
    assert abs(inside / 2000 - 0.95) < 0.02
    assert not nees_test(2.0 * rng.chisquare(3, 200))["within"]
    assert nees_test(np.array([np.nan]))["mean"] is None


def test_gyro_noise():
    """White noise N/√dt and a bias of standard deviation B and correlation time T: k σ/√n with k = 5."""
    section = Gyro(angle_random_walk_deg_sqrt_h=0.3, bias_deg_h=0.0, bias_instability_deg_h=20.0, bias_time_s=5.0)
    n, dt = 20_000, 0.5
    rates, biases, _ = gyro_samples(section, np.tile([0.01, 0.0, -0.02], (n, 1)), dt, np.random.default_rng(4))
    white = rates - np.array([0.02, 0.0, -0.04]) - 0.5 * (biases[1:] + biases[:-1])
    sigma = 0.3 * DEG_SQRT_H / math.sqrt(dt)
    assert np.allclose(white.std(axis=0), sigma, rtol=5 / math.sqrt(2 * n), atol=0)
    assert np.allclose(white.mean(axis=0), 0.0, atol=5 * sigma / math.sqrt(n))
    independent = n * dt / (2 * 5.0)
    spread = 20.0 * DEG_H
    assert np.allclose(np.mean(biases**2, axis=0) / spread**2, 1.0, atol=5 * math.sqrt(2 / independent))
    lagged = np.mean(biases[10:] * biases[:-10]) / np.mean(biases**2)  # one correlation time later: 1/e
    assert abs(lagged - math.exp(-1.0)) < 5 / math.sqrt(3 * independent)
    # 1 °/√h over an hour is 1°, 1 °/h over an hour is 1°
    assert DEG_SQRT_H * math.sqrt(3600.0) == pytest.approx(math.radians(1.0))
    assert DEG_H * 3600.0 == pytest.approx(math.radians(1.0))
