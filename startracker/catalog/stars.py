"""The star catalogue: an immutable table that can be propagated to any epoch."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import julian_year, real_array, real_number, text
from startracker.catalog.source import CatalogSource, depth_of
from startracker.core import ARCSEC_RAD, AU_KM, DAYS_PER_JULIAN_YEAR, MAS_RAD, FloatArray
from startracker.display import described, quantity_range
from startracker.errors import InputError
from startracker.geometry.attitude import direction_to_radec, radec_to_direction

_OF_THE_WHOLE = ("name", "epoch_jyear", "position_sigma_rad", "source")
_AU_PER_YEAR_IN_KM_S = AU_KM / (DAYS_PER_JULIAN_YEAR * 86_400.0)


@dataclass(frozen=True, eq=False)
class StarCatalog:
    """Stars as columns of equal length N; every array is read-only.

    Parameters
    ----------
    name : str
        Name of the catalogue.
    epoch_jyear : float
        Julian epoch of the positions (TT/TCB; the difference is far below the catalogues' errors).
    id : int array
        Number in the catalogue (HR for ``bsc5``, HIP for ``hipparcos``; negative: minus the HR number of a bright
        star that Hipparcos lacks; ``gaia``: as ``hipparcos``, and Gaia's source_id for the stars it adds).
    ra_rad, dec_rad : float array
        ICRS position at `epoch_jyear`.
    pm_ra_rad_yr, pm_dec_rad_yr : float array
        Proper motion, radians per Julian year; RA multiplied by cos Dec.
    parallax_rad, radial_velocity_km_s : float array
        Zero where unknown.
    v_mag : float array
        Johnson V.
    b_v : float array
        B − V; NaN where unknown.
    spectral_type : str array
        Empty where unknown.
    star_name : str array
        Bayer/Flamsteed or proper name; empty where unknown.
    position_sigma_rad : float
        Standard error of the positions on one axis, which the tracker adds to the errors of its centroids.
    variable : bool array
        Whether the catalogue lists the star as variable; all False by default. A variable star may be brighter or
        fainter than `v_mag`.
    star_sigma_rad : float array
        Standard error of the position of each star on one axis; by default `position_sigma_rad` for all. If they
        differ, the `position_sigma_rad` of a selection of stars is their root mean square.
    source : CatalogSource, optional
        Files from which the stars were read, for the records of results.
    """

    name: str
    epoch_jyear: float
    id: NDArray[np.int64]
    ra_rad: FloatArray
    dec_rad: FloatArray
    pm_ra_rad_yr: FloatArray
    pm_dec_rad_yr: FloatArray
    parallax_rad: FloatArray
    radial_velocity_km_s: FloatArray
    v_mag: FloatArray
    b_v: FloatArray
    spectral_type: NDArray[np.str_]
    star_name: NDArray[np.str_]
    position_sigma_rad: float = 0.1 * ARCSEC_RAD
    variable: NDArray[np.bool_] = field(default=cast("NDArray[np.bool_]", None))  # None: no known variables
    star_sigma_rad: FloatArray = field(default=cast("FloatArray", None))  # None: `position_sigma_rad`
    source: CatalogSource | None = None

    def __repr__(self) -> str:
        magnitudes = quantity_range("V", self.v_mag)
        return described("StarCatalog", self.name, f"{len(self):,} stars", magnitudes, f"epoch {self.epoch_jyear:g}")

    def __post_init__(self) -> None:
        text("name", self.name)
        for name in ("epoch_jyear", "position_sigma_rad"):
            real_number(name, getattr(self, name))
        try:
            n = np.size(self.id)
        except ValueError:
            raise InputError(f"catalogue {self.name}: column 'id' must be an array") from None
        if cast("object", self.variable) is None:
            object.__setattr__(self, "variable", np.zeros(n, dtype=bool))
        if cast("object", self.star_sigma_rad) is None:
            object.__setattr__(self, "star_sigma_rad", np.full(n, float(self.position_sigma_rad)))
        for column in self.columns():
            try:
                array = _unchangeable(getattr(self, column))
            except ValueError:  # rows of different lengths
                raise InputError(f"catalogue {self.name}: column '{column}' must be an array") from None
            if array.shape != (n,):
                raise InputError(f"catalogue {self.name}: column '{column}' has {array.shape} values, not ({n},)")
            object.__setattr__(self, column, array)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Unpickle with read-only columns: numba treats writeable arrays as another type, and would compile the kernels
        again."""
        for name, value in state.items():
            object.__setattr__(self, name, read_only(value) if isinstance(value, np.ndarray) else value)

    @classmethod
    def of_stars(cls, name: str, epoch_jyear: float, star_sigma_rad: FloatArray, **given: Any) -> StarCatalog:
        """Catalogue of stars with errors of their own, whose rms is its error. Parallax, radial velocity, spectral type
        and name may be unknown."""
        n = len(star_sigma_rad)
        unknown: dict[str, Any] = {
            **dict.fromkeys(("parallax_rad", "radial_velocity_km_s"), np.zeros(n)),
            **dict.fromkeys(("spectral_type", "star_name"), np.full(n, "")),
        }
        return cls(
            name,
            epoch_jyear,
            position_sigma_rad=rms(star_sigma_rad),
            star_sigma_rad=star_sigma_rad,
            **(unknown | given),
        )

    @classmethod
    def columns(cls) -> list[str]:
        """Names of the columns."""
        return [f.name for f in fields(cls) if f.name not in _OF_THE_WHOLE]

    def __len__(self) -> int:
        return len(self.id)

    def select(self, index: NDArray[Any]) -> StarCatalog:
        """Part of the catalogue, by boolean mask or by index array."""
        try:
            columns: dict[str, Any] = {c: read_only(np.atleast_1d(getattr(self, c)[index])) for c in self.columns()}
        except (IndexError, TypeError, ValueError) as error:
            raise InputError(f"a part of {self.name} needs a boolean mask or an array of rows: {error}") from None
        sigma = columns["star_sigma_rad"]
        if len(sigma) and (sigma != sigma[0]).any():
            columns["position_sigma_rad"] = rms(sigma)
        return replace(self, **columns)

    @property
    def provenance(self) -> CatalogSource:
        """Files, number of stars, epoch and depth; of a table made in memory without files."""
        if self.source is not None:
            return self.source
        return CatalogSource(self.name, len(self), self.epoch_jyear, depth_of(self.v_mag))

    def brighter_than(self, magnitude: float) -> StarCatalog:
        """Stars with V ≤ `magnitude`, brightest first."""
        keep = np.flatnonzero(self.v_mag <= real_number("magnitude", magnitude, finite=False))
        return self.select(keep[np.argsort(self.v_mag[keep], kind="stable")])

    def space_motion(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors (N, 3) at the catalogue's epoch and their space motion (N, 3) per Julian year.

        The motion combines the proper motion with the radial velocity's perspective term: u + τ·m points to the star
        τ years later (Hipparcos catalogue, ESA SP-1200, vol. 1, eq. 1.2.11 to 1.2.13).
        """
        u = radec_to_direction(self.ra_rad, self.dec_rad)
        east, north = _east_north(self.ra_rad, self.dec_rad)
        radial = self.radial_velocity_km_s * self.parallax_rad / _AU_PER_YEAR_IN_KM_S
        motion = east * self.pm_ra_rad_yr[:, None] + north * self.pm_dec_rad_yr[:, None] + u * radial[:, None]
        return u, motion

    def directions(self, epoch_jyear: float, observer_au: FloatArray | None = None) -> FloatArray:
        """ICRS unit vectors (N, 3) at an epoch, from the barycentre or from `observer_au`.

        Parameters
        ----------
        epoch_jyear : float or astropy Time
            Julian epoch (TT), for example 2026.22; linear space motion is accurate to a milliarcsecond over centuries.
        observer_au : float array, shape (3,), optional
            Observer's barycentric position in au (ICRS); adds the annual parallax.
        """
        u, motion = self.space_motion()
        u = u + (real_number("epoch_jyear", julian_year(epoch_jyear)) - self.epoch_jyear) * motion
        if observer_au is not None:
            u = u - self.parallax_rad[:, None] * real_array("observer_au", observer_au, (3,))
        return np.asarray(u / np.linalg.norm(u, axis=1, keepdims=True), dtype=np.float64)

    def at_epoch(self, epoch_jyear: float) -> StarCatalog:
        """The same stars with position, motion and distance at another epoch (Julian year, TT, or astropy Time).

        For a star without parallax the change of the radial motion is lost: an error of (μ τ)² in the position, 4 mas
        for 1″ per year over 30 years.
        """
        u, motion = self.space_motion()
        epoch_jyear = real_number("epoch_jyear", julian_year(epoch_jyear))
        moved = u + (epoch_jyear - self.epoch_jyear) * motion
        distance = np.linalg.norm(moved, axis=1)
        ra, dec = direction_to_radec(moved)
        east, north = _east_north(ra, dec)
        # Radial component of the motion, in distances per year; with the parallax it is a velocity.
        radial = np.einsum("ij,ij->i", moved, motion) / distance
        near = self.parallax_rad > 0.0
        speed = radial[near] * _AU_PER_YEAR_IN_KM_S / self.parallax_rad[near]
        columns = {column: getattr(self, column) for column in self.columns()}
        columns |= {
            "ra_rad": ra,
            "dec_rad": dec,
            "pm_ra_rad_yr": np.einsum("ij,ij->i", east, motion) / distance,
            "pm_dec_rad_yr": np.einsum("ij,ij->i", north, motion) / distance,
            "parallax_rad": self.parallax_rad / distance,
            "radial_velocity_km_s": self.radial_velocity_km_s.copy(),
        }
        columns["radial_velocity_km_s"][near] = speed
        return replace(self, epoch_jyear=epoch_jyear, **columns)


def rms(values: FloatArray) -> float:
    """Root mean square; 0 for no values."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _unchangeable(column: ArrayLike) -> NDArray[Any]:
    """A read-only column: a copy, unless the array and its base are already read-only."""
    array = np.asarray(column)
    owner = array if array.base is None else array.base
    shared = isinstance(owner, np.ndarray) and not owner.flags.writeable and not array.flags.writeable
    return array if shared else read_only(np.array(array))


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Make an array and its base read-only and return it."""
    array.flags.writeable = False
    if isinstance(array.base, np.ndarray):
        array.base.flags.writeable = False
    return array


def _east_north(ra_rad: FloatArray, dec_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (N, 3) to the east and to the north at each position."""
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra_rad), np.cos(ra_rad), np.sin(dec_rad), np.cos(dec_rad)
    east = np.stack([-sin_ra, cos_ra, np.zeros_like(sin_ra)], axis=1)
    return east, np.stack([-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec], axis=1)


def mas(values: FloatArray) -> FloatArray:
    """Milliarcseconds to radians."""
    return np.asarray(values, dtype=float) * MAS_RAD
