"""A static picture while the gyro measures a rotation.

A frozen camera whose noise is fresh in every frame, such as one whose exposure is not triggered, shows the same sky for
ever. Its frames are not repeated (`repeats`), and a filter explains them by a bias of the gyro. But a bias has a stated
size. While the attitudes of the stars alone stay where they are, the gyro may show no more rotation than its stated
errors explain; what is beyond means that the picture is old, or that the gyro is wrong, and nothing shows which.
A picture that moves is believed, whatever the gyro says.
"""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray
from startracker.tracking.mekf import GyroNoise, Mekf, chi_square_limit, rotation_between

_STILL = 1e-4
"""Probability that the errors of two attitudes of one direction differ by more than the limit of a static picture."""
_LONGEST_S = 1e5
"""Longest step of one sample, s, over which a gyro is integrated here."""
_STATED, _CHANGED, _LEARNT = 4.0, 2.0, 8.0
"""Numbers of standard deviations. A bias is wrong beyond 4 of its stated ones, of which one of 16,000 is. One that has
been estimated from earlier frames is wrong if it has changed by 2 stated ones and by 8 of those of the estimate."""


class StandstillWatch:
    """The attitude from which the stars have not moved, and how far the gyro has.

    Parameters
    ----------
    noise : GyroNoise
        Stated errors of the gyro.
    """

    def __init__(self, noise: GyroNoise) -> None:
        self.noise = noise
        self.filter: Mekf | None = None
        """The filter when the stars were first where they are, propagated by the gyro alone since."""
        self._quat, self._covariance = np.zeros(4), np.zeros((3, 3))
        self._time_s = self._turn_rad = 0.0

    def forget(self) -> None:
        """Begin again with the next attitude."""
        self.filter = None

    def predict(self, dt: float, gyro_rad_s: FloatArray | None) -> None:
        """Propagate by a step; without a sample of the gyro nothing can be said."""
        if self.filter is None:
            return
        if gyro_rad_s is None or dt > _LONGEST_S:
            self.forget()
            return
        self.filter.predict(dt, gyro_rad_s)
        self._time_s += dt
        self._turn_rad += float(np.linalg.norm(gyro_rad_s)) * dt

    def _is_still(self, quat: FloatArray, covariance: FloatArray) -> bool:
        """Whether an attitude is the one from which the stars have not moved."""
        turn = rotation_between(self._quat, quat)
        return float(turn @ np.linalg.solve(self._covariance + covariance, turn)) < chi_square_limit(3, _STILL)

    def contradiction(self, quat: FloatArray, covariance: FloatArray) -> str:
        """Why an attitude of the stars alone, (4,) with its covariance (3, 3) in camera axes, contradicts the gyro;
        empty if it does not."""
        if self.filter is None or not self._is_still(quat, covariance):
            return ""
        noise, t = self.noise, self._time_s
        drift = (noise.bias_sigma_rad_s * t) ** 2 + noise.rate_random_walk**2 * t**3 / 3.0
        turn = rotation_between(self.filter.quat, quat)
        angle = math.hypot(*turn.tolist())
        if not angle > 0.0:
            return ""
        axis = turn / angle
        own = float(axis @ (self._covariance + covariance) @ axis)
        stated = math.sqrt(own + drift + noise.angle_random_walk**2 * t) + noise.scale_sigma * self._turn_rad
        learnt = math.sqrt(own + float(axis @ self.filter.attitude_covariance @ axis))
        if not (angle > _STATED * stated or (angle > _CHANGED * stated and angle > _LEARNT * learnt)):
            return ""
        return (
            f"the stars were static for {t:.3g} s while the gyro measured {math.degrees(angle):.3g}°, "
            f"{angle / stated:.1f} times its stated error: the picture is old, or the gyro wrong"
        )

    def add(self, mekf: Mekf, quat: FloatArray, covariance: FloatArray) -> None:
        """An attitude of the stars alone that was used, and the filter after it."""
        if self.filter is None or not self._is_still(quat, covariance):
            self.filter, self._quat, self._covariance = mekf.copy(), quat, covariance
            self._time_s = self._turn_rad = 0.0
