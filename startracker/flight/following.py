"""Constants of the tracking from frame to frame: prediction of the next attitude, and filter of the measured ones.

The filter is that of `startracker.tracking.mekf`, with attitudes as measurements: the error of the attitude and the
rate, or the bias of a gyro, under white angular acceleration; its innovations are monitored as in
`startracker.tracking.consistency`. An attitude that contradicts the prediction is rejected once; if the next one does
so as well, the filter restarts from it.

Angles of the filter are in units of 2⁻²⁰ rad (0.2″); the attitude is a quaternion of 2.30. The filter is
`c/tracker_following.c`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from startracker.errors import InputError
from startracker.flight.c_table import CTable
from startracker.flight.integers import Integers
from startracker.settings import TrackingSettings
from startracker.tracking.mekf import GyroNoise, RateNoise

FOLLOWING_MODULES = ("integers", "arithmetic", "linear", "directions", "attitude_filter", "following")
TIME_GOOD, TIME_BAD, TIME_SET_BACK = range(3)
"""Results of ``tracker_following_predict``: the time can be used; it cannot; the clock was set back, and the filter
forgotten."""
BEGUN, USED, DISTRUSTED, REJECTED, RESTARTED, COASTING = range(6)
"""Results of ``tracker_following_take``: the filter begins; the attitude was used; it was used after the uncertainty of
a contradicted filter was increased; it contradicts the prediction and was not used; the filter restarted from it. And
of a frame without an attitude: the filter only predicts."""
ANGLE_BITS = 20
"""Fraction bits of the angles of the filter, radians."""
RADIUS_BITS = 28
"""Fraction bits of the radius of a prior, radians."""
PSD_BITS, LIMIT_BITS = 20, 16
WINDOW = 32
"""Number of innovations that are monitored."""
_FALSE_ALARM, _TOO_SMALL = 1e-3, 0.99


class FollowingTables(NamedTuple):
    """Constants of the filter."""

    gyro: int
    """1 with a gyro, whose bias is the second state; 0: that is the rate."""
    angle_psd: int
    rate_psd: int
    extra_psd: int
    """White noise of the angle's derivative, of the second state's, and of the rate's without gyro samples, units²/s
    and units²/s³, 20 fraction bits."""
    sigma: int
    """Initial standard deviation of the second state, units/s."""
    gate: int
    """Limit of the squared distance of an innovation, 16 fraction bits."""
    limits: Integers
    """Limits of the sum of the squared distances of n innovations, 16 fraction bits, (33,)."""
    mean_limit: int
    too_small: int
    """Limit of the squared mean innovation times their number, and lower limit of the sum of a full window."""
    largest_radius: int
    """Largest radius of a prior that is given, radians of 28 fraction bits."""


def following_tables(
    noise: RateNoise | GyroNoise | None = None, settings: TrackingSettings | None = None
) -> FollowingTables:
    """Constants for the motion of the camera between frames.

    Raises
    ------
    InputError
        For noise above 0.1 rad/s in a second, or a gyro whose scale factors are to be estimated.
    """
    noise, settings = noise or RateNoise(), settings or TrackingSettings()
    if isinstance(noise, GyroNoise):
        if noise.scale_sigma > 0.0:
            raise InputError("a flight build does not estimate the scale factors of a gyro; use scale_sigma=0")
        psd = noise.angle_random_walk, noise.rate_random_walk, noise.acceleration
        sigma = noise.bias_sigma_rad_s
    else:
        psd, sigma = (0.0, noise.acceleration, 0.0), noise.rate_sigma_rad_s
    if max(psd) > 0.1:
        raise InputError(f"the noise of the motion must be at most 0.1 rad/s after a second; got {max(psd)}")
    angle, rate, extra = (round((value * 2.0**ANGLE_BITS) ** 2 * 2.0**PSD_BITS) for value in psd)
    one = 1 << LIMIT_BITS
    return FollowingTables(
        int(isinstance(noise, GyroNoise)),
        angle,
        rate,
        extra,
        round(sigma * 2.0**ANGLE_BITS),
        round(float(chdtri(3, settings.false_rejection)) * one),
        np.array([0] + [round(float(chdtri(3 * n, _FALSE_ALARM)) * one) for n in range(1, WINDOW + 1)]),
        round(float(chdtri(3, _FALSE_ALARM)) * one),
        round(float(chdtri(3 * WINDOW, _TOO_SMALL)) * one),
        round(np.radians(settings.prior_limit_deg) * (1 << RADIUS_BITS)),
    )


def following_constants(t: FollowingTables) -> dict[str, int]:
    """Macros of the exported tables."""
    return {
        "FOLLOWING_GYRO": t.gyro,
        "FOLLOWING_ANGLE_PSD": t.angle_psd,
        "FOLLOWING_RATE_PSD": t.rate_psd,
        "FOLLOWING_EXTRA_PSD": t.extra_psd,
        "FOLLOWING_SIGMA": t.sigma,
        "FOLLOWING_GATE": t.gate,
        "FOLLOWING_MEAN_LIMIT": t.mean_limit,
        "FOLLOWING_TOO_SMALL": t.too_small,
        "FOLLOWING_LARGEST_RADIUS": t.largest_radius,
        "FOLLOWING_WINDOW": WINDOW,
    }


def following_arrays(t: FollowingTables) -> list[CTable]:
    """Arrays of the exported tables."""
    return [CTable("int32_t", "following_limits", "chi-square limits of n innovations, 16 fraction bits", t.limits)]
