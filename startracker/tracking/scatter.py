"""Size of the centroid errors, estimated from the residuals of previous frames."""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray
from startracker.estimation.wahba import attitude_covariance
from startracker.geometry.camera import Camera

_MEMORY = 200.0
"""Approximate number of residuals remembered (half as many stars), which determine the scale to 5 %."""
_WEIGHT = 6.0
"""Minimum degrees of freedom without weight of the stated errors, which replace missing ones."""
_LEAST, _MOST = 0.05, 22.0
_FEW_STARS = 6


class Scatter:
    """Ratio of the actual to the stated errors, from fading sums of χ² and its degrees of freedom."""

    def __init__(self) -> None:
        self._chi2 = self._freedom = _WEIGHT

    @property
    def factor(self) -> float:
        """The ratio; initially 1."""
        return min(max(math.sqrt(self._chi2 / self._freedom), _LEAST), _MOST)

    def begin(self, residual: FloatArray, stated: FloatArray) -> None:
        """Restart with the residuals (M, 2) of one frame and their stated errors (M,)."""
        self._chi2 = self._freedom = 0.0
        self.add(residual, stated)
        if self._freedom < _WEIGHT:  # a few may be small by chance
            self._chi2 += _WEIGHT - self._freedom
            self._freedom = _WEIGHT

    def add(self, residual: FloatArray, stated: FloatArray) -> None:
        """Add the residuals of another frame."""
        freedom = 2 * len(residual) - 3
        if freedom <= 0:
            return
        fading = math.exp(-freedom / _MEMORY)
        weighted = residual / stated[:, None]
        self._chi2 = fading * self._chi2 + float(np.vdot(weighted, weighted))
        self._freedom = fading * self._freedom + freedom


def at_least_stated(covariance: FloatArray, camera: Camera, xy: FloatArray, stated_px: float) -> FloatArray:
    """The covariance (3, 3) of an attitude from stars at pixels (N, 2), if they are few not below that of their stated
    error: a few residuals may be small by chance."""
    if len(xy) >= _FEW_STARS:
        return covariance
    stated = attitude_covariance(camera.unproject(xy), np.full(len(xy), stated_px * camera.pixel_rad))
    return covariance * max(1.0, float(np.trace(stated) / np.trace(covariance)))
