"""Errors of the tracker's star catalogue relative to the simulated sky."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from startracker.catalog.stars import StarCatalog
from startracker.core import MAS_RAD, FloatArray
from startracker.display import changed_fields

Words = NDArray[np.uint64]

_DEVIATES = 4
_GOLDEN, _MIX_1, _MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@dataclass(frozen=True)
class CatalogueErrors:
    """Errors of the tracker's catalogue, in addition to the catalogue's own; fixed for each star."""

    position_mas: float = 0.0
    """Standard deviation of the positions at the catalogue's epoch on each axis, milliarcseconds; the tracker adds it
    to the errors of its centroids, as a catalogue states it."""
    proper_motion_mas_yr: float = 0.0
    """Standard deviation of the proper motions on each axis, milliarcseconds per year; the tracker does not know
    them."""

    __repr__ = changed_fields


def with_errors(catalog: StarCatalog, errors: CatalogueErrors, rng: np.random.Generator) -> StarCatalog:
    """The catalogue with Gaussian errors; the same object if there are none.

    The errors of a star depend only on the stream and on its number, not on the other stars of the catalogue.

    Parameters
    ----------
    catalog : StarCatalog
        The catalogue of the tracker.
    errors : CatalogueErrors
        Standard deviations.
    rng : Generator
        Random stream; one 64-bit integer is drawn from it.
    """
    if errors.position_mas == errors.proper_motion_mas_yr == 0.0:
        return catalog
    east, north, pm_east, pm_north = _normal(catalog.id, rng.integers(2**64, dtype=np.uint64))
    # The error towards the east is an angle on the sky, which is 1/cos δ times as large in right ascension; the
    # catalogue's proper motion in right ascension contains cos δ already.
    at, per_year = errors.position_mas * MAS_RAD, errors.proper_motion_mas_yr * MAS_RAD
    return replace(
        catalog,
        ra_rad=catalog.ra_rad + at * east / np.cos(catalog.dec_rad),
        dec_rad=np.clip(catalog.dec_rad + at * north, -0.5 * math.pi, 0.5 * math.pi),
        pm_ra_rad_yr=catalog.pm_ra_rad_yr + per_year * pm_east,
        pm_dec_rad_yr=catalog.pm_dec_rad_yr + per_year * pm_north,
        position_sigma_rad=math.hypot(catalog.position_sigma_rad, at),
        star_sigma_rad=np.hypot(catalog.star_sigma_rad, at),
    )


def _normal(number: NDArray[np.int64], key: np.uint64) -> FloatArray:
    """Gaussian deviates (4, N) of stars by their numbers.

    Counters are hashed with the key by SplitMix64 (Steele, Lea & Flood 2014, OOPSLA), and the uniform deviates are
    transformed by the inverse of the normal distribution.
    """
    counter = number.astype(np.uint64) * np.uint64(_DEVIATES) + np.arange(_DEVIATES, dtype=np.uint64)[:, None]
    # The inner mixing decorrelates the consecutive numbers of stars before the key is added. The top 53 bits plus one
    # half give a deviate strictly between 0 and 1, where the inverse is finite.
    word = _mixed(_mixed(counter * _GOLDEN) + key)
    return np.asarray(ndtri(((word >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53))


def _mixed(word: Words) -> Words:
    """SplitMix64's finaliser."""
    word = (word ^ (word >> np.uint64(30))) * _MIX_1
    word = (word ^ (word >> np.uint64(27))) * _MIX_2
    return np.asarray(word ^ (word >> np.uint64(31)))
