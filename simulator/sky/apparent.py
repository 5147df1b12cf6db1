"""Where the stars appear: space motion, parallax, bending of light by the Sun, aberration.

The order is that of the light's way: the star's place when the light left it, seen from where the observer is
(parallax), bent by the Sun on its way in, and turned by the observer's motion last.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from simulator.sky.light import aberrated, bent, unit
from startracker.catalog.stars import StarCatalog
from startracker.constants import ARCSEC_RAD, AU_KM, DAYS_PER_JULIAN_YEAR, SPEED_OF_LIGHT_KM_S
from startracker.observer import Observer

if TYPE_CHECKING:
    from simulator.scenario.schema import SkySection

__all__ = ["SkyIndex", "apparent_directions", "bend_by_sun", "by_place"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_AU_LIGHT_TIME_JYEAR = AU_KM / SPEED_OF_LIGHT_KM_S / (86_400.0 * DAYS_PER_JULIAN_YEAR)
_CELLS = 16
_SHIFT_RAD = 30.0 * ARCSEC_RAD
"""Aberration (26″ from a low orbit), deflection (1.75″) and parallax (0.8″) together, the most they can move a star."""


def apparent_directions(
    catalog: StarCatalog, observer: Observer, sun_au: ArrayLike | None, section: SkySection
) -> FloatArray:
    """Unit vectors (N, 3), GCRS axes, of the stars as the moving observer sees them.

    Parameters
    ----------
    catalog : StarCatalog
        Any number of stars; see `SkyIndex` for those of a field of view.
    observer : Observer
        Epoch, barycentric position and velocity; what is None in it leaves its effect out.
    sun_au : array_like, shape (3,), or None
        Barycentric position of the Sun; None leaves the deflection out.
    section : SkySection
        Its switches `proper_motion`, `parallax`, `light_deflection` and `aberration`.

    Notes
    -----
    Proper motion is straight space motion with the perspective term, at the instant the light passes the barycentre
    (the Rømer delay, up to 0.16 mas for Barnard's star). Deflection and aberration as ERFA's ``eraLdsun`` and
    ``eraAb`` have them. Agrees with ERFA's whole chain within 1 µas but for the 0.4 µas of ``eraAb``'s gravitational
    term; left out are the deflection by the planets and the Earth (0.6 mas at the Earth's limb, 1 mas at 5′ from
    Jupiter).
    """
    u, motion = catalog.space_motion()
    return _apparent(
        np.arange(len(catalog)), u, motion, catalog.parallax_rad, catalog.epoch_jyear, observer, sun_au, section
    )


def bend_by_sun(directions: FloatArray, from_sun_au: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) of distant sources after the Sun's gravity has bent their light; ERFA's ``eraLdsun``.

    At right angles to the Sun the light is bent by 4.07 mas, at its limb by 1.75″; inside the disc the formula is held
    back, so that nothing grows without bound.

    Parameters
    ----------
    directions : float array, shape (N, 3)
        Unit vectors from the observer, before the bending.
    from_sun_au : float array, shape (3,)
        From the Sun to the observer, au.
    """
    out = np.empty((len(directions), 3))
    _bend(np.asarray(directions, dtype=float), np.asarray(from_sun_au, dtype=float), out)
    return out


def _apparent(
    rows: IntArray,
    u: FloatArray,
    motion: FloatArray,
    parallax_rad: FloatArray,
    catalog_epoch_jyear: float,
    observer: Observer,
    sun_au: ArrayLike | None,
    section: SkySection,
) -> FloatArray:
    """`apparent_directions` of some rows of a catalogue's space motion."""
    position, velocity, sun = observer.position_au, observer.velocity_km_s, sun_au
    nowhere = np.zeros(3)
    out = np.empty((len(rows), 3))
    _directions(
        out,
        rows,
        u,
        motion,
        parallax_rad,
        observer.epoch_jyear - catalog_epoch_jyear,
        nowhere if position is None else position,
        nowhere if sun is None else np.asarray(sun, dtype=float),
        nowhere if velocity is None else velocity,
        section.proper_motion,
        section.parallax and position is not None,
        section.light_deflection and position is not None and sun is not None,
        section.aberration and velocity is not None,
    )
    return out


@njit(cache=True, error_model="numpy")
def _directions(
    out: FloatArray,
    rows: IntArray,
    u: FloatArray,
    motion: FloatArray,
    parallax_rad: FloatArray,
    years: float,
    position: FloatArray,
    sun: FloatArray,
    velocity_km_s: FloatArray,
    proper: bool,
    near: bool,
    bends: bool,
    moves: bool,
) -> None:
    """Kernel of `apparent_directions`; a switch for each effect, an observer without a place stands at zero."""
    ex, ey, ez = position[0] - sun[0], position[1] - sun[1], position[2] - sun[2]
    distance = math.sqrt(ex * ex + ey * ey + ez * ez)
    e = (ex / distance, ey / distance, ez / distance)
    velocity = (velocity_km_s[0], velocity_km_s[1], velocity_km_s[2])
    for n in range(len(rows)):
        row = rows[n]
        x, y, z = u[row, 0], u[row, 1], u[row, 2]
        if proper:
            t = years + (x * position[0] + y * position[1] + z * position[2]) * _AU_LIGHT_TIME_JYEAR
            x, y, z = x + t * motion[row, 0], y + t * motion[row, 1], z + t * motion[row, 2]
        if near:
            w = parallax_rad[row]
            x, y, z = x - w * position[0], y - w * position[1], z - w * position[2]
        p = unit(x, y, z)
        if bends:
            p = bent(p, p, e, distance, _limit(distance))
        if moves:
            p = aberrated(p, velocity)
        out[n, 0], out[n, 1], out[n, 2] = p


@njit(cache=True, error_model="numpy")
def _bend(directions: FloatArray, from_sun: FloatArray, out: FloatArray) -> None:
    """Kernel of `bend_by_sun`."""
    distance = math.sqrt(from_sun[0] ** 2 + from_sun[1] ** 2 + from_sun[2] ** 2)
    e = (from_sun[0] / distance, from_sun[1] / distance, from_sun[2] / distance)
    for n in range(len(directions)):
        p = (directions[n, 0], directions[n, 1], directions[n, 2])
        out[n, 0], out[n, 1], out[n, 2] = bent(p, p, e, distance, _limit(distance))


@njit(cache=True, error_model="numpy")
def _limit(distance_au: float) -> float:
    """``eraLdsun`` holds the bending back within 4.9′ of the Sun's centre, less from beyond 1 au."""
    return 1e-6 / max(distance_au * distance_au, 1.0)


def by_place(catalog: StarCatalog) -> StarCatalog:
    """The same stars, those of one part of the sky side by side in memory, as `SkyIndex` looks for them: the columns of
    a field are then a few pages that the processor fetches ahead, and not a cache miss a star."""
    return catalog.select(np.argsort(_cells(catalog.space_motion()[0]), kind="stable"))


def _cells(directions: FloatArray) -> IntArray:
    """Number of the cell of each unit vector (N, 3)."""
    cell = np.minimum(((directions + 1.0) * (0.5 * _CELLS)).astype(np.int64), _CELLS - 1)
    return np.asarray((cell[:, 0] * _CELLS + cell[:, 1]) * _CELLS + cell[:, 2])


class SkyIndex:
    """A catalogue that finds the stars of a field of view without a look at all the others: only at those in the same
    cells of the cube around the sphere, 16 along each edge.

    Parameters
    ----------
    catalog : StarCatalog
        The stars to be found; cut it by magnitude first.
    """

    def __init__(self, catalog: StarCatalog) -> None:
        self.catalog = catalog
        self._u, self._motion = catalog.space_motion()
        across = self._motion - self._u * np.einsum("ij,ij->i", self._u, self._motion)[:, None]
        key = _cells(self._u)
        self._order = np.argsort(key, kind="stable")
        self._starts = np.searchsorted(key[self._order], np.arange(_CELLS**3 + 1))
        self._fastest_rad_yr = float(np.sqrt((across**2).sum(axis=1).max(initial=0.0)))

    def near(self, direction: ArrayLike, radius_rad: float, epoch_jyear: float) -> IntArray:
        """Rows of the catalogue that may appear within `radius_rad` of an apparent direction, in ascending order.

        None is missed; some lie a little outside: the radius is widened by what the fastest star can have moved since
        the catalogue's epoch, and by 30″ for aberration and parallax.

        Parameters
        ----------
        direction : array_like, shape (3,)
            Unit vector, GCRS axes.
        radius_rad : float
            Half of the field's diagonal, radians.
        epoch_jyear : float
            Julian epoch of the view.
        """
        years = abs(epoch_jyear - self.catalog.epoch_jyear)
        # 1.1: perspective may quicken a star that comes near, by less than 10 % in a millennium
        reach = radius_rad + _SHIFT_RAD + 1.1 * years * self._fastest_rad_yr
        chord = 2.0 * math.sin(min(reach, math.pi) / 2.0)
        centre = np.asarray(direction, dtype=float)
        return np.sort(_within(self._u, self._order, self._starts, centre, chord * (1.0 + 1e-12)))

    def view(
        self, direction: ArrayLike, radius_rad: float, observer: Observer, sun_au: ArrayLike | None, section: SkySection
    ) -> tuple[StarCatalog, FloatArray]:
        """The stars near an apparent direction and where each appears: `near`, then `apparent_directions`.

        Returns
        -------
        StarCatalog, float array of shape (N, 3)
            Stars in the order of the catalogue, among them a few outside `radius_rad`, and apparent unit vectors.
        """
        rows = self.near(direction, radius_rad, observer.epoch_jyear)
        return self.catalog.select(rows), self.apparent(rows, observer, sun_au, section)

    def apparent(self, rows: IntArray, observer: Observer, sun_au: ArrayLike | None, section: SkySection) -> FloatArray:
        """`apparent_directions` of some rows of the catalogue."""
        catalog = self.catalog
        return _apparent(
            rows, self._u, self._motion, catalog.parallax_rad, catalog.epoch_jyear, observer, sun_au, section
        )


@njit(cache=True, error_model="numpy")
def _within(u: FloatArray, order: IntArray, starts: IntArray, centre: FloatArray, chord: float) -> IntArray:
    """Kernel: rows of the unit vectors `u` that lie no further than `chord` from `centre`, in any order."""
    low, high = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    for axis in range(3):
        low[axis] = min(max(int((centre[axis] - chord + 1.0) * (0.5 * _CELLS)), 0), _CELLS - 1)
        high[axis] = min(max(int((centre[axis] + chord + 1.0) * (0.5 * _CELLS)), 0), _CELLS - 1)
    most = 0
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            line = (i * _CELLS + j) * _CELLS
            most += starts[line + high[2] + 1] - starts[line + low[2]]
    found, count = np.empty(most, dtype=np.int64), 0
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            line = (i * _CELLS + j) * _CELLS
            for k in range(starts[line + low[2]], starts[line + high[2] + 1]):
                row = order[k]
                x, y, z = u[row, 0] - centre[0], u[row, 1] - centre[1], u[row, 2] - centre[2]
                if x * x + y * y + z * z <= chord * chord:
                    found[count] = row
                    count += 1
    return found[:count]
