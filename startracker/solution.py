"""Results of the tracker: always a status and a reason, and an attitude if the status is ``solved``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import is_skycoord, of_kind, real_array
from startracker.catalog.bodies import NO_BODIES, SeenBodies
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.display import angle_text, described, html_card, quantity_range, star_chart
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, direction_to_radec, radec_to_direction
from startracker.geometry.camera import Camera
from startracker.observer import Observer, aberrate, corrects_aberration
from startracker.trace import Step

if TYPE_CHECKING:
    from startracker.catalog.guide import GuideDatabase
    from startracker.catalog.source import CatalogSource

_NAMED_STARS = 8
"""Number of the brightest stars that are named in the chart of a notebook."""
_LONGEST_REASON = 120


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
    GYRO_MISMATCH = "gyro_mismatch"
    """Tracking: the stars are static while the gyro measures a rotation beyond its stated errors."""


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
    sigma_px : array, optional
        Standard error of each centroid on one axis, px, as stated by the centroider, including that of the catalogue;
        NaN if unknown.
    """

    xy: FloatArray
    catalog_id: NDArray[np.int64]
    name: NDArray[np.str_]
    v_mag: FloatArray
    flux: FloatArray
    residual_px: FloatArray
    used: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    sigma_px: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if len(self.used) != len(self.catalog_id):
            object.__setattr__(self, "used", np.ones(len(self.catalog_id), np.bool_))
        if len(self.sigma_px) != len(self.catalog_id):
            object.__setattr__(self, "sigma_px", np.full(len(self.catalog_id), np.nan))

    def __len__(self) -> int:
        return len(self.catalog_id)

    def __repr__(self) -> str:
        if not len(self):
            return "MatchedStars(none)"
        rms_px = float(np.sqrt(np.mean(np.sum(self.residual_px**2, axis=1))))
        count = f"{len(self)} stars" if self.used.all() else f"{len(self)} stars, {int(self.used.sum())} used"
        return described("MatchedStars", count, quantity_range("V", self.v_mag), f"residual {rms_px:.3f} px rms")

    @property
    def fitted(self) -> MatchedStars:
        """The stars used in the attitude fit."""
        if self.used.all():
            return self
        return MatchedStars(*(getattr(self, column.name)[self.used] for column in fields(self)))

    @classmethod
    def of(
        cls,
        guide: GuideDatabase,
        rows: NDArray[np.int64],
        xy: FloatArray,
        residual_px: FloatArray,
        *,
        flux: FloatArray | None = None,
        used: NDArray[np.bool_] | None = None,
        sigma_px: FloatArray | None = None,
    ) -> MatchedStars:
        """Stars identified as guide stars.

        Parameters
        ----------
        guide : GuideDatabase
            The guide stars.
        rows : int array, shape (M,)
            Row of each star among them.
        xy, residual_px : arrays, shape (M, 2)
            As in `MatchedStars`.
        flux, used, sigma_px : arrays, optional
            As in `MatchedStars`; by default not known, all, and not known.
        """
        count = len(rows)
        return cls(
            xy=xy,
            catalog_id=guide.catalog.id[rows],
            name=guide.catalog.star_name[rows],
            v_mag=guide.v_mag[rows],
            flux=np.full(count, np.nan) if flux is None else flux,
            residual_px=residual_px,
            used=np.ones(count, np.bool_) if used is None else used,
            sigma_px=np.full(count, np.nan) if sigma_px is None else sigma_px,
        )

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
    observer : Observer, optional
        The observer given. Without one, or without its velocity, aberration is not corrected: the attitude is off by up
        to 26″, and the covariance includes this (`aberration_corrected`).
    bodies : SeenBodies
        Planets, Moon and Sun among the centroids, by their ephemeris for the observer; they are not used in the
        attitude fit.
    catalog : CatalogSource, optional
        The catalogue with which the field was solved: its files with their digests, number of stars, epoch and depth.
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
    observer: Observer | None = None
    bodies: SeenBodies = field(default=NO_BODIES)
    catalog: CatalogSource | None = None

    def __repr__(self) -> str:
        if self.attitude is None:
            reason = self.reason if len(self.reason) <= _LONGEST_REASON else f"{self.reason[: _LONGEST_REASON - 1]}…"
            return described("Solution", self.status, f"'{reason}'", f"{len(self.centroids)} centroids")
        return described("Solution", self.status, *self._facts())

    def _facts(self) -> tuple[str, ...]:
        """Attitude, number of stars and standard errors as short texts."""
        where = f"RA {self.ra_deg:.4f}°", f"Dec {self.dec_deg:+.4f}°", f"roll {self.roll_deg:.2f}°"
        sigma = self.sigma_arcsec
        accuracy = ""
        if sigma is not None:
            across, about = angle_text(float(sigma[:2].max()) * ARCSEC_RAD), angle_text(float(sigma[2]) * ARCSEC_RAD)
            accuracy = f"σ {across}/{about}"
        aberration = "" if self.aberration_corrected else "aberration not corrected"
        return *where, f"{len(self.stars)} stars", accuracy, aberration

    def _repr_html_(self) -> str:
        """Status, attitude and accuracy with a chart of the centroids, for notebooks."""
        rows = {"reason": self.reason, "centroids": str(len(self.centroids))}
        if self.attitude is not None:
            *where, stars, accuracy, aberration = self._facts()
            rows = {"boresight": ", ".join(where), "stars": f"{stars} of {len(self.centroids)} centroids"}
            if len(self.bodies.name):
                rows["solar system"] = ", ".join(self.bodies.name.tolist())
            rows |= {"1σ across / about": accuracy.removeprefix("σ ").replace("/", " / "), "reason": self.reason}
            rows["aberration"] = f"{aberration}; the standard errors include it" if aberration else "corrected"
        rows["field of view"] = f"{self.fov_deg:.2f}°" if self.fov_deg else ""
        return html_card(f"Solution: {self.status}", rows, self._chart())

    def _chart(self) -> str:
        """SVG chart of the centroids with the brightest stars named; empty without a camera or centroids."""
        from startracker.catalog.names import designation, proper_name

        if self.camera is None or not len(self.centroids):
            return ""
        order = np.argsort(self.stars.v_mag)
        names = [proper_name(name) or designation(name) for name in self.stars.name[order]]
        named = [name if k < _NAMED_STARS else "" for k, name in enumerate(names)]
        size = self.camera.width, self.camera.height
        radius = np.clip(7.0 - self.stars.v_mag[order], 1.5, 7.0)
        return star_chart(size, self.centroids, self.stars.xy[order], radius, named)

    def without_bodies(self, values: FloatArray) -> FloatArray:
        """Values (N,) of the centroids other than those of bodies of the solar system."""
        return np.delete(values, self.bodies.centroid) if len(self.bodies.centroid) else values

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
    def skycoord(self) -> Any:
        """The boresight as an astropy ``SkyCoord`` (ICRS); None unless solved."""
        return self.attitude.skycoord if self.attitude else None

    @property
    def rotation(self) -> Any:
        """The attitude as a SciPy ``Rotation``, v_camera = rotation.apply(v_icrs); None unless solved."""
        return self.attitude.rotation if self.attitude else None

    @property
    def wcs(self) -> Any:
        """The world coordinate system as an astropy ``WCS``: pixels to catalogue positions, ICRS (`wcs_header`).

        Raises
        ------
        InputError
            If the field is not solved, or the lens cannot be described by a WCS.
        """
        from astropy.wcs import WCS

        from startracker.wcs import wcs_header

        attitude, camera = self._placed()
        velocity = self.observer.velocity_km_s if self.observer else None
        return WCS(wcs_header(camera, attitude, velocity))

    @property
    def sigma_arcsec(self) -> FloatArray | None:
        """Standard errors (3,) about the camera's x, y and z (boresight) axes, arcseconds; None unless solved."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance)) / ARCSEC_RAD

    @property
    def aberration_corrected(self) -> bool:
        """Whether the observer's velocity was given, so that the attitude is free of aberration."""
        return corrects_aberration(self.observer)

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
            By default the solution's own. With its velocity, aberration is removed, and the result is the catalogue
            position. An attitude solved without one includes the aberration, and gives catalogue positions to within
            its variation over the field (2.3″ for 10°).

        Raises
        ------
        InputError
            If the field is not solved or the shape of the array is wrong.
        """
        attitude, camera = self._placed()
        seen = attitude.inverse.apply(camera.unproject(xy))
        velocity = self._velocity_km_s(observer)
        if velocity is not None:
            # Aberration is a Lorentz boost; the opposite velocity inverts it.
            seen = aberrate(seen, -velocity)
        return np.degrees(np.stack(direction_to_radec(seen), axis=1))

    def pixel_of(self, ra_deg: Any, dec_deg: Any = None, observer: Observer | None = None) -> FloatArray:
        """Pixels (N, 2) of ICRS positions; NaN farther from the boresight than the image's corners.

        Positions are right ascension and declination, degrees or astropy quantities, or one astropy ``SkyCoord``.

        Beyond the corners a lens polynomial can fold back into the image. Inverse of `radec_of`, with the same
        `observer`.

        Raises
        ------
        InputError
            If the field is not solved.
        """
        attitude, camera = self._placed()
        if is_skycoord(ra_deg):
            ra_deg, dec_deg = ra_deg.icrs.ra, ra_deg.icrs.dec
        if dec_deg is None:
            raise InputError("pixel_of needs right ascension and declination, degrees, or an astropy SkyCoord")
        ra_deg = np.atleast_1d(real_array("ra_deg", ra_deg, unit="deg", finite=False))
        dec_deg = np.atleast_1d(real_array("dec_deg", dec_deg, unit="deg", finite=False))
        try:
            given = np.stack(np.broadcast_arrays(ra_deg, dec_deg))
        except ValueError:
            shapes = f"{ra_deg.shape} and {dec_deg.shape}"
            raise InputError(f"right ascensions and declinations must have the same shape; got {shapes}") from None
        ra, dec = np.radians(np.where(np.isfinite(given), given, np.nan))
        seen = radec_to_direction(ra.ravel(), dec.ravel())
        velocity = self._velocity_km_s(observer)
        if velocity is not None:
            seen = aberrate(seen, velocity)
        vectors = attitude.apply(seen)
        angle = np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])
        inside = angle <= camera.half_diagonal_rad + camera.pixel_rad
        pixels = np.full((len(vectors), 2), np.nan)
        pixels[inside] = camera.project(vectors[inside])
        return pixels

    def _velocity_km_s(self, observer: Observer | None) -> FloatArray | None:
        of_kind("observer", observer, (Observer, type(None)))
        given = observer if observer is not None else self.observer
        return given.velocity_km_s if given is not None else None

    def _placed(self) -> tuple[Attitude, Camera]:
        if self.attitude is None or self.camera is None:
            raise InputError(f"a field that is not solved has no coordinates ({self.status}: {self.reason})")
        return self.attitude, self.camera
