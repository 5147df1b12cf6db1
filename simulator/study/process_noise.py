"""Process noise with which a filter follows the motion of a sequence."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simulator.mission.gyro import DEG_H, DEG_SQRT_H
from simulator.mission.motion import MotionState
from simulator.optics.jitter_series import JitterMotion
from simulator.scenario.schema import SequenceSection
from startracker.tracking import GyroNoise, RateNoise

_LEAST_WALK = 1e-6
"""Minimum disturbance, rad/s/√s, assumed by the filter: a freely drifting body."""
_FEWEST_FOR_WALK = 8
_LAG_MARGIN = 3.0
"""Factor on a constant acceleration, which is not white noise, so that the lag of the filter is less than its σ."""


def process_noise(
    section: SequenceSection, states: Sequence[MotionState], shaking: Sequence[JitterMotion], exposure_s: float
) -> GyroNoise | RateNoise:
    """Process noise of the filter, from motion and jitter at the frames or from the gyro."""
    walk = section.rate_walk_deg_s_sqrt_s
    if walk == "auto":
        rates = np.array([state.rate_camera_rad_s for state in states])
        change = np.linalg.norm(np.diff(rates, axis=0), axis=1).max(initial=0.0) / section.step_s
        jitter = _jitter_walk(section, shaking, exposure_s)
        acceleration = max(_LEAST_WALK, _LAG_MARGIN * change * math.sqrt(section.step_s), jitter)
    else:
        acceleration = math.radians(walk)
    if not section.gyro.use:
        return RateNoise(acceleration, math.radians(section.rate_sigma_deg_s))
    gyro = section.gyro
    return GyroNoise(
        angle_random_walk=gyro.angle_random_walk_deg_sqrt_h * DEG_SQRT_H,
        rate_random_walk=gyro.bias_instability_deg_h * DEG_H * math.sqrt(2.0 / gyro.bias_time_s),
        bias_sigma_rad_s=max(math.hypot(gyro.bias_deg_h, gyro.bias_instability_deg_h) * DEG_H, 1e-9),
        acceleration=acceleration,
        scale_sigma=gyro.scale_factor_ppm * 1e-6,
    )


def _jitter_walk(section: SequenceSection, shaking: Sequence[JitterMotion], exposure_s: float) -> float:
    """White angular acceleration, rad/s/√s, equivalent to the second differences of the jitter angles.

    For an angle driven by a density q their variance is 2 q h³/3 at a step h.
    """
    angles = np.array([j.mean(exposure_s) for j in shaking])
    if len(angles) < _FEWEST_FOR_WALK:
        return 0.0
    variance = np.mean(np.diff(angles, 2, axis=0) ** 2, axis=0).max()
    return math.sqrt(1.5 * float(variance) / section.step_s**3)
