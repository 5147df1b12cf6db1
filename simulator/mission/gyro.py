"""A three-axis gyro: measured rotation of the body from frame to frame."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simulator.mission.parameters import Gyro

FloatArray = NDArray[np.float64]

DEG_SQRT_H = math.radians(1.0) / 60.0
"""1 °/√h in rad/√s."""
DEG_H = math.radians(1.0) / 3600.0
"""1 °/h in rad/s."""


def gyro_samples(
    gyro: Gyro, turns_rad: FloatArray, step_s: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Measured mean rates over the steps of a sequence, and the true bias at their ends.

    measured = (1 + k) turn / step + mean bias + white noise of N / √step; k constant, drawn once; bias = constant +
    first-order Gauss–Markov process of standard deviation B and correlation time T, b' = e^(−h/T) b +
    B √(1 − e^(−2h/T)) w, with its mean over a step that of both ends. Terms and units of N and B are those of IEEE Std
    952-1997, annexes B and C.

    Parameters
    ----------
    gyro : Gyro
        Its noise.
    turns_rad : array, shape (N, 3)
        True rotation vector of each step in the gyro's axes, as integrated by a gyro with coning compensation.
    step_s : float
        Length of a step.
    rng : Generator
        Draws 9 + 6 N Gaussian deviates.

    Returns
    -------
    rates, biases : arrays, shape (N, 3) and (N + 1, 3)
        Rad/s; the first bias is that before the first step.
    """
    constant, wander = rng.standard_normal((2, 3))
    constant = constant * gyro.bias_deg_h * DEG_H
    spread = gyro.bias_instability_deg_h * DEG_H
    kept = math.exp(-step_s / gyro.bias_time_s)
    fresh = math.sqrt(-math.expm1(-2.0 * step_s / gyro.bias_time_s))
    biases = np.empty((len(turns_rad) + 1, 3))
    wander = wander * spread
    biases[0] = constant + wander
    noise = rng.standard_normal((len(turns_rad), 2, 3))
    for k in range(len(turns_rad)):
        wander = kept * wander + spread * fresh * noise[k, 0]
        biases[k + 1] = constant + wander
    white = gyro.angle_random_walk_deg_sqrt_h * DEG_SQRT_H / math.sqrt(step_s) * noise[:, 1]
    scale = 1.0 + gyro.scale_factor_ppm * 1e-6 * rng.standard_normal(3)
    return scale * turns_rad / step_s + 0.5 * (biases[:-1] + biases[1:]) + white, biases
