"""The filter of a session, monitored by its innovations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from startracker.arguments import real_array
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.estimation import Estimator
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.acceptance import accepts
from startracker.observer import unknown_aberration
from startracker.settings import IdentificationSettings
from startracker.tracking.candidates import Candidates, Expected
from startracker.tracking.checked import FASTEST_RAD_S
from startracker.tracking.consistency import InnovationWindow
from startracker.tracking.following import Followed, follow
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise
from startracker.tracking.standstill import StandstillWatch

StarAttitude = tuple[FloatArray, FloatArray]
"""Attitude of the stars of one frame alone: quaternion (4,), and covariance (3, 3) in camera axes, rad²."""
_LEAST_STEP_S = 1e-3
_PRIOR_SIGMAS = 5.0
_LEAST_PRIOR_DEG = 0.1


class WatchedFilter:
    """A filter whose covariance is increased, or which is restarted, if frames contradict it.

    Parameters
    ----------
    noise : RateNoise or GyroNoise
        Motion of the camera.
    false_rejection : float
        Probability that the gate of a single innovation rejects a correct frame.
    estimator : Estimator, optional
        Method that gives the attitude of the stars of a followed frame (`following.follow`).
    """

    def __init__(
        self, noise: RateNoise | GyroNoise, false_rejection: float, estimator: Estimator | None = None
    ) -> None:
        self.noise, self.false_rejection, self.estimator = noise, false_rejection, estimator
        self.mekf: Mekf | None = None
        """The filter; None before the first attitude, and if the prediction has become useless."""
        self.distrusted = False
        """Whether recent innovations contradicted the filter at this frame."""
        self.without_observer = False
        """Whether the frame was solved with catalogue positions without aberration. The aberration is then common to
        all attitudes; it is not noise for the filter, and is added to its covariance."""
        self._still = StandstillWatch(noise) if isinstance(noise, GyroNoise) else None
        self._window = InnovationWindow()
        self._solved: tuple[float, FloatArray] | None = None

    def begin(self, attitude: Attitude, covariance: ArrayLike, rate_rad_s: ArrayLike | None = None) -> None:
        """Start from a known attitude."""
        self.mekf, self._solved = Mekf(attitude, covariance, self.noise, rate_rad_s), None

    def forget(self) -> None:
        """Discard the filter."""
        self.mekf, self._solved = None, None
        self._window.forget()
        if self._still is not None:
            self._still.forget()

    def sample(self, gyro_rad_s: ArrayLike | None) -> tuple[FloatArray | None, str]:
        """Gyro sample (3,) for the filter, and a remark; None for a sample that is not finite.

        Raises
        ------
        InputError
            For a sample that is not three numbers, or given without a gyro.
        """
        if gyro_rad_s is None:
            return None, ""
        if not isinstance(self.noise, GyroNoise):
            raise InputError("this session has no gyro: create it with noise=GyroNoise(...), or omit gyro_rad_s")
        sample = real_array("a gyro's rate, three numbers in rad/s,", gyro_rad_s, finite=False)
        if sample.shape != (3,):
            raise InputError(f"a gyro's rate must be three numbers in rad/s; got {gyro_rad_s!r}")
        if not np.isfinite(sample).all():
            return None, "the gyro sample is not finite and was ignored"
        if float(np.abs(sample).max()) > FASTEST_RAD_S:
            return None, f"the gyro sample is beyond {FASTEST_RAD_S:g} rad/s and was ignored"
        return sample, ""

    def predict(self, dt: float, gyro_rad_s: FloatArray | None) -> None:
        """Propagate; the filter is discarded if the prediction has become useless."""
        if self.mekf is None:
            return
        self.mekf.predict(dt, gyro_rad_s)
        if self._still is not None:
            self._still.predict(dt, gyro_rad_s)
        if not self.uncertainty_rad < math.pi / 2.0:
            self.mekf = None

    @property
    def has_gyro(self) -> bool:
        """Whether there is a gyro."""
        return self._still is not None

    @property
    def uncertainty_rad(self) -> float:
        """Standard deviation of the predicted attitude about all axes together; infinite without a filter."""
        return math.inf if self.mekf is None else self.mekf.uncertainty_rad

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of the attitude's error, including unknown aberration, and of rate or bias."""
        if self.mekf is None:
            return None
        covariance = self.mekf.covariance
        if self.without_observer:
            covariance[:3, :3] += unknown_aberration(self.mekf.matrix)
        return covariance

    @property
    def attitude_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the attitude's error, including unknown aberration."""
        assert self.mekf is not None
        covariance = self.mekf.attitude_covariance
        return covariance + unknown_aberration(self.mekf.matrix) if self.without_observer else covariance

    def own_covariance(self, attitude: Attitude, covariance: FloatArray) -> FloatArray:
        """The part of the covariance (3, 3) of the tracker's attitude that is noise for the filter."""
        if not self.without_observer:
            return covariance
        return np.asarray(covariance - unknown_aberration(attitude.as_matrix()))

    def prior(self, limit_deg: float) -> tuple[Attitude | None, float]:
        """Prediction as a prior for identification: an attitude and its maximum error, degrees; none above a limit."""
        if self.mekf is None:
            return None, 1.0
        width = max(math.degrees(_PRIOR_SIGMAS * self.uncertainty_rad), _LEAST_PRIOR_DEG)
        return (self.mekf.attitude, width) if width <= limit_deg else (None, 1.0)

    def follow(
        self, camera: Camera, seen: Candidates, expected: Expected, settings: IdentificationSettings
    ) -> Followed | None:
        """Match a frame with the prediction (`following.follow`).

        If the match is accepted, but the innovations including this frame contradict the filter, the uncertainty of the
        prediction is increased and the frame matched again.
        """
        if self.mekf is None:
            return None
        followed = follow(self.mekf, camera, seen, expected, self.false_rejection, self.estimator)
        accepted = followed is not None and accepts(followed.log_chance, settings)
        if followed is None or not accepted or not self._window.contradicts(followed.innovation):
            return followed
        self._lose_confidence(self.mekf)
        return follow(self.mekf, camera, seen, expected, self.false_rejection, self.estimator)

    def contradiction(self, stars: StarAttitude | None) -> str:
        """Why the attitude of a frame's stars contradicts the gyro; empty if it does not.

        The filter is then the one that the gyro alone propagated since the stars are static.
        """
        if self._still is None or stars is None:
            return ""
        reason = self._still.contradiction(*stars)
        if reason and self._still.filter is not None:
            self.mekf = self._still.filter.copy()
        return reason

    def add_star_attitude(self, stars: StarAttitude | None) -> None:
        """The attitude of the stars of a frame that was used."""
        if self._still is not None and self.mekf is not None:
            if stars is None:
                self._still.forget()
            else:
                self._still.add(self.mekf, *stars)

    def take_followed(self, followed: Followed) -> None:
        """Continue with the filter of a followed frame."""
        self.mekf = followed.filter
        self._update_noise(followed.innovation)

    def take_attitude(self, now_s: float, attitude: Attitude, covariance: FloatArray) -> tuple[Innovation | None, bool]:
        """Update with an attitude of the tracker; returns its innovation, and whether the filter was restarted."""
        innovation = None
        if self.mekf is not None:
            covariance, after = np.ascontiguousarray(covariance), self.mekf.copy()
            innovation = after.update_quat(attitude.quat, covariance, self.false_rejection)
            if innovation.accepted and self._window.contradicts(innovation):
                self._lose_confidence(self.mekf)
                after = self.mekf.copy()
                innovation = after.update_quat(attitude.quat, covariance, self.false_rejection)
            self.mekf = after
        restarted = innovation is None or not innovation.accepted
        if restarted:
            self._restart(now_s, attitude, covariance)
        self._update_noise(innovation)
        self.mark_solved(now_s)
        return innovation, restarted

    def mark_solved(self, now_s: float) -> None:
        """Record the time of the last solved frame."""
        assert self.mekf is not None
        self._solved = now_s, self.mekf.quat

    def _update_noise(self, innovation: Innovation | None) -> None:
        assert self.mekf is not None
        if innovation is not None and innovation.accepted:
            self._window.add(innovation)
        self.mekf.noise_factor = self._window.noise_factor

    def _lose_confidence(self, prediction: Mekf) -> None:
        """Recent innovations contradict the filter: increase the weight of this frame and the next ones."""
        prediction.distrust(self._window.alarm())
        self.distrusted = True

    def _restart(self, now_s: float, attitude: Attitude, covariance: FloatArray) -> None:
        """Restart from an attitude that contradicts the prediction; their difference bounds rate or bias."""
        if self.mekf is None:
            self.mekf = Mekf(attitude, covariance, self.noise)
            self._window.forget()
            return
        second, rate = None, None
        if self._solved is not None:
            t_s, before = self._solved
            step_s = max(now_s - t_s, _LEAST_STEP_S)
            if isinstance(self.noise, GyroNoise):
                second = max(self.noise.bias_sigma_rad_s, self.mekf.attitude.angle_to(attitude) / step_s)
            else:
                second = max(self.noise.rate_sigma_rad_s, Attitude(before).angle_to(attitude) / step_s)
        if not self.mekf.has_gyro:  # otherwise the rate is measured
            rate = np.zeros(3)
        self._window.restart()
        self.mekf.reset(attitude, covariance, rate, second)
