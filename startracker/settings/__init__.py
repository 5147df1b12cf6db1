"""Settings of the tracker's stages: every parameter with its unit, default and meaning.

The simulator's scenario schema validates these same classes, so that scenarios and the Python interface have the same
parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from startracker.arguments import ABOVE_0, names_of
from startracker.display import changed_fields
from startracker.errors import InputError
from startracker.settings.checks import BELOW_1, COUNT, FORBID, FROM_0, POSITIVE, check_settings
from startracker.settings.identification import (
    AdaptiveSettings,
    AnyIdentificationSettings,
    IdentificationSettings,
    MatchGroupSettings,
    PatternHashSettings,
    PyramidSettings,
    TriadSettings,
)

__all__ = [
    "AdaptiveSettings",
    "AnyIdentificationSettings",
    "CentroidSettings",
    "DetectionSettings",
    "IdentificationSettings",
    "InFlightSettings",
    "MatchGroupSettings",
    "OperationSettings",
    "PatternHashSettings",
    "PyramidSettings",
    "TrackingSettings",
    "TriadSettings",
]

_LENS_PARAMETERS = ("f", "aspect", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2")
"""Parameters of `startracker.geometry.lens.PARAMETERS` for every projection."""


@dataclass(frozen=True)
class DetectionSettings:
    """Settings of star detection.

    Parameters
    ----------
    threshold_sigma : float
        Threshold of star candidates above the background, in units of the noise.
    min_pixels : int
        Minimum size of a candidate (Greyling 1995, section 4.2: 7).
    max_pixels : int
        Maximum size of a candidate (Greyling 1995, section 4.2: 36).
    max_axis_ratio : float
        Ratio of the second moments along the two principal axes above which a candidate is classified as a streak or an
        edge. Greyling's 0.7 to 1.3 (1995, section 4.2) corresponds to 1.3. The default is larger because smear
        elongates star images.
    max_stars : int
        Number of candidates kept, the brightest first.
    background_tile_px : int
        Size of the tiles in which the local background and its noise are estimated.
    search_step_px : int
        Region growing: step of the search pattern, every third pixel in Greyling 1995, Fig. 4.6.
    matched_filter : bool
        Correlate the image with the star image before thresholding. This finds fainter stars and stars of one or two
        pixels, for which `min_pixels` does not apply.
    psf_sigma_px : float or None
        Width of the star image, pixels, for the matched filter; None: 0.8, which is suitable for 0.4 to 1.3.
    reject_hits : bool
        Reject candidates that are sharper than the frame's star images: hot pixels, cosmic-ray events.
    isolation : float
        If there is structure on all sides of a star (branches, clouds), its peak must exceed that structure by this
        factor. 0 disables the test.
    cluster_radius_px : float or None
        Clustering: maximum distance of a pixel from its cluster's centre, Yee's τ; None: from the frame.
    threshold_dn : float or None
        Clustering and round regions: absolute threshold in DN, independent of the background, as in Greyling 1995 and
        Yee 1999; None: `threshold_sigma`.
    """

    threshold_sigma: float = 5.0
    min_pixels: int = 3
    max_pixels: int = 400
    max_axis_ratio: float = 6.0
    max_stars: int = 60
    background_tile_px: int = 64
    search_step_px: int = 3
    matched_filter: bool = True
    psf_sigma_px: float | None = None
    reject_hits: bool = True
    isolation: float = 5.0
    cluster_radius_px: float | None = None
    threshold_dn: float | None = None

    def __post_init__(self) -> None:
        check_settings(
            self,
            threshold_sigma=POSITIVE,
            min_pixels=COUNT,
            max_pixels=COUNT,
            max_axis_ratio=(1.0, math.inf),
            max_stars=COUNT,
            background_tile_px=(4, math.inf),
            search_step_px=COUNT,
            psf_sigma_px=POSITIVE,
            isolation=FROM_0,
            cluster_radius_px=POSITIVE,
            threshold_dn=POSITIVE,
        )

    __pydantic_config__ = FORBID


@dataclass(frozen=True)
class CentroidSettings:
    """Settings of centroiding.

    Parameters
    ----------
    window_px : int
        Side of the window around the brightest pixel, odd (Greyling 1995: 5).
    bias_correction : bool
        Subtract the moment's known bias as a function of sub-pixel phase (Greyling 1995, Table 4.1), for
        `psf_sigma_px`.
    psf_sigma_px : float or None
        Width of the star image for the bias table; None: measured from the brightest stars of the frame.
    psf : str or None
        Star image for the fits, a file (.npz) written by ``PsfModel.save``; None: an elliptical or trailed Gaussian
        measured from the brightest stars of the frame.
    flat_field_error : float
        Residual relative standard deviation of the pixel responses; adds to the noise model of the fits.
    camera_model_px : float
        Standard error of the calibrated camera model on one axis, such as the residual of a calibration; adds to the
        error of every centroid.
    """

    window_px: int = 5
    bias_correction: bool = True
    psf_sigma_px: float | None = None
    psf: str | None = None
    flat_field_error: float = 0.0
    camera_model_px: float = 0.0

    def __post_init__(self) -> None:
        check_settings(self, window_px=(3, 101), psf_sigma_px=POSITIVE, flat_field_error=FROM_0, camera_model_px=FROM_0)
        if self.window_px % 2 == 0:
            raise InputError(f"window_px is {self.window_px}; it must be odd, so that a pixel is at its centre")

    __pydantic_config__ = FORBID


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of tracking from frame to frame.

    Parameters
    ----------
    max_stars : int
        Number of guide stars to track, the brightest of the field; each has a window on the image.
    max_window_px : int
        Maximum half side of a window, excluding streaks. If the prediction is less certain, the whole frame is
        searched.
    prior_limit_deg : float
        Uncertainty about any axis above which the prediction is not used as a prior for identification.
    false_rejection : float
        Probability that the filter's gate rejects a good frame.
    """

    max_stars: int = 40
    max_window_px: int = 20
    prior_limit_deg: float = 15.0
    false_rejection: float = 1e-6

    def __post_init__(self) -> None:
        check_settings(
            self,
            max_stars=COUNT,
            max_window_px=COUNT,
            prior_limit_deg=FROM_0,
            false_rejection=(ABOVE_0, BELOW_1),
        )

    __pydantic_config__ = FORBID


@dataclass(frozen=True)
class OperationSettings:
    """Rules of autonomous operation from frame to frame (Greyling 1995, sections 4.2.1 and 4.2.2)."""

    use: bool = False
    """Apply the rules; false: every frame is solved as it is, at a fixed exposure."""
    saturated_pixels: int = 4
    """A frame whose two brightest stars each have more saturated pixels than this is discarded (Greyling 1995: 4)."""
    shorten: float = 0.5
    """Factor applied to the exposure after such a frame."""
    shortest_exposure_s: float = 0.01
    """Minimum exposure; a frame taken with it is not discarded."""
    lengthen_below: float = 0.2
    """If the brightest star is below this fraction of saturation, the next exposure is longer by 1 / `shorten`, up to
    that of the scenario. 0: never."""
    exposure_step_s: float = 0.0
    """Exposures are integer multiples of this, as the prototype's are of its frame time; 0: any."""
    sun_share: float = 0.02
    """Fraction of saturated pixels above which the Sun is in the frame. The Moon covers 0.003 of a field of 10°."""
    suspend_turn_deg: float = 0.6
    """After such a frame none is taken until the camera has rotated by this, a little more than the Sun's diameter."""
    longest_suspension_s: float = 60.0
    """Maximum time without a frame, also if the rate is not known."""
    clear_pixels: int | None = None
    """Larger objects, such as the Moon, are removed from the frame; None: `DetectionSettings.max_pixels`."""
    blemish_frames: int = 5
    """Minimum number of frames for mapping a defective pixel; 0: defective pixels are not mapped."""
    blemish_share: float = 0.75
    """Fraction of the frames in which a defective pixel must be seen."""
    blemish_sigma: float = 5.0
    """Threshold of a defective pixel in units of the noise."""
    blemish_shift_px: float = 8.0
    """Minimum motion of the stars since the last frame that was counted."""
    reference_b_v: float = 0.65
    """Colour for which flux and magnitude were calibrated on the ground."""

    __repr__ = changed_fields

    def __post_init__(self) -> None:
        check_settings(
            self,
            saturated_pixels=FROM_0,
            shorten=(ABOVE_0, BELOW_1),
            shortest_exposure_s=POSITIVE,
            lengthen_below=(0.0, BELOW_1),
            exposure_step_s=FROM_0,
            sun_share=(ABOVE_0, 1.0),
            suspend_turn_deg=POSITIVE,
            longest_suspension_s=POSITIVE,
            clear_pixels=COUNT,
            blemish_frames=FROM_0,
            blemish_share=(ABOVE_0, 1.0),
            blemish_sigma=POSITIVE,
            blemish_shift_px=FROM_0,
            reference_b_v=(-10.0, 10.0),
        )

    __pydantic_config__ = FORBID


@dataclass(frozen=True)
class InFlightSettings:
    """Calibration in flight: the camera estimated from the stars of successive frames.

    Each parameter begins with the value of the calibration on the ground and a standard deviation, and may drift as a
    random walk: its standard deviation grows by the stated amount in one hour, and by the square root of the time. The
    smaller the drift, the longer the estimate averages over noise, and the later it follows a change
    (`startracker.calibration.LensFilter.time_constant_s`).
    """

    use: bool = False
    """Calibrate in flight; false: the camera is that of the calibration on the ground."""
    parameters: tuple[str, ...] = ("f", "cx", "cy", "k1")
    """Estimated parameters of the lens: ``f`` (focal length), ``aspect`` (ratio of its values along rows and columns),
    ``cx``, ``cy`` (principal point), ``k1`` to ``k3``, ``p1``, ``p2`` (distortion; ``k1`` to ``k4`` of a fisheye)."""
    focal_length_ppm: float = 200.0
    """Initial standard deviation of the focal length, and of its aspect ratio, 1e-6."""
    principal_point_px: float = 0.2
    """Initial standard deviation of the principal point on each axis, pixels."""
    distortion_px: float = 0.1
    """Initial standard deviation of the displacement that each coefficient of the distortion causes at the corner of
    the image, pixels."""
    psf_width_px: float = 0.1
    """Initial standard deviation of the width of star images (σ), pixels."""
    focal_length_drift_ppm_sqrt_h: float = 20.0
    """Drift of the focal length and the aspect ratio in one hour, 1e-6."""
    principal_point_drift_px_sqrt_h: float = 0.02
    """Drift of the principal point in one hour, pixels."""
    distortion_drift_px_sqrt_h: float = 0.005
    """Drift of the displacement by each coefficient at the corner in one hour, pixels."""
    psf_width_drift_px_sqrt_h: float = 0.01
    """Drift of the width of star images in one hour, pixels."""
    field_px: float = 1.0
    """Largest rms value, on each axis, of a smooth distortion that the parameters do not describe, pixels. Its actual
    value is estimated (`startracker.calibration.residual_field`). 0: the parameters describe the lens exactly."""
    star_error_px: float = 0.005
    """Standard deviation on one axis of the error of a star that stays the same from frame to frame (unresolved
    neighbours, colour, catalogue), pixels. Stars whose mean residual is significantly larger are not used."""
    shift_px: float = 1.0
    """Minimum motion of the stars since the last frame used for the lens, pixels: the errors of stars that stay on the
    same pixels do not average out. 0: every frame is used."""
    false_rejection: float = 1e-6
    """Probability that the gate on the innovations rejects a correct frame."""
    defect_frames: int = 5
    """Minimum number of frames for mapping a defective pixel; 0: defective pixels are not mapped."""
    defect_share: float = 0.75
    """Fraction of the frames in which a defective pixel must be seen."""
    defect_sigma: float = 5.0
    """Threshold of a defective pixel in units of the noise."""
    defect_shift_px: float = 8.0
    """Minimum motion of the stars, at the position of a pixel, between two frames in which it is counted; more than the
    diameter of a star image."""

    __repr__ = changed_fields

    def __post_init__(self) -> None:
        unknown = [name for name in names_of(self.parameters) if name not in _LENS_PARAMETERS]
        if unknown or len(set(self.parameters)) != len(self.parameters):
            raise InputError(
                f"parameters is {list(self.parameters)}; it must name some of {', '.join(_LENS_PARAMETERS)}, each once"
            )
        positive = ("focal_length_ppm", "principal_point_px", "distortion_px", "psf_width_px")
        drifts = (
            "focal_length_drift_ppm_sqrt_h",
            "principal_point_drift_px_sqrt_h",
            "distortion_drift_px_sqrt_h",
            "psf_width_drift_px_sqrt_h",
        )
        check_settings(
            self,
            **dict.fromkeys(positive, POSITIVE),
            **dict.fromkeys(drifts, FROM_0),
            field_px=FROM_0,
            star_error_px=FROM_0,
            shift_px=FROM_0,
            false_rejection=(ABOVE_0, BELOW_1),
            defect_frames=FROM_0,
            defect_share=(ABOVE_0, 1.0),
            defect_sigma=POSITIVE,
            defect_shift_px=POSITIVE,
        )

    __pydantic_config__ = FORBID
