"""Apparent directions of stars and bodies: light deflection and aberration.

The effects are applied in the order of the light path: space motion of the star, parallax, light deflection, and
finally aberration.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import erfa
import numpy as np
from numpy.typing import ArrayLike

from startracker.catalog.stars import StarCatalog
from startracker.core import ARCSEC_RAD, AU_KM, DAYS_PER_JULIAN_YEAR, SPEED_OF_LIGHT_KM_S, FloatArray, IntArray
from startracker.observer import Observer


def bend_by_sun(directions: FloatArray, from_sun_au: FloatArray) -> FloatArray:
    """Unit vectors (N, 3) of distant sources with light deflection by the Sun; ERFA's ``eraLdsun``.

    The deflection is 4.07 mas at 90° from the Sun and 1.75″ at its limb; inside the disk the formula is limited so that
    it stays finite.

    Parameters
    ----------
    directions : float array, shape (N, 3)
        Unit vectors from the observer, before deflection.
    from_sun_au : float array, shape (3,)
        From the Sun to the observer, au.
    """
    distance = math.sqrt(from_sun_au @ from_sun_au)
    return np.asarray(erfa.ufunc.ldsun(directions, from_sun_au / distance, distance))


def aberrated(directions: FloatArray, velocity_km_s: FloatArray) -> FloatArray:
    """Apparent unit vectors (..., 3) for a moving observer; ERFA's ``eraAb`` without the Sun's potential (below
    0.5 µas), which `startracker.observer.aberrate` of the tracker neglects as well. The shapes are broadcast."""
    beta = velocity_km_s / SPEED_OF_LIGHT_KM_S
    inverse_gamma = np.sqrt(1.0 - np.add.reduce(beta * beta, axis=-1))
    return np.asarray(erfa.ufunc.ab(directions, beta, np.inf, inverse_gamma))


if TYPE_CHECKING:
    from simulator.sky.parameters import Sky

_AU_LIGHT_TIME_JYEAR = AU_KM / SPEED_OF_LIGHT_KM_S / (86_400.0 * DAYS_PER_JULIAN_YEAR)
_SHIFT_RAD = 30.0 * ARCSEC_RAD
"""Upper limit of aberration (26″ in a low orbit), deflection (1.75″) and parallax (0.8″) together near the Earth."""
_ROUNDING_RAD = 1e-12


def apparent_directions(catalog: StarCatalog, observer: Observer, sun_au: ArrayLike | None, sky: Sky) -> FloatArray:
    """Apparent unit vectors (N, 3), GCRS axes, of stars.

    Parameters
    ----------
    catalog : StarCatalog
        Any number of stars; for the stars of a field of view, `SkyIndex.apparent` is faster.
    observer : Observer
        Epoch, barycentric position and velocity; None omits the corresponding effect.
    sun_au : array_like, shape (3,), or None
        Barycentric position of the Sun; None omits the deflection.
    sky : Sky
        Its switches `proper_motion`, `parallax`, `light_deflection` and `aberration`.

    Notes
    -----
    Proper motion is linear space motion with the perspective term, at the instant the light passes the barycentre (the
    Rømer delay is up to 0.16 mas for Barnard's star). Deflection and aberration are those of ERFA's ``eraLdsun`` and
    ``eraAb``. The result agrees with ERFA's complete chain to 1 µas, except for the 0.4 µas of ``eraAb``'s
    gravitational term. Not modelled: deflection by the planets and the Earth (0.6 mas at the Earth's limb, 1 mas at 5′
    from Jupiter).
    """
    u, motion = catalog.space_motion()
    return _apparent(
        np.arange(len(catalog)), u, motion, catalog.parallax_rad, catalog.epoch_jyear, observer, sun_au, sky
    )


def _apparent(
    rows: IntArray,
    u: FloatArray,
    motion: FloatArray,
    parallax_rad: FloatArray,
    catalog_epoch_jyear: float,
    observer: Observer,
    sun_au: ArrayLike | None,
    sky: Sky,
) -> FloatArray:
    """`apparent_directions` of a selection of rows of a catalogue's space motion."""
    position, p = observer.position_au, u.take(rows, axis=0)
    if sky.proper_motion:
        # The Rømer delay: light passes the observer earlier or later than the barycentre, and the star moves meanwhile.
        roemer = 0.0 if position is None else (p @ position)[:, None] * _AU_LIGHT_TIME_JYEAR
        p += (observer.epoch_jyear - catalog_epoch_jyear + roemer) * motion.take(rows, axis=0)
    # In units of the distance of the star, the observer is at parallax × position.
    if sky.parallax and position is not None:
        p -= parallax_rad.take(rows)[:, None] * position
    p /= np.sqrt(np.add.reduce(p * p, axis=1, keepdims=True))
    if sky.light_deflection and position is not None and sun_au is not None:
        p = bend_by_sun(p, position - np.asarray(sun_au, dtype=float))
    if sky.aberration and observer.velocity_km_s is not None:
        p = aberrated(p, observer.velocity_km_s)
    return p


def largest_shift_rad(observer: Observer) -> float:
    """Upper limit of aberration, light deflection and parallax of any star outside the Sun's disk; at least 30″.

    β with a margin of 1 % for the terms of second order; 0.77″ parallax per au (the nearest star), and a deflection of
    1.75″ at the Sun's limb.
    """
    velocity, position = observer.velocity_km_s, observer.position_au
    beta = 0.0 if velocity is None else math.hypot(*velocity.tolist()) / SPEED_OF_LIGHT_KM_S
    far = 0.0 if position is None else math.hypot(*position.tolist())
    return max(_SHIFT_RAD, 1.01 * beta + (0.78 * far + 1.76) * ARCSEC_RAD)


def by_declination(catalog: StarCatalog) -> StarCatalog:
    """The same stars from south to north; returned unchanged if already sorted."""
    rising = bool((np.diff(catalog.dec_rad) >= 0.0).all())
    return catalog if rising else catalog.select(np.argsort(catalog.dec_rad, kind="stable"))


class SkyIndex:
    """Search for the stars of a field of view, by declination zone and distance from its centre.

    Parameters
    ----------
    catalog : StarCatalog
        Stars to be searched; select by magnitude first.

    Attributes
    ----------
    catalog : StarCatalog
        The same stars sorted by declination, so that those of a zone are contiguous in memory; rows refer to it.
    """

    def __init__(self, catalog: StarCatalog) -> None:
        self.catalog = by_declination(catalog)
        self._u, self._motion = self.catalog.space_motion()
        # Only the component across the line of sight moves a star on the sky.
        across = self._motion - self._u * np.einsum("ij,ij->i", self._u, self._motion)[:, None]
        self._fastest_rad_yr = float(np.sqrt((across**2).sum(axis=1).max(initial=0.0)))

    def near(
        self, direction: ArrayLike, radius_rad: float, epoch_jyear: float, shift_rad: float = _SHIFT_RAD
    ) -> IntArray:
        """Rows of the catalogue that may appear within `radius_rad` of an apparent direction, in ascending order.

        No star is missed, but some may be slightly outside, because the radius is increased by the largest space motion
        since the catalogue's epoch and by `shift_rad`.

        Parameters
        ----------
        direction : array_like, shape (3,)
            Unit vector, GCRS axes.
        radius_rad : float
            Half of the field's diagonal, radians.
        epoch_jyear : float
            Julian epoch of the view.
        shift_rad : float
            Upper limit of aberration, deflection and parallax (`largest_shift_rad`); by default 30″.
        """
        years = abs(epoch_jyear - self.catalog.epoch_jyear)
        # The factor 1.1 covers the perspective acceleration of an approaching star, below 10 % in a millennium.
        reach = radius_rad + shift_rad + 1.1 * years * self._fastest_rad_yr
        chord = 2.0 * math.sin(min(reach, math.pi) / 2.0)  # the cosine of a small angle would lose precision
        centre = np.asarray(direction, dtype=float)
        dec_rad = math.atan2(centre[2], math.hypot(centre[0], centre[1]))
        zone = (dec_rad - reach - _ROUNDING_RAD, dec_rad + reach + _ROUNDING_RAD)
        # The catalogue is sorted by declination, so a zone is a slice, and only its stars are tested by their chord,
        # |u − c|² = 2 − 2 u·c.
        first, last = np.searchsorted(self.catalog.dec_rad, zone).tolist()
        return np.asarray(first + np.flatnonzero(self._u[first:last] @ centre >= 1.0 - 0.5 * chord * chord - 1e-15))

    def apparent(self, rows: IntArray, observer: Observer, sun_au: ArrayLike | None, sky: Sky) -> FloatArray:
        """`apparent_directions` (M, 3) of rows (M,) of the catalogue."""
        catalog = self.catalog
        return _apparent(rows, self._u, self._motion, catalog.parallax_rad, catalog.epoch_jyear, observer, sun_au, sky)
