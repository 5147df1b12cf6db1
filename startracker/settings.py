"""Settings of the tracker's stages: every knob with its unit, its default and its meaning, in one place.

The simulator's scenario schema validates these same classes, so that a scenario, the Python interface and the
documentation can never name different knobs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from startracker.errors import InputError
from startracker.identification_settings import (
    AdaptiveSettings,
    AnyIdentificationSettings,
    IdentificationSettings,
    MatchGroupSettings,
    PatternHashSettings,
    PyramidSettings,
    TriadSettings,
)
from startracker.setting_checks import ABOVE_0, BELOW_1, COUNT, FORBID, FROM_0, POSITIVE, check_settings

__all__ = [
    "AdaptiveSettings",
    "AnyIdentificationSettings",
    "CentroidSettings",
    "DetectionSettings",
    "IdentificationSettings",
    "MatchGroupSettings",
    "OperationSettings",
    "PatternHashSettings",
    "PyramidSettings",
    "TrackingSettings",
    "TriadSettings",
]


@dataclass(frozen=True)
class DetectionSettings:
    """How star images are found.

    Parameters
    ----------
    threshold_sigma : float
        A pixel belongs to a star candidate above background + this many times the noise.
    min_pixels, max_pixels : int
        Size limits of a candidate (Greyling 1995, section 4.2: 7 to 36).
    max_axis_ratio : float
        Ratio of the second moments along the two principal axes above which a candidate is a streak or an edge;
        Greyling's 0.7 to 1.3 (1995, section 4.2) is 1.3. Generous by default, as smear elongates true stars.
    max_stars : int
        Brightest candidates kept.
    background_tile_px : int
        Size of the tiles in which the local background and its noise are estimated.
    search_step_px : int
        Region growing's search pattern: every third pixel (Greyling 1995, Fig. 4.6).
    matched_filter : bool
        Search the image correlated with the star image instead of single pixels: finds fainter stars, and sharp ones
        of one or two pixels, for which `min_pixels` then does not count.
    psf_sigma_px : float or None
        Width of a star image, pixels, for the matched filter; None: 0.8, which suits 0.4 to 1.3.
    reject_hits : bool
        Leave out what is sharper than the frame's star images can be: hot pixels, tracks of particles.
    isolation : float
        Where there is something on all sides of a star (branches, clouds), the star must be this many times as high.
        0: not asked for.
    cluster_radius_px : float or None
        Yee's τ: clustering's largest distance of a pixel from its cluster's centre; None: from the frame.
    threshold_dn : float or None
        Clustering and round regions: pixels above this many DN, whatever the background, as Greyling 1995 and Yee
        1999 do; None: `threshold_sigma`.
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
    """How a candidate's position is measured.

    Parameters
    ----------
    window_px : int
        Odd side of the window around the brightest pixel (Greyling 1995: 5).
    bias_correction : bool
        Take off the moment's known bias at each sub-pixel phase (Greyling 1995, Table 4.1), for `psf_sigma_px`.
    psf_sigma_px : float or None
        Width of the star image as the bias table takes it; None: measured from the brightest stars of the frame.
    psf : str or None
        Star image that the fits take, a file (.npz) written by ``PsfModel.save``; None: an elliptical Gaussian, or one
        drawn out along a line, measured from the brightest stars of the frame.
    flat_field_error : float
        Relative standard deviation of the pixels' responses that is left in the image; adds to the fits' noise model.
    """

    window_px: int = 5
    bias_correction: bool = True
    psf_sigma_px: float | None = None
    psf: str | None = None
    flat_field_error: float = 0.0

    def __post_init__(self) -> None:
        check_settings(self, window_px=(3, 101), psf_sigma_px=POSITIVE, flat_field_error=FROM_0)
        if self.window_px % 2 == 0:
            raise InputError(f"window_px is {self.window_px}; it must be odd, so that a pixel is in its middle")

    __pydantic_config__ = FORBID


@dataclass(frozen=True)
class TrackingSettings:
    """How stars are followed from frame to frame.

    Parameters
    ----------
    max_stars : int
        Guide stars looked for, the brightest of the field; each has a window on the image.
    max_window_px : int
        Largest half side of a window, streaks left out. Where the prediction is less certain, the whole frame is
        searched.
    prior_limit_deg : float
        Above this uncertainty about any axis the prediction is no help to identification either.
    false_rejection : float
        Probability of a good frame's being refused by the filter's gate.
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
    """Rules by which the sensor operates itself from frame to frame (Greyling 1995, sections 4.2.1 and 4.2.2).

    Parameters
    ----------
    use : bool
        Follow them; false: every frame goes to the tracker as it is, at the one exposure.
    saturated_pixels : int
        A frame whose two brightest stars each have more saturated pixels than this is discarded (Greyling 1995: 4).
    shorten : float
        Factor of the exposure after such a frame.
    shortest_exposure_s : float
        Exposure that is not gone below; a frame taken with it is used as it is.
    lengthen_below : float
        Where the brightest star stays below this share of saturation, the next exposure is longer by 1 / `shorten`, up
        to the scenario's own. 0: never.
    exposure_step_s : float
        Exposures are whole multiples of this, as the prototype's of its frame time; 0: any.
    sun_share : float
        Share of saturated pixels above which a frame shows the Sun. The Moon covers 0.003 of a field of 10°.
    suspend_turn_deg : float
        After such a frame none is taken while the camera turns by this, a little more than the Sun's diameter.
    longest_suspension_s : float
        Longest time without a frame, also where the rate is not known.
    clear_pixels : int or None
        Anything larger is cleared from the frame, as the Moon; None: `DetectionSettings.max_pixels`.
    blemish_frames : int
        Frames that tell of a blemished pixel, at least; 0: blemishes are not mapped.
    blemish_share : float
        Share of the frames in which a blemish must show.
    blemish_sigma : float
        By how many times the noise.
    blemish_shift_px : float
        How far the stars must have moved since the last frame that counts.
    reference_b_v : float
        Colour for which flux and magnitude were calibrated on the ground.
    """

    use: bool = False
    saturated_pixels: int = 4
    shorten: float = 0.5
    shortest_exposure_s: float = 0.01
    lengthen_below: float = 0.2
    exposure_step_s: float = 0.0
    sun_share: float = 0.02
    suspend_turn_deg: float = 0.6
    longest_suspension_s: float = 60.0
    clear_pixels: int | None = None
    blemish_frames: int = 5
    blemish_share: float = 0.75
    blemish_sigma: float = 5.0
    blemish_shift_px: float = 8.0
    reference_b_v: float = 0.65

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
