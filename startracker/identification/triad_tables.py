"""Databases of identification by triads: a sub-catalogue and its pairs sorted by separation (Yee 1999, section
2.3.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.geometry.attitude import radec_to_direction
from startracker.identification.arithmetic import Arithmetic, Numbers

_ROUNDING = 1e-9
"""Relative margin of the search for pairs; pairs that are too far apart are removed afterwards."""


@dataclass(frozen=True, eq=False)
class TriadTables:
    """Sub-catalogue and pair database in the format of one arithmetic.

    Parameters
    ----------
    arithmetic : Arithmetic
        Arithmetic in whose format the separations are.
    id : int (G,)
        Catalogue number of each star: HR for the Bright Star Catalogue.
    v_mag : (G,)
        Visual magnitudes, which determine the brightest of several stars.
    sky : object
        The stars' coordinates in the form that the arithmetic uses.
    separation : (P,)
        Separations of the pairs in ascending order; equal ones in the order of `first`, then `second`.
    first, second : int (P,)
        Indices of the two stars in the sub-catalogue, `first` < `second`.
    """

    arithmetic: Arithmetic
    id: IntArray
    v_mag: FloatArray
    sky: Any
    separation: Numbers
    first: IntArray
    second: IntArray

    def __len__(self) -> int:
        return len(self.id)

    @classmethod
    def build(
        cls,
        arithmetic: Arithmetic,
        star_id: ArrayLike,
        ra_deg: ArrayLike,
        dec_deg: ArrayLike,
        v_mag: ArrayLike,
        max_separation_deg: float,
    ) -> TriadTables:
        """Databases of the given stars, with all pairs up to the largest separation in the camera's field.

        Raises
        ------
        InputError
            Columns that differ in length or contain values that are not finite; a separation outside (0, 180].
        """
        number = np.array(star_id, dtype=np.int64)
        ra, dec, magnitude = (np.array(column, dtype=float) for column in (ra_deg, dec_deg, v_mag))
        if not (number.shape == ra.shape == dec.shape == magnitude.shape and number.ndim == 1):
            raise InputError("a sub-catalogue needs columns of one length: numbers, coordinates, magnitudes")
        if not all(np.isfinite(column).all() for column in (ra, dec, magnitude)):
            raise InputError("a sub-catalogue needs finite coordinates and magnitudes")
        if not 0.0 < max_separation_deg <= 180.0:
            raise InputError(f"the largest separation is {max_separation_deg}°; it must be in (0, 180]")
        vectors = radec_to_direction(np.radians(ra), np.radians(dec))
        chord = 2.0 * np.sin(np.radians(max_separation_deg) / 2.0)
        pairs = np.empty((0, 2), dtype=np.int64)
        if len(vectors):
            reach = chord * (1.0 + _ROUNDING) + _ROUNDING
            pairs = cKDTree(vectors).query_pairs(reach, output_type="ndarray").astype(np.int64)
        first, second = pairs.min(axis=1), pairs.max(axis=1)
        keep = np.linalg.norm(vectors[first] - vectors[second], axis=1) <= chord
        sky = arithmetic.sky(ra, dec, max_separation_deg)
        return cls.of_pairs(arithmetic, number, magnitude, sky, first[keep], second[keep])

    @classmethod
    def of_pairs(
        cls,
        arithmetic: Arithmetic,
        star_id: IntArray,
        v_mag: FloatArray,
        sky: Any,
        first: IntArray,
        second: IntArray,
    ) -> TriadTables:
        """Databases from pairs that are already known."""
        separation = arithmetic.catalog_separations(sky, first, second)
        order = np.lexsort((second, first, separation))
        return cls(arithmetic, star_id, v_mag, sky, separation[order], first[order], second[order])

    def windows(self, separations: Numbers, tolerance: Numbers) -> tuple[IntArray, IntArray]:
        """Half-open ranges [low, high) of the pairs within the tolerance of each separation, each (P,)."""
        low = np.searchsorted(self.separation, separations - tolerance, side="left")
        high = np.searchsorted(self.separation, separations + tolerance, side="right")
        return low.astype(np.int64), high.astype(np.int64)
