"""One image of a calibration: its centroids, the catalogue stars in its field, and the identified ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from startracker.arguments import of_kind, real_array, text, whole_number
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.stars import StarCatalog
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.display import described
from startracker.estimation.association import nearest_unique
from startracker.geometry.camera import Camera
from startracker.geometry.lens_fit import Matches
from startracker.observer import Observer, aberrate
from startracker.solution import Solution
from startracker.tracker import StarTracker


@dataclass(frozen=True, eq=False)
class IdentifiedStars(Matches):
    """Stars of one frame: positions (M, 2) with standard errors, pixels, and apparent directions (M, 3), ICRS axes.

    The directions must include aberration: without it the focal length is wrong by up to 100 ppm.
    """

    catalog_id: IntArray
    """Catalogue number of each star, (M,), by which it is recognised in later frames."""
    flux: FloatArray
    """Signal, DN, (M,), of which only the order is used; NaN if unknown."""

    @classmethod
    def of(cls, solution: Solution, tracker: StarTracker) -> IdentifiedStars:
        """The fitted stars of a solved frame; if their errors are unknown, they are estimated from the residuals."""
        of_kind("solution", solution, Solution)
        stars, guide = solution.stars.fitted, of_kind("tracker", tracker, StarTracker).guide
        sigma_px = stars.sigma_px
        if not np.isfinite(sigma_px).all():
            freedom = max(2 * len(stars) - 3, 1)
            sigma_px = np.full(len(stars), math.sqrt(float(np.sum(stars.residual_px**2)) / freedom))
        directions = guide.apparent_to(solution.observer).directions[guide.rows_of(stars.catalog_id)]
        return cls(stars.xy, directions, sigma_px, stars.catalog_id, stars.flux)

    def __len__(self) -> int:
        return len(self.xy)

    def select(self, chosen: BoolArray) -> IdentifiedStars:
        """The selected stars."""
        measured = self.xy[chosen], self.directions[chosen], self.sigma_px[chosen]
        return IdentifiedStars(*measured, self.catalog_id[chosen], self.flux[chosen])


_RESOLVED_PX = 2.0
_MOTION_RAD = math.radians(0.1)


@dataclass(frozen=True, eq=False)
class StarField:
    """Centroids of one image.

    Parameters
    ----------
    name : str
        Name in reports.
    xy : (N, 2)
        Pixels, brightest first.
    width, height : int
        Size of the image, px.
    flux : (N,), optional
        Signal in any linear unit; must be positive.
    variance_px2 : (N,), optional
        Variance of each centroid on one axis; None: all equal.
    observer : Observer, optional
        Epoch, velocity and position. Without it positions at the catalogue's epoch are used.

    Raises
    ------
    InputError
        For an argument of another type or shape.
    """

    name: str
    xy: FloatArray
    width: int
    height: int
    flux: FloatArray | None = None
    variance_px2: FloatArray | None = None
    observer: Observer | None = None

    def __post_init__(self) -> None:
        text("name", self.name)
        object.__setattr__(self, "xy", real_array("xy", self.xy, (None, 2), finite=False))
        for name in ("width", "height"):
            object.__setattr__(self, name, whole_number(name, getattr(self, name), least=1))
        for name in ("flux", "variance_px2"):
            if (given := getattr(self, name)) is not None:
                object.__setattr__(self, name, real_array(name, given, (len(self.xy),), finite=False))
        of_kind("observer", self.observer, (Observer, type(None)))

    def __repr__(self) -> str:
        return described("StarField", self.name, f"{len(self.xy)} centroids", f"{self.width}×{self.height} px")


@dataclass(frozen=True, eq=False)
class SkyPart:
    """Catalogue stars in and around one field, with unresolved doubles merged."""

    catalog: StarCatalog
    directions: FloatArray


def sky_part(catalog: StarCatalog, observer: Observer | None, matrix: FloatArray, camera: Camera) -> SkyPart:
    """All stars of the catalogue within the field and a tenth around it, in apparent directions for the observer."""
    reach = min(1.1 * camera.half_diagonal_rad + _MOTION_RAD, math.pi)
    axis = matrix[2]
    # Stars are selected at the catalogue's epoch; `_MOTION_RAD` is more than any star moves until the image.
    near = np.flatnonzero(catalog.directions(catalog.epoch_jyear) @ axis >= math.cos(reach))
    part = merge_doubles(catalog.select(near), min(_RESOLVED_PX * camera.pixel_rad, 0.01))
    if observer is None:
        return SkyPart(part, part.directions(part.epoch_jyear))
    directions = part.directions(observer.epoch_jyear, observer.position_au)
    if observer.velocity_km_s is not None:
        directions = aberrate(directions, observer.velocity_km_s)
    return SkyPart(part, directions)


def pair_up(
    xy: FloatArray,
    flux: FloatArray | None,
    predicted: FloatArray,
    v_mag: FloatArray,
    gate_px: FloatArray,
    most_mag: float,
) -> tuple[IntArray, int]:
    """Pairs (M, 2) of centroids and nearest stars within a gate, and the number rejected because of their brightness.

    A pair whose brightness differs by more than `most_mag` from the median zero point of the field is a mismatch, such
    as a faint star near a planet, or a hot pixel at the position of a faint star.
    """
    visible = np.flatnonzero(np.isfinite(predicted).all(axis=1))
    near, _ = nearest_unique(xy, predicted[visible], gate_px)
    seen = np.flatnonzero(near >= 0)
    pairs = np.stack([seen, visible[near[seen]]], axis=1)
    # The median zero point of fewer pairs could be that of a mismatch.
    if flux is None or len(pairs) < 5:
        return pairs, 0
    zero = -2.5 * np.log10(flux[pairs[:, 0]]) - v_mag[pairs[:, 1]]
    like = np.abs(zero - np.median(zero)) <= most_mag
    return pairs[like], int(np.sum(~like))
