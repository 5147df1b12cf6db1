"""Where the stars appear: space motion, parallax, bending of light by the Sun, aberration.

The order is that of the light's way: the star's place when the light left it, seen from where the observer is
(parallax), bent by the Sun on its way in, and turned by the observer's motion last.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from startracker.catalog.stars import StarCatalog
from startracker.constants import ARCSEC_RAD, AU_KM, DAYS_PER_JULIAN_YEAR, SPEED_OF_LIGHT_KM_S
from startracker.observer import Observer, aberrate

if TYPE_CHECKING:
    from simulator.scenario.schema import SkySection

__all__ = ["SkyIndex", "apparent_directions", "bend_by_sun"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_AU_LIGHT_TIME_JYEAR = AU_KM / SPEED_OF_LIGHT_KM_S / (86_400.0 * DAYS_PER_JULIAN_YEAR)
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
    position = observer.position_au
    if section.proper_motion:
        years = np.full(len(catalog), observer.epoch_jyear - catalog.epoch_jyear)
        if position is not None:
            years += (u @ position) * _AU_LIGHT_TIME_JYEAR
        u = u + years[:, None] * motion
    if section.parallax and position is not None:
        u = u - catalog.parallax_rad[:, None] * position
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    if section.light_deflection and sun_au is not None and position is not None:
        u = bend_by_sun(u, position - np.asarray(sun_au, dtype=float))
    if section.aberration and observer.velocity_km_s is not None:
        u = aberrate(u, observer.velocity_km_s)
    return u


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
    distance = math.sqrt(float(from_sun_au @ from_sun_au))
    return np.asarray(erfa.ufunc.ldsun(directions, from_sun_au / distance, distance), dtype=np.float64)


class SkyIndex:
    """A catalogue that finds the stars of a field of view without a look at all the others.

    Parameters
    ----------
    catalog : StarCatalog
        The stars to be found; cut it by magnitude first.
    """

    def __init__(self, catalog: StarCatalog) -> None:
        self.catalog = catalog
        directions, motion = catalog.space_motion()
        across = motion - directions * np.einsum("ij,ij->i", directions, motion)[:, None]
        self._tree = cKDTree(directions)
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
        rows = self._tree.query_ball_point(
            np.asarray(direction, dtype=float), chord * (1.0 + 1e-12), return_sorted=True
        )
        return np.asarray(rows, dtype=np.int64)

    def view(
        self, direction: ArrayLike, radius_rad: float, observer: Observer, sun_au: ArrayLike | None, section: SkySection
    ) -> tuple[StarCatalog, FloatArray]:
        """The stars near an apparent direction and where each appears: `near`, then `apparent_directions`.

        Returns
        -------
        StarCatalog, float array of shape (N, 3)
            Stars in the order of the catalogue, among them a few outside `radius_rad`, and apparent unit vectors.
        """
        stars = self.catalog.select(self.near(direction, radius_rad, observer.epoch_jyear))
        return stars, apparent_directions(stars, observer, sun_au, section)
