"""What the tracker answers: always a status and a reason, an attitude only when the status is ``solved``."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.constants import ARCSEC_RAD

FloatArray = NDArray[np.float64]


class Status(StrEnum):
    """How a solve ended; only ``solved`` carries an attitude."""

    SOLVED = "solved"
    NO_STARS = "no_stars"
    TOO_FEW_STARS = "too_few_stars"
    SATURATED = "saturated"
    NO_MATCH = "no_match"
    AMBIGUOUS = "ambiguous"
    BAD_IMAGE = "bad_image"


@dataclass(frozen=True, eq=False)
class MatchedStars:
    """Identified stars, as columns of equal length M.

    Parameters
    ----------
    xy : array, shape (M, 2)
        Measured centroid in pixels.
    catalog_id : int array
        Number in the tracker's catalogue.
    name : str array
        Star's name where known.
    v_mag : array
        Catalogue V.
    flux : array
        Measured signal, DN.
    residual_px : array, shape (M, 2)
        Measured minus predicted, pixels.
    """

    xy: FloatArray
    catalog_id: NDArray[np.int64]
    name: NDArray[np.str_]
    v_mag: FloatArray
    flux: FloatArray
    residual_px: FloatArray

    def __len__(self) -> int:
        return len(self.catalog_id)

    @classmethod
    def none(cls) -> MatchedStars:
        """No stars."""
        empty = np.empty(0)
        return cls(np.empty((0, 2)), np.empty(0, np.int64), np.empty(0, np.str_), empty, empty, np.empty((0, 2)))


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of one solve.

    Parameters
    ----------
    status, reason : Status, str
        How it ended, and why, in words.
    attitude : Attitude, optional
        ICRS to camera; None unless solved.
    covariance : array, shape (3, 3), optional
        Of the rotation-vector error in camera axes, rad².
    stars : MatchedStars
        Identified stars.
    centroids : array, shape (N, 2)
        All star candidates found, brightest first.
    fov_deg : float, optional
        Field across the width: the camera's, or the fitted one where it was not known.
    parity : int
        +1 as the sky is seen, −1 mirrored.
    times_ms : dict
        Milliseconds a stage.
    camera : Camera, optional
        The camera that the attitude goes with: the one given, or the fitted one.
    """

    status: Status
    reason: str
    attitude: Attitude | None = None
    covariance: FloatArray | None = None
    stars: MatchedStars = field(default_factory=MatchedStars.none)
    centroids: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    fov_deg: float | None = None
    parity: int = 1
    times_ms: dict[str, float] = field(default_factory=dict)
    camera: Camera | None = None

    @property
    def solved(self) -> bool:
        """Whether there is an attitude."""
        return self.status is Status.SOLVED

    @property
    def ra_deg(self) -> float | None:
        """Right ascension of the boresight, degrees."""
        return self.attitude.ra_deg if self.attitude else None

    @property
    def dec_deg(self) -> float | None:
        """Declination of the boresight, degrees."""
        return self.attitude.dec_deg if self.attitude else None

    @property
    def roll_deg(self) -> float | None:
        """Roll, degrees: see `Attitude.roll_deg`."""
        return self.attitude.roll_deg if self.attitude else None

    @property
    def rmse_arcsec(self) -> float | None:
        """Root mean square distance of the stars from where the solution puts them, arcseconds."""
        if self.camera is None or not len(self.stars):
            return None
        squares = np.sum(self.stars.residual_px**2, axis=1)
        return float(np.sqrt(np.mean(squares)) * self.camera.pixel_rad / ARCSEC_RAD)

    @property
    def matched(self) -> int:
        """Number of identified stars."""
        return len(self.stars)
