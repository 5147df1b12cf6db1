"""Rates measured by a gyro: each term of the noise alone, with its unit (IEEE Std 952-1997)."""

import math

import numpy as np
import pytest

from simulator.mission.gyro import gyro_samples
from simulator.mission.parameters import Gyro

QUIET = {"angle_random_walk_deg_sqrt_h": 0.0, "bias_deg_h": 0.0, "bias_instability_deg_h": 0.0, "scale_factor_ppm": 0.0}
TURNS = np.tile([1e-3, -2e-3, 3e-3], (4000, 1))


def samples(turns=TURNS, step_s=0.2, seed=5, **noise):
    return gyro_samples(Gyro(**(QUIET | noise)), turns, step_s, np.random.default_rng(seed))


def test_a_gyro_without_noise_measures_the_mean_rate():
    found = samples(step_s=np.linspace(0.1, 0.5, len(TURNS)))
    assert found.rates_rad_s == pytest.approx(TURNS / np.linspace(0.1, 0.5, len(TURNS))[:, None])
    assert found.biases_rad_s.shape == (len(TURNS) + 1, 3)
    assert not found.biases_rad_s.any()
    assert not found.scale.any()


@pytest.mark.parametrize("step_s", [0.05, 5.0])
def test_white_noise_is_the_random_walk_over_the_root_of_the_step(step_s):
    """0.3 °/√h is 0.3 π/180/60 rad/√s; the angle over N steps is N √t. 4 σ of a standard deviation, 1/√(2 · 12,000)."""
    found = samples(step_s=step_s, angle_random_walk_deg_sqrt_h=0.3)
    noise = found.rates_rad_s - TURNS / step_s
    walk = math.radians(0.3) / 60.0
    assert noise.std() == pytest.approx(walk / math.sqrt(step_s), rel=4.0 / math.sqrt(2.0 * noise.size))
    assert abs(noise.mean()) < 4.0 * walk / math.sqrt(step_s * noise.size)


def test_the_constant_bias_is_drawn_once():
    """12 °/h: of 300 gyros with three axes each, 4 σ of a standard deviation, 1/√(2 · 900)."""
    biases = []
    for seed in range(300):
        found = samples(TURNS[:3], seed=seed, bias_deg_h=12.0)
        assert np.ptp(found.biases_rad_s, axis=0) == pytest.approx(0.0, abs=1e-18)
        assert found.rates_rad_s - TURNS[:3] / 0.2 == pytest.approx(found.biases_rad_s[:3], rel=1e-9)
        biases.append(found.biases_rad_s[0])
    assert np.std(biases) == pytest.approx(math.radians(12.0) / 3600.0, rel=4.0 / math.sqrt(2.0 * 900))


def test_the_varying_bias_has_its_deviation_and_its_time():
    """A first-order process: standard deviation 3 °/h from the first value on, correlation e^(−h/T) from step to step;
    the mean over a step is that of both ends. Over 1,000 gyros of 3 axes, 4 σ: 1/√(2 · 3,000) and √((1 − ρ²)/3,000)."""
    step_s, time_s, sigma = 60.0, 100.0, math.radians(3.0) / 3600.0
    runs = [samples(TURNS[:8], step_s, seed, bias_instability_deg_h=3.0, bias_time_s=time_s) for seed in range(1000)]
    biases = np.stack([run.biases_rad_s for run in runs]) / sigma
    rates = np.stack([run.rates_rad_s for run in runs]) - TURNS[:8] / step_s
    for k in (0, 1, 8):
        assert biases[:, k].std() == pytest.approx(1.0, rel=4.0 / math.sqrt(6000))
    rho = math.exp(-step_s / time_s)
    for k in (0, 4):
        found = float(np.mean(biases[:, k] * biases[:, k + 1]))
        assert found == pytest.approx(rho, abs=4.0 * math.sqrt((1.0 + rho**2) / 3000))
    assert rates == pytest.approx(0.5 * sigma * (biases[:, :-1] + biases[:, 1:]), rel=1e-9, abs=1e-18)


def test_scale_factors_are_constant_and_proportional():
    """5,000 ppm: of 300 gyros with three axes, 4 σ of a standard deviation."""
    runs = [samples(TURNS[:2], seed=seed, scale_factor_ppm=5000.0) for seed in range(300)]
    scales = np.array([run.scale for run in runs])
    assert scales.std() == pytest.approx(0.005, rel=4.0 / math.sqrt(2.0 * 900))
    for run in runs[:5]:
        assert run.rates_rad_s == pytest.approx((1.0 + run.scale) * TURNS[:2] / 0.2, rel=1e-12)


def test_white_noise_and_the_varying_bias_are_independent():
    """Of 4,000 steps of three axes: correlations within 4/√N. The bias changes by its own deviates."""
    found = samples(angle_random_walk_deg_sqrt_h=0.3, bias_instability_deg_h=30.0, bias_time_s=0.2)
    white = found.rates_rad_s - TURNS / 0.2 - 0.5 * (found.biases_rad_s[1:] + found.biases_rad_s[:-1])
    decay = math.exp(-1.0)
    driving = found.biases_rad_s[1:] - decay * found.biases_rad_s[:-1]
    correlation = np.mean(white * driving) / (white.std() * driving.std())
    assert abs(correlation) < 4.0 / math.sqrt(white.size)
    assert abs(np.corrcoef(white.T) - np.eye(3)).max() < 4.0 / math.sqrt(len(white))
