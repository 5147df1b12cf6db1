"""The stars of a frame as they pass between the stages of a flight build."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray, IntArray
from startracker.errors import InputError

POSITION_BITS, FLUX_BITS, VARIANCE_BITS = 16, 4, 26
"""Fraction bits of positions, fluxes and variances."""
SATURATED, ELONGATED = 1, 2
"""Flags."""
LEAST_VARIANCE = 1
MOST_VARIANCE = (1 << 32) - 1
MOST_FLUX = (1 << 31) - 1
_FARTHEST_PX = 32767.0


class StarList(NamedTuple):
    """Measured stars, brightest first; the fields of ``struct tracker_star``.

    Parameters
    ----------
    x, y : int64 array, shape (N,)
        Pixels, 16 fraction bits; (0, 0) is the centre of the first pixel, x along columns, y along rows.
    flux : int64 array, shape (N,)
        DN, 4 fraction bits.
    variance : int64 array, shape (N,)
        Variance of the position on one axis, square pixels, 26 fraction bits.
    flags : int64 array, shape (N,)
        Sum of `SATURATED` and `ELONGATED`.
    """

    x: IntArray
    y: IntArray
    flux: IntArray
    variance: IntArray
    flags: IntArray

    @classmethod
    def of(
        cls, xy_px: ArrayLike, flux_dn: ArrayLike, variance_px2: ArrayLike, flags: ArrayLike | None = None
    ) -> StarList:
        """Stars from real numbers, rounded to nearest; variances and fluxes end at the range of their formats.

        Parameters
        ----------
        xy_px : array_like, shape (N, 2)
        flux_dn, variance_px2 : array_like, shape (N,)
        flags : array_like, shape (N,), optional
            None: no flags.

        Raises
        ------
        InputError
            A number is not finite, or a position beyond ±32767 pixels.
        """
        xy = np.asarray(xy_px, dtype=float).reshape(-1, 2)
        flux, variance = np.asarray(flux_dn, dtype=float), np.asarray(variance_px2, dtype=float)
        if not (np.isfinite(flux).all() and np.isfinite(variance).all() and (np.abs(xy) <= _FARTHEST_PX).all()):
            raise InputError("stars of a flight build need finite numbers and positions within ±32767 pixels")
        values = (
            *(xy.T * (1 << POSITION_BITS)),
            np.clip(flux * (1 << FLUX_BITS), 0, MOST_FLUX),
            np.clip(variance * (1 << VARIANCE_BITS), LEAST_VARIANCE, MOST_VARIANCE),
            np.zeros(len(xy)) if flags is None else np.asarray(flags),
        )
        return cls(*(np.rint(column).astype(np.int64) for column in values))

    @property
    def xy_px(self) -> FloatArray:
        """Positions, (N, 2) pixels."""
        return np.column_stack([self.x, self.y]) / float(1 << POSITION_BITS)

    @property
    def flux_dn(self) -> FloatArray:
        """Fluxes, DN."""
        return self.flux / float(1 << FLUX_BITS)

    @property
    def variance_px2(self) -> FloatArray:
        """Variance of each position on one axis, square pixels."""
        return self.variance / float(1 << VARIANCE_BITS)

    def take(self, index: ArrayLike) -> StarList:
        """The stars of an index or mask."""
        return StarList(*(column[np.asarray(index)] for column in self))
