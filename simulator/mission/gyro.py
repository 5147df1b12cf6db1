"""A three-axis gyro: measured rotation of the body from frame to frame."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.parameters import Gyro
from startracker.core import FloatArray

DEG_SQRT_H = math.radians(1.0) / 60.0
"""1 °/√h in rad/√s."""
DEG_H = math.radians(1.0) / 3600.0
"""1 °/h in rad/s."""


class GyroSamples(NamedTuple):
    """Measurements of a gyro, and its errors."""

    rates_rad_s: FloatArray
    """(N, 3): Measured mean rates over the steps."""
    biases_rad_s: FloatArray
    """(N + 1, 3): True bias, the first one before the first step."""
    scale: FloatArray
    """(3,): Error of the scale factors, 0.01 is 1 %."""


def gyro_samples(gyro: Gyro, turns_rad: FloatArray, step_s: ArrayLike, rng: np.random.Generator) -> GyroSamples:
    """Measured mean rates over the steps of a sequence, and the true bias at their ends.

    The measured rate is (1 + k) turn / step + mean bias + white noise of standard deviation N / √step, with a constant
    scale-factor error k. The bias is the sum of a constant and a first-order Gauss–Markov process of standard deviation
    B and correlation time T, b' = e^(−h/T) b + B √(1 − e^(−2h/T)) w; its mean over a step of length h is the mean of
    both ends. Terms and units of N and B are as in IEEE Std 952-1997, annexes B and C.

    Parameters
    ----------
    gyro : Gyro
        Its noise.
    turns_rad : array, shape (N, 3)
        True rotation vector of each step in the gyro's axes, as integrated by a gyro with coning compensation.
    step_s : float or array, shape (N,)
        Length of the steps.
    rng : Generator
        Draws 9 + 6 N Gaussian deviates.

    """
    # The order of the draws is fixed: it defines the random numbers of recorded results.
    constant, wander = rng.standard_normal((2, 3))
    constant = constant * gyro.bias_deg_h * DEG_H
    spread = gyro.bias_instability_deg_h * DEG_H
    steps = np.broadcast_to(np.asarray(step_s, dtype=float), len(turns_rad)).tolist()
    biases = np.empty((len(turns_rad) + 1, 3))
    wander = wander * spread
    biases[0] = constant + wander
    noise = rng.standard_normal((len(turns_rad), 2, 3))
    for k, h in enumerate(steps):
        # Exact discretisation of the Gauss–Markov process: its variance is B² at every step of any length.
        decay, drive = math.exp(-h / gyro.bias_time_s), math.sqrt(-math.expm1(-2.0 * h / gyro.bias_time_s))
        wander = decay * wander + spread * drive * noise[k, 0]
        biases[k + 1] = constant + wander
    length = np.array(steps)[:, None]
    white = gyro.angle_random_walk_deg_sqrt_h * DEG_SQRT_H / np.sqrt(length) * noise[:, 1]
    scale = 1.0 + gyro.scale_factor_ppm * 1e-6 * rng.standard_normal(3)
    rates = scale * turns_rad / length + 0.5 * (biases[:-1] + biases[1:]) + white
    return GyroSamples(rates, biases, scale - 1.0)
