"""Size of the centroid errors, estimated from the residuals of previous frames."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["Scatter"]

FloatArray = NDArray[np.float64]

_MEMORY = 200.0
"""Residuals remembered, about: half as many stars, and their scale good to 5 %."""
_WEIGHT = 6.0
"""Fewest degrees of freedom that are believed alone; the stated errors make up for those that lack."""
_LEAST, _MOST = 0.05, 22.0


class Scatter:
    """Ratio of the real to the stated errors, from a fading sum of χ² and of its degrees of freedom."""

    def __init__(self) -> None:
        self._chi2 = self._freedom = _WEIGHT

    @property
    def factor(self) -> float:
        """The ratio; 1 as long as nothing is known."""
        return min(max(math.sqrt(self._chi2 / self._freedom), _LEAST), _MOST)

    def begin(self, residual: FloatArray, stated: FloatArray) -> None:
        """Start anew from the residuals (M, 2) of one frame and their stated errors (M,)."""
        self._chi2 = self._freedom = 0.0
        self.add(residual, stated)
        if self._freedom < _WEIGHT:  # so few can be small by luck
            self._chi2 += _WEIGHT - self._freedom
            self._freedom = _WEIGHT

    def add(self, residual: FloatArray, stated: FloatArray) -> None:
        """Take in another frame's."""
        freedom = 2 * len(residual) - 3
        if freedom <= 0:
            return
        fading = math.exp(-freedom / _MEMORY)
        self._chi2 = fading * self._chi2 + float(np.sum(residual**2 / stated[:, None] ** 2))
        self._freedom = fading * self._freedom + freedom
