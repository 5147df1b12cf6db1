"""Measured star positions, as a centroider returns them and as later stages use them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.detection.background import Light
from startracker.display import fields_repr

_BRIGHTEST, _FEWEST = 9, 5
_MEDIAN_ERROR = math.sqrt(0.5 * math.pi)
"""Standard error of the median of N Gaussian deviates times √N."""


@dataclass(frozen=True, eq=False)
class Centroids:
    """Measured star positions as columns of equal length N, brightest first.

    Parameters
    ----------
    xy : array, shape (N, 2)
        Position, pixels; a pixel's centre has integer coordinates.
    flux : array, shape (N,)
        Signal above the background, DN, including the part outside the window.
    covariance : array, shape (N, 2, 2)
        Covariance of xy, px².
    saturated : bool array, shape (N,)
        Whether the star's image is saturated.
    common_px2 : array, shape (2, 2), optional
        Covariance, px², of an error that all positions share; it is not part of `covariance`. None if there is none.
    misfit : float, optional
        Deviation of the brightest stars from the image that was fitted to them (`misfit_of_brightest`), at most 0 if
        it is asymmetric and positions were corrected for this (`startracker.centroid.asymmetry`); None if unknown.
    """

    xy: FloatArray
    flux: FloatArray
    covariance: FloatArray
    saturated: NDArray[np.bool_]
    common_px2: FloatArray | None = None
    misfit: float | None = None

    __repr__ = fields_repr

    def __len__(self) -> int:
        return len(self.flux)

    @classmethod
    def none(cls) -> Centroids:
        """No stars."""
        return cls(np.empty((0, 2)), np.empty(0), np.empty((0, 2, 2)), np.empty(0, np.bool_))


class Measured(NamedTuple):
    """Centroids of an image and their errors."""

    xy: FloatArray
    """Positions, px, (N, 2)."""
    flux: FloatArray | None = None
    """Signal in any unit, (N,)."""
    variance_px2: FloatArray | None = None
    """Variance on one axis, px², (N,); None: equal for all, and estimated from the residuals."""
    covariance_px2: FloatArray | None = None
    """Covariance, px², (N, 2, 2), if the axes differ, as for streaks."""
    common_px2: FloatArray | None = None
    """Covariance, px², (2, 2), of an error that all centroids share; it rotates the attitude and does not appear in the
    residuals. None if the star images do not show one."""
    misfit: float | None = None
    """Deviation of the star images from the fitted ones (`Centroids.misfit`)."""
    light: Light | None = None
    """The image, in which light that the detector rejected can be found; None if the centroids are a list."""


def misfit_of_brightest(flux: FloatArray, excess: FloatArray) -> float | None:
    """Median excess of χ² of the nine brightest stars' fits, in its standard errors; None for fewer than five.

    Parameters
    ----------
    flux : (N,)
        Brightness, in any unit.
    excess : (N,)
        χ² of each fit minus its degrees of freedom, in standard deviations; values that are not finite are ignored.
    """
    fitted = np.isfinite(excess).nonzero()[0]
    brightest = np.sort(excess[fitted[np.argsort(-flux[fitted], kind="stable")[:_BRIGHTEST]]])
    count = len(brightest)
    if count < _FEWEST:
        return None
    median = float(0.5 * (brightest[(count - 1) // 2] + brightest[count // 2]))
    return median * math.sqrt(count) / _MEDIAN_ERROR
