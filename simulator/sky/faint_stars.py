"""Synthetic stars fainter than the catalogue's limit; the same sky for the same seed.

The sphere is divided into cells of about 4° × 4° in bands of declination. Each cell has a Poisson-distributed number of
stars from its own random stream, uniformly distributed over the cell, with the magnitude distribution of the whole sky
(`star_counts`) and the density at its centre (`background.star_contrast`). The stars have no names and belong to the
background, not to the truth.
"""

from __future__ import annotations

import functools
import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.randomness import stream
from simulator.sky.background import star_contrast
from simulator.sky.star_counts import count_between, draw_magnitudes
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.geometry.attitude import radec_to_direction

_BAND_DEG = 4.0
_CELLS_KEPT = 512
"""Size of the cache of cells: those around the path of a boresight over a year at a constant declination, for a field
of 13°."""


class StarField(NamedTuple):
    """Directions and magnitudes of stars."""

    direction: FloatArray
    """(N, 3): Unit vectors, ICRS, without aberration."""
    v_mag: FloatArray
    """(N,): Magnitudes."""


class FaintSky:
    """Stars between two magnitudes.

    Parameters
    ----------
    seed : int
        Seed of the run.
    brightest, faintest : float
        Stars with `brightest` < V ≤ `faintest`, up to `star_counts.FAINTEST_V`.
    """

    def __init__(self, seed: int, brightest: float, faintest: float) -> None:
        self.seed, self.brightest, self.faintest = seed, brightest, faintest
        self._edges = _cells()
        middle = 0.5 * (self._edges[:, [0, 2]] + self._edges[:, [1, 3]])
        self._centres = radec_to_direction(middle[:, 0], np.arcsin(middle[:, 1]))
        # A cell is within the distance of its farthest corner from its centre.
        corners = radec_to_direction(self._edges[:, [0, 0, 1, 1]], np.arcsin(self._edges[:, [2, 3, 2, 3]]))
        self._reach_rad = np.arccos(np.einsum("cki,ci->ck", corners, self._centres).min(axis=1))
        density = count_between(brightest, faintest) * star_contrast(self._centres)
        self._mean_count = density * _square_degrees(self._edges)
        self.cell = functools.lru_cache(maxsize=_CELLS_KEPT)(self._drawn)

    def near(self, direction: ArrayLike, radius_rad: float, shift_rad: float = 30.0 * ARCSEC_RAD) -> StarField:
        """Stars within a radius of an apparent direction (3,), enlarged by `shift_rad`, the upper limit of
        aberration."""
        centre = np.asarray(direction, dtype=float)
        reach_rad = min(radius_rad + shift_rad, math.pi)
        away_rad = np.arccos(np.clip(self._centres @ centre, -1.0, 1.0))
        cells = np.flatnonzero(away_rad <= reach_rad + self._reach_rad)
        stars = np.concatenate([self.cell(number) for number in cells.tolist()])
        found = stars[stars[:, :3] @ centre >= math.cos(reach_rad)]
        return StarField(found[:, :3].copy(), draw_magnitudes(found[:, 3], self.brightest, self.faintest))

    def _drawn(self, number: int) -> FloatArray:
        """Stars of a cell, (N, 4): unit vector, and a uniform deviate that `draw_magnitudes` maps to a magnitude."""
        rng = stream(self.seed, "faint stars", number)
        count = int(rng.poisson(self._mean_count[number]))
        right, up, share = rng.random((3, count))
        # Points uniform in right ascension and in the sine of the declination are uniform on the sphere.
        west, east, south, north = self._edges[number].tolist()
        ra_rad, z = west + right * (east - west), south + up * (north - south)
        across = np.sqrt(1.0 - z * z)
        return np.column_stack([across * np.cos(ra_rad), across * np.sin(ra_rad), z, share])


@functools.cache
def _cells() -> FloatArray:
    """Western and eastern right ascension, and sine of the southern and northern declination, of all cells (C, 4)."""
    declination = np.radians(np.arange(-90.0, 90.0 + _BAND_DEG / 2.0, _BAND_DEG))
    cells = []
    for south, north in pairwise(declination.tolist()):
        widest = max(math.cos(south), math.cos(north))
        count = max(3, round(360.0 * widest / _BAND_DEG))
        ra = np.linspace(0.0, 2.0 * math.pi, count + 1)
        sines = np.broadcast_to([math.sin(south), math.sin(north)], (count, 2))
        # At the wider edge of a band its cells are about as wide as the band is high.
        cells.append(np.column_stack([ra[:-1], ra[1:], sines]))
    return np.concatenate(cells)


def _square_degrees(edges: FloatArray) -> FloatArray:
    """Areas (C,) of cells (C, 4)."""
    steradians = (edges[:, 1] - edges[:, 0]) * (edges[:, 3] - edges[:, 2])
    return np.asarray(steradians / math.radians(1.0) ** 2)
