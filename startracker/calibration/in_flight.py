"""Calibration in flight: lens, width of star images and defective pixels, from the stars of successive frames."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.arguments import of_kind, real_number
from startracker.calibration.field import IdentifiedStars
from startracker.calibration.lens_filter import LensFilter, LensUpdate
from startracker.calibration.psf_width import WidthFilter, star_widths
from startracker.core import FloatArray
from startracker.detection.defect_map import DefectMap, mask_pixels
from startracker.display import described
from startracker.geometry.attitude import Attitude, camera_attitude
from startracker.geometry.camera import Camera
from startracker.inputs import GivenImage
from startracker.settings import CentroidSettings, InFlightSettings
from startracker.settings.checks import settings_or_default


class InFlightCalibration:
    """The camera of a star tracker in flight, estimated from its own stars.

    Pass it to a `TrackingSession`, which updates it with every solved frame and uses its camera, or call `update`.

    Parameters
    ----------
    camera : Camera
        The camera as calibrated on the ground.
    settings : InFlightSettings
        Parameters, their initial standard deviations and drifts, and the map of defective pixels.
    psf_width_px : float, optional
        Width of the star images (σ) on the ground; None: as in the first frame.
    background_tile_px : int
        Size of the tiles of the background in which defective pixels are searched for.

    Raises
    ------
    InputError
        For a parameter that the camera's projection does not have.
    """

    def __init__(
        self,
        camera: Camera,
        settings: InFlightSettings | None = None,
        *,
        psf_width_px: float | None = None,
        background_tile_px: int = 64,
    ) -> None:
        self.settings = chosen = settings_or_default("settings", settings, InFlightSettings)
        self.lens = LensFilter(camera, chosen)
        """Estimate of the lens, with its covariance."""
        self.psf = WidthFilter(chosen.psf_width_px, chosen.psf_width_drift_px_sqrt_h / 60.0, psf_width_px)
        """Estimate of the width of star images."""
        self.defects = DefectMap(
            camera,
            frames=chosen.defect_frames,
            share=chosen.defect_share,
            sigma=chosen.defect_sigma,
            shift_px=chosen.defect_shift_px,
            tile_px=background_tile_px,
        )
        """Map of defective pixels."""
        self.attitude_covariance: FloatArray = np.zeros((3, 3))
        """Second moment (3, 3) of the error that the lens causes in an attitude, camera axes, rad². It includes the
        uncertainty of the parameters, changes that are not applied, and the residual distortion. Zero before the first
        frame."""
        self.last: LensUpdate | None = None
        """Result of the last frame for the lens; None before the first."""
        self._fixed_width = psf_width_px is not None
        self._now_s: float | None = None
        self._used_at: Attitude | None = None

    def __repr__(self) -> str:
        return described("InFlightCalibration", repr(self.lens), repr(self.psf), f"{self.defects.mask.sum()} defective")

    @property
    def camera(self) -> Camera:
        """Camera to use: as calibrated on the ground, with the changes that are significant
        (`startracker.calibration.applied`)."""
        return self.lens.camera_in_use

    def masked(self, image: Any) -> Any:
        """The image with NaN at the defective pixels; unchanged if there are none, or if its shape differs from the
        camera's."""
        mask = self.defects.mask
        return mask_pixels(image, mask) if mask.any() and np.shape(image) == mask.shape else image

    def centroiding(self, settings: CentroidSettings) -> CentroidSettings:
        """Settings of the centroiding with the current width of star images, if an initial width was given.

        Otherwise they are unchanged, and the tracker measures the width in every frame.
        """
        of_kind("settings", settings, CentroidSettings)
        return replace(settings, psf_sigma_px=self.psf.width_px) if self._fixed_width else settings

    def update(
        self, t_s: float, attitude: Attitude, stars: IdentifiedStars, given: GivenImage | None = None
    ) -> LensUpdate:
        """Update with an identified frame.

        Parameters
        ----------
        t_s : float
            Time of the frame, seconds of any uniform clock.
        attitude : Attitude
            ICRS to camera; an approximate value is sufficient, because the attitude is fitted together with the lens.
        stars : IdentifiedStars
            The stars of the frame; ``IdentifiedStars.of(solution, tracker)`` takes them from a solution.
        given : GivenImage, optional
            The image as read out, for the width of star images and defective pixels (`startracker.inputs`).
        """
        t_s = real_number("t_s", t_s, unit="s")
        camera_attitude("attitude", attitude)
        of_kind("stars", stars, IdentifiedStars, "IdentifiedStars.of(solution, tracker)")
        of_kind("given", given, (GivenImage, type(None)))
        elapsed_s = 0.0 if self._now_s is None else max(t_s - self._now_s, 0.0)
        self._now_s = t_s
        self.lens.predict(elapsed_s)
        self.psf.predict(elapsed_s)
        if given is not None:
            self._update_image(np.asarray(given.image), attitude, stars, given)
        # The errors of stars on the same pixels do not average out, so frames without motion are not used for the lens.
        if self._used_at is not None and self._shift_px(self._used_at, attitude) < self.settings.shift_px:
            found = self.lens.unused(attitude.as_matrix(), stars, "the stars have not moved")
        else:
            found = self.lens.update(attitude.as_matrix(), stars)
        self.last = found
        if found.attitude_covariance is not None:
            self.attitude_covariance = found.attitude_covariance
        if found.accepted:
            self._used_at = attitude
        return found

    def _update_image(self, image: NDArray[Any], attitude: Attitude, stars: IdentifiedStars, given: GivenImage) -> None:
        if image.shape != self.defects.mask.shape:
            return
        self.psf.update(star_widths(image, stars.xy, stars.flux, given.saturation_dn, given.gain_e_per_dn))
        self.defects.add(image, attitude, stars.xy)

    def _shift_px(self, before: Attitude, now: Attitude) -> float:
        """Median motion of stars over the field between two attitudes, px; infinite for stars that leave the field."""
        camera = self.lens.ground
        x, y = np.meshgrid(np.linspace(0, camera.width - 1, 4), np.linspace(0, camera.height - 1, 4))
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        moved = camera.project(camera.unproject(pixels) @ (now.as_matrix() @ before.as_matrix().T).T)
        shift = np.hypot(*(moved - pixels).T)
        return float(np.median(np.where(np.isfinite(shift), shift, math.inf)))
