"""Multiplicative extended Kalman filter of the attitude, with bias and scale factors of a gyro, or with the rate.

The attitude is a quaternion; the filter estimates its error, a rotation vector in camera axes, which is applied to the
quaternion and reset to zero after every measurement. The covariance is therefore never singular, and refers to camera
axes.

Sources: Lefferts, Markley & Shuster 1982, J. Guidance 5, 417; Markley 2003, J. Guidance 26, 311; the process noise is
Farrenkopf's (1978, J. Guidance and Control 1, 282).
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from startracker.arguments import ABOVE_0, of_kind, real_array, real_number
from startracker.core import FloatArray
from startracker.display import angle_text, described, fields_repr
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, quat_multiply, quat_to_matrix
from startracker.tracking.checked import checked_attitude, checked_covariance, checked_rate
from startracker.tracking.kinematics import correct, propagate, turn_quaternion, vector_measurement
from startracker.tracking.noise import GyroNoise, RateNoise

_LINEAR_RAD = 3e-4
"""Maximum correction, rad, with a linearisation error of 0.01″; larger ones are iterated."""
_MOST_PASSES = 4
__all__ = ["GyroNoise", "Innovation", "Mekf", "RateNoise", "chi_square_limit", "rotation_between"]

_NO_TURN = np.zeros(3)
_BIAS_SIGMAS = 6.0
_LARGEST_SCALE = 0.5
"""Maximum error of a gyro's scale factor; at −1 it would measure nothing."""


@dataclass(frozen=True)
class Innovation:
    """Comparison of a measurement with the prediction."""

    accepted: bool
    """Whether it was within the gate and used."""
    distance2: float
    """νᵀ S⁻¹ ν, χ²-distributed with `freedom` degrees of freedom if filter and sensor are as assumed."""
    freedom: int
    """Number of measured components of the attitude error: 3, or 2 for a single star."""
    whitened: FloatArray | None = field(default=None, compare=False)
    """Whitened innovation in camera axes, (3,): three independent Gaussian deviates of variance 1 if filter and sensor
    are as assumed, and independent of those of other frames (Kailath 1968, IEEE Trans. Automatic Control 13, 646). None
    for a single star."""

    __repr__ = fields_repr


class Mekf:
    """The filter.

    Parameters
    ----------
    attitude : Attitude
        Initial attitude, ICRS to camera.
    covariance : array_like, shape (3, 3)
        Of its error's rotation vector in camera axes, rad².
    noise : GyroNoise or RateNoise
        Noise of the process, which selects the filter with or without a gyro.
    rate_rad_s : array_like, shape (3,), optional
        Initial rate of the camera in its own axes; zero if not known.
    """

    _target = "camera"
    """The frame whose attitude is estimated."""

    def __init__(
        self,
        attitude: Attitude,
        covariance: ArrayLike,
        noise: GyroNoise | RateNoise | None = None,
        rate_rad_s: ArrayLike | None = None,
    ) -> None:
        self.noise = RateNoise() if noise is None else of_kind("noise", noise, (GyroNoise, RateNoise))
        self.has_gyro = isinstance(self.noise, GyroNoise)
        self.noise_factor = 1.0
        """Factor on the variances of the process noise."""
        self._bias_variance = self.noise.bias_sigma_rad_s**2 if isinstance(self.noise, GyroNoise) else math.inf
        """Variance that the stated noise allows the bias to have by now, rad²/s²."""
        self._bias = np.zeros(3)
        self._scale = np.zeros(3)
        self._rate = np.zeros(3)
        self.reset(attitude, covariance, rate_rad_s)

    def __repr__(self) -> str:
        sigma = angle_text(math.sqrt(float(np.diag(self._covariance)[:3].max())))
        rate = f"{math.degrees(math.hypot(*self.rate_rad_s.tolist())):.3g}°/s"
        return described("Mekf", repr(self.attitude), f"σ {sigma}", rate, "gyro" if self.has_gyro else "no gyro")

    def reset(
        self,
        attitude: Attitude,
        covariance: ArrayLike,
        rate_rad_s: ArrayLike | None = None,
        second_sigma_rad_s: float | None = None,
    ) -> None:
        """Restart; estimated bias and scale factors are kept, with their initial uncertainty.

        Parameters
        ----------
        second_sigma_rad_s : float, optional
            Standard deviation of the rate or the bias, instead of that of the noise.

        Raises
        ------
        InputError
            For an attitude between other frames, a covariance that is not symmetric and positive definite, or a rate
            that is not three finite numbers. The filter is as before.
        """
        block = checked_covariance(covariance)
        attitude = checked_attitude(attitude, "icrs", self._target)
        rate = None if rate_rad_s is None else checked_rate(rate_rad_s, "rate_rad_s")
        if second_sigma_rad_s is not None:
            second_sigma_rad_s = real_number("second_sigma_rad_s", second_sigma_rad_s, least=0.0)
        self._quat, self._matrix_of = np.array(attitude.quat), np.empty(0)
        noise = self.noise
        usual = noise.bias_sigma_rad_s if isinstance(noise, GyroNoise) else noise.rate_sigma_rad_s
        sigma = usual
        if second_sigma_rad_s is not None:
            sigma = real_number("second_sigma_rad_s", second_sigma_rad_s, least=0.0)
        scale = noise.scale_sigma if isinstance(noise, GyroNoise) else 0.0
        variances = [0.0, sigma**2, scale**2] if scale > 0.0 else [0.0, sigma**2]
        self._covariance = np.diag(np.repeat(variances, 3))
        self._covariance[:3, :3] = block
        if rate is not None:
            self._rate = rate

    def copy(self) -> Self:
        """An independent filter with the same state."""
        return copy(self)  # arrays are replaced by every step, never modified

    def distrust(self, factor: float) -> None:
        """Multiply the covariance of the state by `factor`, to reduce the weight of past measurements."""
        self._covariance = self._covariance * real_number("factor", factor, least=ABOVE_0)

    def doubt(self, sigma_rad: float, sigma_rad_s: float) -> None:
        """Increase the uncertainty of the attitude, and of the bias or the rate, by errors of these standard
        deviations, and that of the scale factors by their stated one."""
        added = np.zeros(len(self._covariance))
        added[:3], added[3:6] = sigma_rad**2, sigma_rad_s**2
        if isinstance(self.noise, GyroNoise):
            added[6:9] = self.noise.scale_sigma**2
        self._covariance = self._covariance + np.diag(added)

    # ------------------------------------------------------------------ state
    @property
    def attitude(self) -> Attitude:
        """ICRS to camera."""
        return Attitude(self._quat)

    @property
    def quat(self) -> FloatArray:
        """The attitude as a quaternion (4,), scalar last."""
        return self._quat

    @property
    def matrix(self) -> FloatArray:
        """The attitude as a matrix (3, 3)."""
        if self._matrix_of is not self._quat:  # replaced by every step
            self._matrix_of, self._matrix = self._quat, quat_to_matrix(self._quat)
        return self._matrix

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the attitude error (rotation vector, camera axes) and of the bias or the rate, (6, 6), rad and
        rad/s."""
        return self._covariance[:6, :6].copy()

    @property
    def attitude_covariance(self) -> FloatArray:
        """Covariance of the attitude error in camera axes, (3, 3), rad²."""
        return np.ascontiguousarray(self._covariance[:3, :3])

    @property
    def uncertainty_rad(self) -> float:
        """Standard deviation of the attitude about all axes together."""
        return math.sqrt(sum(self._covariance.diagonal()[:3].tolist()))

    @property
    def rate_rad_s(self) -> FloatArray:
        """Rate of the camera in its own axes (3,): estimated, or measured minus the bias."""
        return self._rate.copy()

    @property
    def bias_rad_s(self) -> FloatArray:
        """Bias of the gyro (3,); zero without one."""
        return self._bias.copy()

    @property
    def bias_excess(self) -> float:
        """Estimated bias of the gyro, relative to the largest one that its stated noise explains (6 σ, of which one of
        10⁸ is beyond). Above 1, stars and gyro contradict each other: the picture may be frozen while the body
        rotates, or the gyro be wrong."""
        allowed = self._bias_variance + self._covariance.diagonal()[3:6]
        return float(np.max(np.abs(self._bias) / np.sqrt(allowed))) / _BIAS_SIGMAS if self.has_gyro else 0.0

    @property
    def scale(self) -> FloatArray:
        """Errors of the gyro's scale factors (3,); zero if not estimated."""
        return self._scale.copy()

    @property
    def scale_sigma(self) -> FloatArray:
        """Standard deviations of the scale factors, (3,)."""
        return np.sqrt(self._covariance.diagonal()[6:9]) if len(self._covariance) > 6 else np.zeros(3)

    # ------------------------------------------------------------------ the two steps
    def predict(self, dt: float, gyro_rad_s: ArrayLike | None = None) -> None:
        """Propagate by `dt` seconds.

        Parameters
        ----------
        dt : float
            Seconds, not negative.
        gyro_rad_s : array_like, shape (3,), optional
            Mean measured rate over the step, camera axes. Without a sample, a filter with a gyro keeps the last rate
            and increases the uncertainty by `GyroNoise.acceleration`; a filter without a gyro accepts none.

        Raises
        ------
        InputError
            For a negative step, or a rate that is not three finite numbers.
        """
        dt = real_number("a step forward in time", dt, least=0.0)
        if isinstance(self.noise, GyroNoise):
            sign, angle, rate = -1.0, self.noise.angle_random_walk**2, self.noise.rate_random_walk**2
            extra = 0.0 if gyro_rad_s is not None else self.noise.acceleration**2
            if gyro_rad_s is not None:
                self._rate = (checked_rate(gyro_rad_s, "a gyro's rate") - self._bias) / (1.0 + self._scale)
            self._bias_variance += rate * dt
        else:
            sign, angle, rate, extra = 1.0, 0.0, self.noise.acceleration**2, 0.0
            if gyro_rad_s is not None:
                raise InputError("this filter has no gyro: create it with GyroNoise, or omit gyro_rad_s")
        factor = self.noise_factor
        self._quat, self._covariance = propagate(
            self._quat, self._covariance, self._rate, dt, sign, factor * angle, factor * rate, factor * extra
        )

    def update_attitude(
        self, attitude: Attitude | ArrayLike, covariance: ArrayLike, false_rejection: float = 0.0
    ) -> Innovation:
        """Update with a measured attitude.

        Parameters
        ----------
        attitude : Attitude or array_like (3, 3)
            ICRS to camera.
        covariance : array_like, shape (3, 3)
            Of its error in camera axes, rad².
        false_rejection : float
            Probability of rejecting a correct measurement, which defines the gate on χ². 0: no gate.
        """
        if not isinstance(attitude, Attitude):
            attitude = Attitude.from_matrix(real_array("attitude", attitude, (3, 3)), target=self._target)
        measured, limit = checked_attitude(attitude, "icrs", self._target), _probability(false_rejection)
        return self.update_quat(measured.quat, checked_covariance(covariance), limit)

    def update_quat(self, quat: FloatArray, covariance: FloatArray, false_rejection: float) -> Innovation:
        """`update_attitude` with a quaternion (4,) and a contiguous covariance (3, 3) that need no check."""
        outcome = correct(self._covariance, np.eye(3), rotation_between(self._quat, quat), covariance)
        return self._take(outcome, chi_square_limit(3, false_rejection), 3)

    def update_vectors(
        self, observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike, false_rejection: float = 0.0
    ) -> Innovation:
        """Update with one or more star directions.

        A large correction is iterated, with linearisation about its result (iterated filter, Jazwinski 1970).

        Parameters
        ----------
        observed, reference : array_like, shape (M, 3)
            Unit vectors in the camera and in ICRS.
        sigma_rad : array_like, shape (M,)
            Standard error of a direction on one axis.
        """
        b = np.ascontiguousarray(np.atleast_2d(real_array("observed", observed)))
        r = np.ascontiguousarray(np.atleast_2d(real_array("reference", reference)))
        if b.shape != r.shape or b.shape[1:] != (3,):
            raise InputError(f"directions must both have the shape (M, 3); got {b.shape} and {r.shape}")
        given = real_array("sigma_rad", sigma_rad)
        if given.shape != (len(b),) and given.size != 1:
            raise InputError(f"{len(b)} directions need as many standard errors, or one; got {given.shape}")
        sigma = np.ascontiguousarray(np.broadcast_to(given.reshape(-1), (len(b),)))
        if not (len(b) and (sigma > 0.0).all()):
            raise InputError("a filter needs at least one direction, each with a positive standard error")
        return self.update_stars(b, r, sigma, _probability(false_rejection))

    def update_stars(
        self,
        observed: FloatArray,
        reference: FloatArray,
        sigma_rad: FloatArray,
        false_rejection: float,
        common_rad2: FloatArray | None = None,
    ) -> Innovation:
        """`update_vectors` with contiguous arrays (M, 3), (M, 3), (M,) that need no check; M is at least 1.

        `common_rad2` is the covariance (3, 3) of a rotation by an error common to all directions.
        """
        delta, before = _NO_TURN, (0.0, 0.0, 0.0)
        for _ in range(_MOST_PASSES):
            axes, innovation, noise = vector_measurement(self._quat, delta, observed, reference, sigma_rad)
            if common_rad2 is not None:
                noise = noise + axes @ common_rad2 @ axes.T
            outcome = correct(self._covariance, axes, innovation, noise)
            delta = outcome[1][:3]
            x, y, z = delta.tolist()
            moved = max(abs(x - before[0]), abs(y - before[1]), abs(z - before[2]))
            before = x, y, z
            if moved < _LINEAR_RAD:
                break
        return self._take(outcome, chi_square_limit(len(innovation), false_rejection), len(innovation))

    def _take(
        self, outcome: tuple[float, FloatArray, FloatArray, FloatArray], limit: float, freedom: int
    ) -> Innovation:
        """Apply a correction to the state if it is within the gate."""
        distance, change, covariance, white = outcome
        within, whitened = distance <= limit, white if freedom == 3 else None
        innovation = Innovation(accepted=within, distance2=distance, freedom=freedom, whitened=whitened)
        if not innovation.accepted:
            return innovation
        self._covariance = covariance
        self._quat = turn_quaternion(self._quat, change[:3])
        if self.has_gyro:
            self._bias = self._bias + change[3:6]
            self._rate = self._rate - change[3:6]
            if len(change) > 6:
                scale = change[6:9]
                self._rate = self._rate - self._rate * scale
                self._scale = np.maximum(np.minimum(self._scale + scale, _LARGEST_SCALE), -_LARGEST_SCALE)
        else:
            self._rate = self._rate + change[3:6]
        return innovation


def rotation_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Rotation vector (3,) from one attitude to another, quaternions (4,), in the axes of the first one's frame."""
    x, y, z, w = quat_multiply(second, first * np.array([-1.0, -1.0, -1.0, 1.0]))
    vector = np.array([x, y, z]) * (1.0 if w >= 0 else -1.0)
    sine = math.sqrt(float(vector @ vector))
    vector *= 2.0 * math.atan2(sine, abs(float(w))) / sine if sine > 0 else 2.0
    return vector


@lru_cache(maxsize=64)
def chi_square_limit(freedom: int, probability: float) -> float:
    """Value that χ² exceeds with a probability; infinite for probability 0."""
    return math.inf if probability <= 0.0 else float(chdtri(freedom, probability))


def _probability(false_rejection: float) -> float:
    return real_number("false_rejection", false_rejection, least=0.0, most=1.0)
