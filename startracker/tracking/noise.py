"""Process noise of the filters: the errors of a gyro, or the motion of a body without one."""

from __future__ import annotations

import math
from dataclasses import dataclass

from startracker.arguments import real_number


@dataclass(frozen=True)
class GyroNoise:
    """Errors of a gyro, equal for each axis: measured rate = (1 + scale factor error) rate + bias + white noise.

    Parameters
    ----------
    angle_random_walk : float
        White noise of the rate, rad/√s (1 °/√h is 2.9e-4 rad/√s).
    rate_random_walk : float
        Random walk of the bias, rad/s/√s.
    bias_sigma_rad_s : float
        Initial standard deviation of the bias.
    acceleration : float
        Disturbance of the rate without gyro samples, rad/s/√s.
    scale_sigma : float
        Standard deviation of the constant scale factor error, which is estimated: 0.01 is 1 %. A clock rate error has
        the same effect. 0: the scale factors are not estimated.
    """

    angle_random_walk: float = 3e-5
    rate_random_walk: float = 1e-7
    bias_sigma_rad_s: float = 1e-3
    acceleration: float = 1e-3
    scale_sigma: float = 0.01

    def __post_init__(self) -> None:
        _check_positive(self)


@dataclass(frozen=True)
class RateNoise:
    """Motion without a gyro: a constant rate, disturbed by white angular acceleration.

    Parameters
    ----------
    acceleration : float
        Disturbance, rad/s/√s: standard deviation of the rate one second after it was known. 1e-5 is suitable for a
        freely drifting body, 1e-3 for a slew.
    rate_sigma_rad_s : float
        Initial standard deviation of the rate about each axis.
    """

    acceleration: float = 1e-4
    rate_sigma_rad_s: float = math.radians(2.0)

    def __post_init__(self) -> None:
        _check_positive(self)


def _check_positive(noise: object) -> None:
    for name, value in vars(noise).items():
        real_number(f"{type(noise).__name__}.{name}", value, least=0.0)
