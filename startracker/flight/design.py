"""What a flight build is made for: a camera, its guide stars, its detector and the settings of its tracker."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from startracker.catalog.guide import GuideDatabase
from startracker.errors import InputError
from startracker.geometry.camera import Camera
from startracker.settings import CentroidSettings, DetectionSettings, IdentificationSettings, TrackingSettings
from startracker.tracking.mekf import GyroNoise, RateNoise

ARITHMETICS = ("fixed", "float")
IDENTIFIERS = ("adaptive", "triads")
COARSEST_PIXEL_DEG = 0.12
"""Largest pixels: the product of the largest variance of a position and the square of a pixel's angle must fit into 63
bits."""


@dataclass(frozen=True)
class DetectorNumbers:
    """What the tracker knows of its detector.

    Parameters
    ----------
    gain_e_per_dn : float
        Electrons per digital number.
    read_noise_e : float
        Standard deviation of the noise of a pixel without light, electrons.
    saturation_dn : int
        Pixels of this value or more are saturated, DN.
    """

    gain_e_per_dn: float
    read_noise_e: float
    saturation_dn: int


@dataclass(frozen=True, eq=False)
class FlightDesign:
    """Input of a flight build.

    Parameters
    ----------
    camera : Camera
        Calibrated camera.
    guide : GuideDatabase
        Guide stars at the mission's epoch, without aberration, brightest first.
    detector : DetectorNumbers, optional
        None: the build has no front end and takes lists of centroids only, no frames.
    psf_sigma_px : float
        Standard deviation of a Gaussian fitted to the star images, pixels; for the front end.
    detection, centroid, identification : settings
        Those of `StarTracker`.
    arithmetic : str
        ``fixed``: integers only; ``float``: attitudes and directions in single precision.
    identifier : str
        ``adaptive`` or ``triads``.
    motion : RateNoise or GyroNoise
        Motion of the camera between frames, for the tracking.
    tracking : TrackingSettings
    name : str
        Of the scenario, for the version in the object.
    digest : str
        Of the scenario.

    Raises
    ------
    InputError
        For an unknown arithmetic or identifier, or a camera with pixels above `COARSEST_PIXEL_DEG`.
    """

    camera: Camera
    guide: GuideDatabase
    detector: DetectorNumbers | None = None
    psf_sigma_px: float = 1.0
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    centroid: CentroidSettings = field(default_factory=CentroidSettings)
    identification: IdentificationSettings = field(default_factory=IdentificationSettings)
    arithmetic: str = "fixed"
    identifier: str = "adaptive"
    motion: RateNoise | GyroNoise = field(default_factory=RateNoise)
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    name: str = ""
    digest: str = ""

    def __post_init__(self) -> None:
        for key, known in (("arithmetic", ARITHMETICS), ("identifier", IDENTIFIERS)):
            if getattr(self, key) not in known:
                raise InputError(f"{key} must be {' or '.join(known)}; got {getattr(self, key)!r}")
        pixel_deg = math.degrees(self.camera.pixel_rad)
        if pixel_deg > COARSEST_PIXEL_DEG:
            raise InputError(
                f"a flight build needs pixels of at most {COARSEST_PIXEL_DEG}°, the camera's are {pixel_deg:.2f}°"
            )

    @property
    def takes_frames(self) -> bool:
        """Whether the build has a front end."""
        return self.detector is not None

    @property
    def front_detector(self) -> DetectorNumbers:
        """Numbers of the detector for the front end.

        Raises
        ------
        InputError
            For a design without them.
        """
        if self.detector is None:
            raise InputError("a flight build of frames needs the numbers of its detector; give DetectorNumbers")
        return self.detector
