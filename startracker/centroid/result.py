"""What a centroider hands on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Centroids"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Centroids:
    """Measured star positions as columns of equal length N, brightest first.

    Parameters
    ----------
    xy : array, shape (N, 2)
        Position, pixels; a pixel's centre has integer coordinates.
    flux : array, shape (N,)
        Signal above the background, DN, the part outside the window included.
    covariance : array, shape (N, 2, 2)
        Of xy, px².
    saturated : bool array, shape (N,)
        Whether the star's image is saturated.
    common_px2 : array, shape (2, 2), optional
        Covariance of an error that all positions share, px², not part of `covariance`; None: there is none.
    """

    xy: FloatArray
    flux: FloatArray
    covariance: FloatArray
    saturated: NDArray[np.bool_]
    common_px2: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.flux)

    @classmethod
    def none(cls) -> Centroids:
        """No stars."""
        return cls(np.empty((0, 2)), np.empty(0), np.empty((0, 2, 2)), np.empty(0, np.bool_))
