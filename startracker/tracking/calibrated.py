"""A tracking session that calibrates its camera in flight."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

from numpy.typing import ArrayLike

from startracker.arguments import of_kind
from startracker.calibration.field import IdentifiedStars
from startracker.calibration.in_flight import InFlightCalibration
from startracker.core import FloatArray
from startracker.inputs import GivenImage, given_image
from startracker.observer import Observer, corrects_aberration
from startracker.settings import TrackingSettings
from startracker.solution import Solution
from startracker.tracker import StarTracker
from startracker.tracking.mekf import GyroNoise, RateNoise
from startracker.tracking.session import TrackingSession


class CalibratedSession(TrackingSession):
    """A session whose frames also calibrate the camera: lens, width of star images and defective pixels.

    Every solved frame with an observer that has a velocity updates the calibration (without it aberration would change
    the focal length by up to 100 ppm), and the next frame is solved with the updated camera. Covariances include the
    uncertainty of the lens.

    Parameters
    ----------
    tracker : StarTracker
        The tracker, with the camera of the calibration on the ground; it is not modified. `tracker` of the session is a
        copy with the current camera.
    calibration : InFlightCalibration
        The calibration, which the session updates.
    noise, settings, exposure_s
        As for `TrackingSession`.
    """

    def __init__(
        self,
        tracker: StarTracker,
        calibration: InFlightCalibration,
        noise: RateNoise | GyroNoise | None = None,
        *,
        settings: TrackingSettings | None = None,
        exposure_s: float = 0.0,
    ) -> None:
        of_kind("calibration", calibration, InFlightCalibration)
        of_kind("tracker", tracker, StarTracker)
        super().__init__(copy.copy(tracker), noise, settings=settings, exposure_s=exposure_s)
        self.calibration = calibration
        self._ground = tracker.centroid
        self._use_calibration()

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of the filter and of the lens: attitude in camera axes, and rate or bias."""
        covariance = super().covariance
        if covariance is not None:
            covariance[:3, :3] += self.calibration.attitude_covariance
        return covariance

    def update(
        self,
        image: Any,
        t_s: float,
        *,
        gyro_rad_s: ArrayLike | None = None,
        observer: Observer | None = None,
        saturation_dn: float | None = None,
        gain_e_per_dn: float | None = None,
    ) -> Solution:
        """Attitude of an image taken at a time, and update of the calibration; see `TrackingSession.update`."""
        with self._lock:
            given = given_image(image, observer, None, saturation_dn, gain_e_per_dn)
            seen = given._replace(image=self.calibration.masked(given.image))
            return self._calibrated(super().update(seen, t_s, gyro_rad_s=gyro_rad_s), given)

    def update_centroids(
        self,
        xy: ArrayLike,
        flux: ArrayLike | None,
        t_s: float,
        *,
        gyro_rad_s: ArrayLike | None = None,
        observer: Observer | None = None,
    ) -> Solution:
        """Attitude from given star positions, and update of the lens; see `TrackingSession.update_centroids`."""
        with self._lock:
            found = super().update_centroids(xy, flux, t_s, gyro_rad_s=gyro_rad_s, observer=observer)
            return self._calibrated(found, None)

    def _calibrated(self, solution: Solution, given: GivenImage | None) -> Solution:
        """The solution with its complete covariance, after the calibration was updated with it."""
        now_s = self._clock.now_s
        if solution.attitude is None or solution.covariance is None or now_s is None:
            return solution
        if corrects_aberration(solution.observer):
            stars = IdentifiedStars.of(solution, self.tracker)
            self.calibration.update(now_s, solution.attitude, stars, given)
            self._use_calibration()
        return replace(solution, covariance=solution.covariance + self.calibration.attitude_covariance)

    def _use_calibration(self) -> None:
        """Solve the next frame with the current camera and width of star images."""
        self.tracker.camera = self.calibration.camera
        self.tracker.centroid = self.calibration.centroiding(self._ground)
