"""Measured star positions: of a centroider, and as the stages after it use them."""

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
"""Standard error of the median of normal deviates times the root of their number."""


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
    misfit : float, optional
        How far the brightest stars are from the image that was fitted to them (`misfit_of_brightest`); None: unknown.
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
    """Pixels, (N, 2)."""
    flux: FloatArray | None = None
    """Signal, (N,)."""
    variance_px2: FloatArray | None = None
    """Variance on one axis, (N,); None: equal and estimated from the residuals."""
    covariance_px2: FloatArray | None = None
    """Covariance, (N, 2, 2), if the axes differ, as for streaks."""
    common_px2: FloatArray | None = None
    """Covariance of an error common to all centroids, (2, 2), which rotates the attitude and does not appear in
    residuals. None: the star images show none, or cannot."""
    misfit: float | None = None
    """Deviation of the star images from the fitted ones (`Centroids.misfit`)."""
    light: Light | None = None
    """The image, for what the detector rejected; None: the centroids are a list."""


def misfit_of_brightest(flux: FloatArray, excess: FloatArray) -> float | None:
    """Median excess of χ² of the nine brightest stars' fits, in its standard errors; None for fewer than five.

    Parameters
    ----------
    flux : (N,)
        Brightness in any unit.
    excess : (N,)
        χ² of each fit minus its degrees of freedom, in standard deviations; not finite: left out.
    """
    fitted = np.isfinite(excess).nonzero()[0]
    brightest = np.sort(excess[fitted[np.argsort(-flux[fitted], kind="stable")[:_BRIGHTEST]]])
    count = len(brightest)
    if count < _FEWEST:
        return None
    median = float(0.5 * (brightest[(count - 1) // 2] + brightest[count // 2]))
    return median * math.sqrt(count) / _MEDIAN_ERROR
