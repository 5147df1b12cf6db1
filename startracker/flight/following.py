"""Tracking from frame to frame: prediction of the next attitude, and filter of the measured ones, in integers.

The filter is that of `startracker.tracking.mekf`, with attitudes as measurements: the error of the attitude and the
rate, or the bias of a gyro, under white angular acceleration; its innovations are monitored as in
`startracker.tracking.consistency`. An attitude that contradicts the prediction is rejected once; if the next one does
so as well, the filter restarts from it.

Angles of the filter are in units of 2⁻²⁰ rad (0.2″) and held in `Real` numbers; the attitude is a quaternion of 2.30.
The C source (`c/tracker_following.c`) performs the same operations in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from startracker.errors import InputError
from startracker.fixed_point.c_table import CTable
from startracker.fixed_point.formats import Integers
from startracker.flight.attitude_filter import (
    ANGLE_BITS,
    Matrix,
    Vector,
    correct,
    propagate,
    rotation_between,
    turned_quaternion,
)
from startracker.flight.directions import quaternion_of
from startracker.flight.pose import COVARIANCE_BITS
from startracker.flight.real import ONE, ZERO, Real
from startracker.settings import TrackingSettings
from startracker.tracking.mekf import GyroNoise, RateNoise

FOLLOWING_MODULES = ("integers", "arithmetic", "linear", "directions", "attitude_filter", "following")
TIME_GOOD, TIME_BAD, TIME_SET_BACK = range(3)
"""Results of `Following.predict`: the time can be used; it cannot; the clock was set back, and the filter forgotten."""
BEGUN, USED, DISTRUSTED, REJECTED, RESTARTED, COASTING = range(6)
"""Results of `Following.update`: the filter begins; the attitude was used; it was used after the uncertainty of a
contradicted filter was increased; it contradicts the prediction and was not used; the filter restarted from it. And of
a frame without an attitude: the filter only predicts."""
RADIUS_BITS = 28
"""Fraction bits of the radius of a prior, radians."""
PSD_BITS, LIMIT_BITS = 20, 16
WINDOW = 32
"""Number of innovations that are monitored."""
_FALSE_ALARM, _TOO_SMALL = 1e-3, 0.99
_LARGEST_FACTOR = Real(10**8)
_RAISE, _FADE = Real(10), Real(1, -8)
_PRIOR_SIGMAS = Real(5)
_LEAST_RADIUS = 468_509  # 0.1°
_USELESS = Real(1_647_099)  # π/2
_LONGEST_US = 10**11
_LEAST_STEP_US = 1000
_MOST_REJECTED = 1
_ONE = 1 << 30


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


class Innovation(NamedTuple):
    """Squared distance of a measurement from the prediction, and the whitened difference."""

    distance2: Real
    white: Vector


class Following:
    """Filter of successive attitudes.

    Parameters
    ----------
    tables : FollowingTables
    """

    def __init__(self, tables: FollowingTables) -> None:
        self.tables = tables
        self.time_us: int | None = None
        self._refused_us: int | None = None
        self._used_us: int | None = None
        self.noise_factor = ONE
        self._forget()

    def _forget(self) -> None:
        self.quaternion: list[int] | None = None
        self.covariance: Matrix = []
        self.rate, self.bias = [ZERO] * 3, [ZERO] * 3
        self._solved: tuple[int, list[int]] | None = None
        self._window: list[Innovation] = []
        self._rejected = 0

    # ------------------------------------------------------------------ prediction
    def predict(self, time_us: int, gyro: Sequence[int] | None = None) -> int:
        """Propagate to the middle of a frame's exposure.

        Parameters
        ----------
        time_us : int
            Microseconds of a uniform clock.
        gyro : three integers, optional
            Mean measured rate since the last frame, camera axes, rad/s of 2.30; ignored without a gyro.
        """
        status = self._check(time_us)
        if status == TIME_BAD:
            return status
        step_us = 0 if self.time_us is None or status == TIME_SET_BACK else time_us - self.time_us
        if status == TIME_SET_BACK:
            self._forget()
        self.time_us, self._refused_us = time_us, None
        if self.quaternion is None:
            return status
        if gyro is not None and self.tables.gyro:
            self.rate = [Real(int(gyro[k]), ANGLE_BITS - 30) - self.bias[k] for k in range(3)]
        if (
            step_us > _LONGEST_US
            or not self._propagate(step_us, gyro is not None)
            or not self._uncertainty() < _USELESS
        ):
            self._forget()
        return status

    def _check(self, time_us: int) -> int:
        if time_us == self._used_us:
            return TIME_BAD
        if self.time_us is None or time_us >= self.time_us:
            return TIME_GOOD
        before, self._refused_us = self._refused_us, time_us
        return TIME_SET_BACK if before is not None and before < time_us else TIME_BAD

    def _propagate(self, step_us: int, measured: bool) -> bool:
        t, factor = self.tables, self.noise_factor
        extra = 0 if measured and t.gyro else t.extra_psd
        psd = [factor * Real(value, -PSD_BITS) for value in (t.angle_psd, t.rate_psd, t.rate_psd + extra)]
        step = Real(step_us) / Real(1_000_000)
        assert self.quaternion is not None
        after = propagate(self.quaternion, self.covariance, self.rate, step, -1 if t.gyro else 1, psd)
        if after is None:
            return False
        self.quaternion, self.covariance = after
        return True

    def _uncertainty(self) -> Real:
        """Standard deviation of the attitude about all axes together."""
        return (self.covariance[0][0] + self.covariance[1][1] + self.covariance[2][2]).root()

    def prior(self) -> tuple[Integers, int]:
        """Predicted attitude (3, 3) of 2.30 and its largest error, radians of 28 fraction bits; radius 0: none."""
        if self.quaternion is None:
            return np.zeros((3, 3), np.int64), 0
        radius = (_PRIOR_SIGMAS * self._uncertainty()).integer(RADIUS_BITS - ANGLE_BITS)
        radius = max(radius, _LEAST_RADIUS)
        return matrix_of(self.quaternion), radius if radius <= self.tables.largest_radius else 0

    # ------------------------------------------------------------------ measurement
    def update(self, matrix: Integers, covariance: Integers) -> int:
        """Update with the attitude (3, 3) of 2.30 of the frame of the last `predict`, and its covariance (3, 3) in
        camera axes, square radians of 60 fraction bits."""
        assert self.time_us is not None
        measured = quaternion_of(matrix).tolist()
        noise = [[Real(int(value), 2 * ANGLE_BITS - COVARIANCE_BITS) for value in row] for row in covariance]
        if self.quaternion is None:
            self._begin(measured, noise, Real(self.tables.sigma))
            self.noise_factor = ONE
            self._mark(measured)
            return BEGUN
        result = USED
        innovation = self._compared(measured, noise)
        if innovation is not None and self._contradicts(innovation):
            self._alarm()
            self.covariance = [[_RAISE * value for value in row] for row in self.covariance]
            innovation = self._compared(measured, noise)
            result = DISTRUSTED
        if innovation is None:
            if self._rejected < _MOST_REJECTED:
                self._rejected += 1
                return REJECTED
            self._restart(measured, noise)
            self._mark(measured)
            return RESTARTED
        self._take(measured, noise)
        self._learn(innovation)
        self._mark(self.quaternion)
        return result

    def _mark(self, quaternion: list[int]) -> None:
        assert self.time_us is not None
        self._solved, self._used_us, self._rejected = (self.time_us, quaternion), self.time_us, 0

    def _begin(self, measured: list[int], noise: Matrix, sigma: Real) -> None:
        """Filter from one attitude and a standard deviation of the second state."""
        self.quaternion = measured
        self.covariance = [[noise[i][j] if i < 3 and j < 3 else ZERO for j in range(6)] for i in range(6)]
        for k in range(3, 6):
            self.covariance[k][k] = sigma * sigma

    def _compared(self, measured: list[int], noise: Matrix) -> Innovation | None:
        """Innovation of an attitude; None beyond the gate."""
        assert self.quaternion is not None
        outcome = correct(self.covariance, rotation_between(self.quaternion, measured), noise)
        if outcome is None or outcome.distance2 > Real(self.tables.gate, -LIMIT_BITS):
            return None
        return Innovation(outcome.distance2, outcome.white)

    def _take(self, measured: list[int], noise: Matrix) -> None:
        assert self.quaternion is not None
        outcome = correct(self.covariance, rotation_between(self.quaternion, measured), noise)
        assert outcome is not None
        self.covariance = outcome.covariance
        self.quaternion = turned_quaternion(self.quaternion, outcome.change[:3])
        for k in range(3):
            if self.tables.gyro:
                self.bias[k] = self.bias[k] + outcome.change[3 + k]
                self.rate[k] = self.rate[k] - outcome.change[3 + k]
            else:
                self.rate[k] = self.rate[k] + outcome.change[3 + k]

    # ------------------------------------------------------------------ monitoring
    def _contradicts(self, innovation: Innovation) -> bool:
        """Whether the recent innovations and one more contradict the filter."""
        recent = self._window[1:] if len(self._window) == WINDOW else self._window
        total, mean = innovation.distance2, list(innovation.white)
        for other in recent:
            total = total + other.distance2
            mean = [mean[k] + other.white[k] for k in range(3)]
        n = len(recent) + 1
        if n < 2:
            return False
        square = (mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]) / Real(n)
        too_far = total > Real(int(self.tables.limits[n]), -LIMIT_BITS)
        return too_far or square > Real(self.tables.mean_limit, -LIMIT_BITS)

    def _learn(self, innovation: Innovation) -> None:
        if len(self._window) == WINDOW:
            self._window.pop(0)
        self._window.append(innovation)
        self.noise_factor = self.noise_factor + _FADE * (ONE - self.noise_factor)
        total = ZERO
        for one in self._window:
            total = total + one.distance2
        too_small = total < Real(self.tables.too_small, -LIMIT_BITS)
        if len(self._window) == WINDOW and self.noise_factor > ONE and too_small:
            self._window = []
            self.noise_factor = max(ONE, self.noise_factor / _RAISE)

    def _alarm(self) -> None:
        """More noise of the process, and a new window."""
        self._window = []
        self.noise_factor = min(self.noise_factor * _RAISE, _LARGEST_FACTOR)

    def _restart(self, measured: list[int], noise: Matrix) -> None:
        """Restart; the difference to the last solved attitude limits the second state."""
        assert self._solved is not None
        assert self.time_us is not None
        if len(self._window) < WINDOW:
            self._alarm()
        self._window = []
        reference = self._solved[1]
        if self.tables.gyro:  # the rate is measured: the prediction bounds the bias
            assert self.quaternion is not None
            reference = self.quaternion
        away = rotation_between(reference, measured)
        angle = (away[0] * away[0] + away[1] * away[1] + away[2] * away[2]).root()
        step = Real(max(self.time_us - self._solved[0], _LEAST_STEP_US)) / Real(1_000_000)
        self._begin(measured, noise, max(Real(self.tables.sigma), angle / step))
        if not self.tables.gyro:
            self.rate = [ZERO] * 3

    # ------------------------------------------------------------------ result
    @property
    def attitude(self) -> Integers:
        """Attitude (3, 3) of 2.30 at the time of the last `predict`; zeros if there is none."""
        return np.zeros((3, 3), np.int64) if self.quaternion is None else matrix_of(self.quaternion)

    @property
    def attitude_covariance(self) -> Integers:
        """Its covariance (3, 3) in camera axes, square radians of 60 fraction bits."""
        bits = COVARIANCE_BITS - 2 * ANGLE_BITS
        return np.array([[value.integer(bits) for value in row[:3]] for row in self.covariance[:3]]).reshape(-1, 3)


def matrix_of(q: list[int]) -> Integers:
    """Matrix (3, 3) of 2.30 of a unit quaternion of 2.30, scalar last."""
    x, y, z, w = q
    return np.array(
        [
            [_ONE - ((y * y + z * z) >> 29), (x * y + z * w) >> 29, (x * z - y * w) >> 29],
            [(x * y - z * w) >> 29, _ONE - ((x * x + z * z) >> 29), (y * z + x * w) >> 29],
            [(x * z + y * w) >> 29, (y * z - x * w) >> 29, _ONE - ((x * x + y * y) >> 29)],
        ]
    )
