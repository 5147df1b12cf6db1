"""Results of the tracker: always a status and a reason, and an attitude if the status is ``solved``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.attitude import Attitude, direction_to_radec, radec_to_direction
from startracker.camera import Camera
from startracker.constants import ARCSEC_RAD
from startracker.errors import InputError
from startracker.observer import Observer, aberrate
from startracker.trace import Step

FloatArray = NDArray[np.float64]


class Status(StrEnum):
    """Outcome of a solve; only ``solved`` has an attitude."""

    SOLVED = "solved"
    NO_STARS = "no_stars"
    TOO_FEW_STARS = "too_few_stars"
    SATURATED = "saturated"
    NO_MATCH = "no_match"
    AMBIGUOUS = "ambiguous"
    SEARCH_LIMIT = "search_limit"
    BAD_IMAGE = "bad_image"
    STALE = "stale"
    """Tracking: the frame was already processed."""
    BAD_TIME = "bad_time"
    """Tracking: the frame's time is invalid, or not after that of the last frame."""


@dataclass(frozen=True, eq=False)
class MatchedStars:
    """Identified stars, as columns of equal length M.

    Parameters
    ----------
    xy : array, shape (M, 2)
        Measured centroids in pixels.
    catalog_id : int array
        Number in the tracker's catalogue.
    name : str array
        Name of the star, if known.
    v_mag : array
        Catalogue V.
    flux : array
        Measured signal, DN.
    residual_px : array, shape (M, 2)
        Measured minus predicted, pixels.
    used : bool array, optional
        Whether the star was used in the attitude fit; stars with larger residuals than noise explains (blends, nearby
        defective pixels) are identified but not used. By default all.
    """

    xy: FloatArray
    catalog_id: NDArray[np.int64]
    name: NDArray[np.str_]
    v_mag: FloatArray
    flux: FloatArray
    residual_px: FloatArray
    used: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))

    def __post_init__(self) -> None:
        if len(self.used) != len(self.catalog_id):
            object.__setattr__(self, "used", np.ones(len(self.catalog_id), np.bool_))

    def __len__(self) -> int:
        return len(self.catalog_id)

    @property
    def fitted(self) -> MatchedStars:
        """The stars used in the attitude fit."""
        if self.used.all():
            return self
        return MatchedStars(*(getattr(self, column.name)[self.used] for column in fields(self)))

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
        Outcome, and its reason as text.
    attitude : Attitude, optional
        ICRS to camera; None unless solved.
    covariance : array, shape (3, 3), optional
        Covariance of the rotation-vector error in camera axes, rad².
    stars : MatchedStars
        Identified stars.
    centroids : array, shape (N, 2)
        All star candidates found, brightest first.
    fov_deg : float, optional
        Field of view across the width, with distortion: the camera's, or the fitted one if it was not known.
    parity : int
        +1 direct, −1 mirrored.
    times_ms : dict
        Time of each stage, milliseconds.
    camera : Camera, optional
        The camera to which the attitude refers: given or fitted.
    steps : sequence of Step
        What each stage found, tried and rejected; `startracker.explain.as_text` formats it.
    log_false_alarm : float
        Natural logarithm of the probability that random points match the sky as well; 0 if nothing was found.
    operations : int
        Operations of the search (`IdentificationSettings.max_operations`), the same on every machine.
    prior_contradicted : bool
        Whether a prior was given and the attitude was found outside it.
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
    steps: Sequence[Step] = ()
    log_false_alarm: float = 0.0
    operations: int = 0
    prior_contradicted: bool = False

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
        """Root-mean-square residual of the fitted stars, arcseconds."""
        if self.camera is None or not len(self.stars):
            return None
        squares = np.sum(self.stars.fitted.residual_px**2, axis=1)
        return float(np.sqrt(np.mean(squares)) * self.camera.pixel_rad / ARCSEC_RAD)

    @property
    def matched(self) -> int:
        """Number of identified stars."""
        return len(self.stars)

    def radec_of(self, xy: ArrayLike, observer: Observer | None = None) -> FloatArray:
        """ICRS right ascension and declination (N, 2), degrees, of pixels (N, 2); NaN outside the lens model's limit.

        Parameters
        ----------
        xy : array_like, shape (N, 2) or (2,)
            Columns and rows, the first pixel's centre at (0, 0); may lie outside the image.
        observer : Observer, optional
            The observer passed to `solve`. An attitude solved with an observer's velocity transforms ICRS to *apparent*
            directions, up to 26″ from the catalogue's; given the observer, aberration is removed and the result is the
            catalogue position. An attitude solved without an observer includes the aberration, and gives catalogue
            positions to within its variation over the field (2.3″ for 10°).

        Raises
        ------
        InputError
            If the field is not solved or the shape of the array is wrong.
        """
        attitude, camera = self._placed()
        seen = attitude.inverse.apply(camera.unproject(_two_columns(xy, "pixels")))
        if observer is not None and observer.velocity_km_s is not None:
            seen = aberrate(seen, -np.asarray(observer.velocity_km_s))  # the Lorentz boost back
        return np.degrees(np.stack(direction_to_radec(seen), axis=1))

    def pixel_of(self, ra_deg: ArrayLike, dec_deg: ArrayLike, observer: Observer | None = None) -> FloatArray:
        """Pixels (N, 2) of ICRS positions, degrees; NaN farther from the boresight than the image's corners.

        Beyond the corners a lens polynomial can fold back into the image. Inverse of `radec_of`, with the same
        `observer`.

        Raises
        ------
        InputError
            If the field is not solved.
        """
        attitude, camera = self._placed()
        ra, dec = np.broadcast_arrays(np.atleast_1d(np.radians(ra_deg)), np.atleast_1d(np.radians(dec_deg)))
        seen = radec_to_direction(ra.ravel(), dec.ravel())
        if observer is not None and observer.velocity_km_s is not None:
            seen = aberrate(seen, observer.velocity_km_s)
        vectors = attitude.apply(seen)
        angle = np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])
        inside = angle <= camera.half_diagonal_rad + camera.pixel_rad
        pixels = np.full((len(vectors), 2), np.nan)
        pixels[inside] = camera.project(vectors[inside])
        return pixels

    def _placed(self) -> tuple[Attitude, Camera]:
        if self.attitude is None or self.camera is None:
            raise InputError(f"a field that is not solved has no coordinates ({self.status}: {self.reason})")
        return self.attitude, self.camera


def _two_columns(values: ArrayLike, what: str) -> FloatArray:
    table = np.atleast_2d(np.asarray(values, dtype=float))
    if table.ndim != 2 or table.shape[1] != 2:
        raise InputError(f"{what} must have the shape (N, 2), columns x and y; got {np.shape(values)}")
    return table
