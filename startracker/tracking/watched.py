"""The session's filter under watch: what its innovations say of it, and what follows from that."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.errors import InputError
from startracker.identification.acceptance import accepts
from startracker.observer import unknown_aberration
from startracker.settings import IdentificationSettings
from startracker.tracking.consistency import InnovationWindow
from startracker.tracking.following import Followed, follow
from startracker.tracking.looking import Expected, Seen
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise

__all__ = ["WatchedFilter"]

FloatArray = NDArray[np.float64]

_LEAST_STEP_S = 1e-3
_PRIOR_SIGMAS = 5.0
_LEAST_PRIOR_DEG = 0.1


class WatchedFilter:
    """A filter that loses confidence, or begins anew, where the frames contradict it.

    Parameters
    ----------
    noise : RateNoise or GyroNoise
        How the camera moves.
    false_rejection : float
        Probability of a good frame's being refused by the gate of a single innovation.
    """

    def __init__(self, noise: RateNoise | GyroNoise, false_rejection: float) -> None:
        self.noise, self.false_rejection = noise, false_rejection
        self.mekf: Mekf | None = None
        """The filter; None before the first attitude, and where nothing is known any more."""
        self.distrusted = False
        """Whether the last innovations contradicted the filter at this frame."""
        self.without_observer = False
        """Whether the frame's stars are those of the catalogue, without aberration: it is then in all attitudes alike,
        no noise to the filter, and comes on top of what the filter says of its error."""
        self._window = InnovationWindow()
        self._solved: tuple[float, FloatArray] | None = None

    def begin(self, attitude: Attitude, covariance: ArrayLike, rate_rad_s: ArrayLike | None = None) -> None:
        """Begin from an attitude that is known."""
        self.mekf, self._solved = Mekf(attitude, covariance, self.noise, rate_rad_s), None

    def forget(self) -> None:
        """Know nothing."""
        self.mekf, self._solved = None, None
        self._window.forget()

    def sample(self, gyro_rad_s: ArrayLike | None) -> tuple[FloatArray | None, str]:
        """A gyro's sample (3,) as the filter takes it, and what is to be said of it: one that is not finite is none.

        Raises
        ------
        InputError
            For a sample that is not three numbers, or that comes without a gyro.
        """
        if gyro_rad_s is None:
            return None, ""
        if not isinstance(self.noise, GyroNoise):
            raise InputError("this session has no gyro: give it noise=GyroNoise(...), or leave gyro_rad_s out")
        try:
            sample = np.asarray(gyro_rad_s, dtype=float)
        except (TypeError, ValueError):
            sample = np.empty(0)
        if sample.shape != (3,):
            raise InputError(f"a gyro's rate must be three numbers in rad/s; got {gyro_rad_s!r}")
        finite = bool(np.isfinite(sample).all())
        return (sample, "") if finite else (None, "the gyro's sample is not finite and was left out")

    def predict(self, dt: float, gyro_rad_s: FloatArray | None) -> None:
        """Move on; the filter is dropped where nothing is known any more."""
        if self.mekf is None:
            return
        self.mekf.predict(dt, gyro_rad_s)
        if not self.uncertainty_rad < math.pi / 2.0:
            self.mekf = None

    @property
    def uncertainty_rad(self) -> float:
        """Standard deviation of the predicted attitude about all axes together; infinite without a filter."""
        if self.mekf is None:
            return math.inf
        return math.sqrt(sum(self.mekf.attitude_covariance.diagonal().tolist()))

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of the attitude's error, with the aberration where it is not known, and of rate or bias."""
        if self.mekf is None:
            return None
        covariance = self.mekf.covariance
        if self.without_observer:
            covariance[:3, :3] += unknown_aberration(self.mekf.matrix)
        return covariance

    def own_covariance(self, attitude: Attitude, covariance: FloatArray) -> FloatArray:
        """What of the covariance (3, 3) of the tracker's attitude is noise to the filter."""
        if not self.without_observer:
            return covariance
        return np.asarray(covariance - unknown_aberration(attitude.as_matrix()))

    def prior(self, limit_deg: float) -> tuple[Attitude | None, float]:
        """Prediction as the identification takes it: an attitude and its largest error, degrees; none above a limit."""
        if self.mekf is None:
            return None, 1.0
        width = max(math.degrees(_PRIOR_SIGMAS * self.uncertainty_rad), _LEAST_PRIOR_DEG)
        return (self.mekf.attitude, width) if width <= limit_deg else (None, 1.0)

    def follow(
        self, camera: Camera, seen: Seen, expected: Expected, settings: IdentificationSettings
    ) -> Followed | None:
        """Match a frame with the prediction (`following.follow`).

        Where the match is accepted, and the innovations of the last frames with this one contradict the filter, the
        prediction is made less certain and matched again.
        """
        if self.mekf is None:
            return None
        followed = follow(self.mekf, camera, seen, expected, self.false_rejection)
        accepted = followed is not None and accepts(followed.log_chance, settings)
        if followed is None or not accepted or not self._window.contradicts(followed.innovation):
            return followed
        self._lose_confidence(self.mekf)
        return follow(self.mekf, camera, seen, expected, self.false_rejection)

    def take_followed(self, followed: Followed) -> None:
        """Go on from a frame that was followed."""
        self.mekf = followed.filter
        self._learn(followed.innovation)

    def take_attitude(self, now_s: float, attitude: Attitude, covariance: FloatArray) -> tuple[Innovation | None, bool]:
        """Take in an attitude that the tracker found; its innovation, and whether the filter began anew from it."""
        innovation = None
        if self.mekf is not None:
            after = self.mekf.copy()
            innovation = after.update_attitude(attitude, covariance, self.false_rejection)
            if innovation.accepted and self._window.contradicts(innovation):
                self._lose_confidence(self.mekf)
                after = self.mekf.copy()
                innovation = after.update_attitude(attitude, covariance, self.false_rejection)
            self.mekf = after
        restarted = innovation is None or not innovation.accepted
        if restarted:
            self._restart(now_s, attitude, covariance)
        self._learn(innovation)
        self.mark_solved(now_s)
        return innovation, restarted

    def mark_solved(self, now_s: float) -> None:
        """Remember when the attitude was last known from a frame."""
        assert self.mekf is not None
        self._solved = now_s, self.mekf.quat

    def _learn(self, innovation: Innovation | None) -> None:
        assert self.mekf is not None
        if innovation is not None and innovation.accepted:
            self._window.add(innovation)
        self.mekf.noise_factor = self._window.noise_factor

    def _lose_confidence(self, prediction: Mekf) -> None:
        """The last innovations together contradict the filter: this frame is to count for more, and the next ones."""
        prediction.distrust(self._window.alarm())
        self.distrusted = True

    def _restart(self, now_s: float, attitude: Attitude, covariance: FloatArray) -> None:
        """Begin from an attitude that the prediction did not foresee; how far it is off bounds rate or bias."""
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
        if not self.mekf.has_gyro:  # else the rate is what was measured
            rate = np.zeros(3)
        self._window.restart()
        self.mekf.reset(attitude, covariance, rate, second)
