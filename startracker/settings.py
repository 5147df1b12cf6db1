"""Settings of the tracker's stages: every knob with its unit, its default and its meaning, in one place.

The simulator's scenario schema validates these same classes, so that a scenario, the Python interface and the
documentation can never name different knobs.
"""

from __future__ import annotations

from dataclasses import dataclass

_FORBID = {"extra": "forbid"}  # read by pydantic, which this package does not import


@dataclass(frozen=True)
class DetectionSettings:
    """How star images are found.

    Parameters
    ----------
    threshold_sigma : float
        A pixel belongs to a star candidate above background + this many times the noise.
    min_pixels, max_pixels : int
        Size limits of a candidate (the thesis: 7 to 36 for its 3×3 and larger blur spots).
    max_axis_ratio : float
        Ratio of the second moments along the two principal axes above which a candidate is a streak or an edge; the
        thesis' 0.7 to 1.3 is 1.3. Generous by default, as smear elongates true stars.
    max_stars : int
        Brightest candidates kept.
    background_tile_px : int
        Size of the tiles in which the local background and its noise are estimated.
    search_step_px : int
        Region growing's search pattern: every third pixel, as in the thesis.
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

    __pydantic_config__ = _FORBID


@dataclass(frozen=True)
class CentroidSettings:
    """How a candidate's position is measured.

    Parameters
    ----------
    window_px : int
        Odd side of the window around the brightest pixel (the thesis: 5).
    bias_correction : bool
        Take off the moment's known bias at each sub-pixel phase (thesis Table 4.1), for `psf_sigma_px`.
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

    __pydantic_config__ = _FORBID


@dataclass(frozen=True)
class IdentificationSettings:
    """How stars are identified (thesis section 5.2).

    Parameters
    ----------
    separation_tolerance_deg : float or None
        Largest difference between a measured and a catalogued separation; None: from the camera and the centroids'
        errors. The thesis' program used 0.2°.
    magnitude_tolerance : float
        Largest difference between measured and catalogued magnitude after the frame's zero point is taken off.
    min_stars, max_stars : int
        Fewest stars to accept; most (brightest) stars to use.
    group_threshold : int
        First limit on the match-group size; lowered from the largest group found.
    max_groups_per_star : int
        Match groups kept for each observed star (the thesis' group size limit).
    close_pair_deg, close_pair_magnitude : float
        Guide stars with a neighbour closer than this and less than this much fainter are left out.
    false_alarm_rate : float
        Accept an identification only when the sky gives such agreement by chance less often than this, a frame.
    """

    separation_tolerance_deg: float | None = None
    magnitude_tolerance: float = 2.0
    min_stars: int = 3
    max_stars: int = 8
    group_threshold: int = 5
    max_groups_per_star: int = 11
    close_pair_deg: float = 0.08
    close_pair_magnitude: float = 0.77
    false_alarm_rate: float = 1e-7

    __pydantic_config__ = _FORBID


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

    __pydantic_config__ = _FORBID
