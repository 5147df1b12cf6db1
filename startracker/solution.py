"""What the tracker answers: always a status and a reason, an attitude only when the status is ``solved``."""

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
    """How a solve ended; only ``solved`` carries an attitude."""

    SOLVED = "solved"
    NO_STARS = "no_stars"
    TOO_FEW_STARS = "too_few_stars"
    SATURATED = "saturated"
    NO_MATCH = "no_match"
    AMBIGUOUS = "ambiguous"
    SEARCH_LIMIT = "search_limit"
    BAD_IMAGE = "bad_image"
    STALE = "stale"
    """Of tracking: the frame is one that came before."""
    BAD_TIME = "bad_time"
    """Of tracking: the frame's time is none, or not after the last frame's."""


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
    used : bool array, optional
        Whether the attitude was fitted to the star; those that are off by more than noise explains (blends, defective
        pixels beside them) are named and left out. By default all.
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
        """Those that the attitude was fitted to."""
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
        Angle seen across the width, distortion included: the camera's, or the fitted one where it was not known.
    parity : int
        +1 as the sky is seen, −1 mirrored.
    times_ms : dict
        Milliseconds a stage.
    camera : Camera, optional
        The camera that the attitude goes with: the one given, or the fitted one.
    steps : sequence of Step
        What each stage found, tried and rejected, in words; `startracker.explain.as_text` prints it.
    log_false_alarm : float
        Natural logarithm of the chance that random points agree with the sky as well; 0 where nothing was found.
    operations : int
        Steps that the search took (`IdentificationSettings.max_operations`), the same on every machine.
    prior_contradicted : bool
        Whether a prior was given and the sky was found outside it.
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
        """Root mean square distance of the fitted stars from where the solution puts them, arcseconds."""
        if self.camera is None or not len(self.stars):
            return None
        squares = np.sum(self.stars.fitted.residual_px**2, axis=1)
        return float(np.sqrt(np.mean(squares)) * self.camera.pixel_rad / ARCSEC_RAD)

    @property
    def matched(self) -> int:
        """Number of identified stars."""
        return len(self.stars)

    def radec_of(self, xy: ArrayLike, observer: Observer | None = None) -> FloatArray:
        """ICRS right ascension and declination (N, 2), degrees, of pixels (N, 2); NaN where the lens model ends.

        Parameters
        ----------
        xy : array_like, shape (N, 2) or (2,)
            Columns and rows, the first pixel's centre at (0, 0); any place, off the image too.
        observer : Observer, optional
            The one that was given to `solve`. An attitude solved with an observer's velocity turns ICRS into the
            directions that the moving camera *sees*, up to 26″ from the catalogue's; with the observer given here the
            aberration is taken off and the answer is the catalogue's place. An attitude solved without one has the
            aberration in itself, and gives places as in the catalogue to within its change over the field (2.3″
            at 10° across).

        Raises
        ------
        InputError
            When the field is not solved, or the array's shape does not fit.
        """
        attitude, camera = self._placed()
        seen = attitude.inverse.apply(camera.unproject(_two_columns(xy, "pixels")))
        if observer is not None and observer.velocity_km_s is not None:
            seen = aberrate(seen, -np.asarray(observer.velocity_km_s))  # the Lorentz boost back
        return np.degrees(np.stack(direction_to_radec(seen), axis=1))

    def pixel_of(self, ra_deg: ArrayLike, dec_deg: ArrayLike, observer: Observer | None = None) -> FloatArray:
        """Pixels (N, 2) of ICRS places, degrees; NaN farther from the boresight than the image's corners.

        Beyond the corners a lens polynomial can fold back into the image. `observer` as in `radec_of`, whose inverse
        this is.

        Raises
        ------
        InputError
            When the field is not solved.
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
