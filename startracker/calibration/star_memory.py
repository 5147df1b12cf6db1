"""Errors of stars that stay the same from frame to frame: unresolved neighbours, colour, catalogue.

They do not average out while the same stars are in the field. The filter of the lens is computed without them, and
their effect on its estimate is computed exactly (consider covariance; Schmidt 1966, Advances in Control Systems 3,
293). With the gain P⁺ of a frame and the update matrix M = 1 − P⁺ I, the derivative of the estimate with respect to the
direction of star j is S_j ← M S_j + P⁺ ∂b/∂d_j. For independent errors of standard deviation s, the covariance of the
estimate is larger by s² Σ_j S_j S_jᵀ.
"""

from __future__ import annotations

import numpy as np

from startracker.core import BoolArray, FloatArray, IntArray

_FADING = 0.99
"""Weight of earlier residuals of a star at each new one."""
_REJECT2 = 13.8
"""Squared mean residual of a star, in units of its variance, above which it is not used; noise exceeds it with
probability 1e-3 (χ², two axes)."""
_LONGEST = 5.0
"""Longest residual that is added, in standard errors, so that a single misidentified star has little weight."""
_FEWEST = 5.0
"""Number of observations from which a star's mean residual is tested."""


class StarMemory:
    """Stars observed so far: derivatives of the lens with respect to their directions, and their mean residuals.

    Parameters
    ----------
    parameters : int
        Number P of parameters of the lens.
    sigma_rad : float
        Standard deviation on one axis of the constant error of a star.
    """

    def __init__(self, parameters: int, sigma_rad: float) -> None:
        self.sigma_rad = sigma_rad
        self._row: dict[int, int] = {}
        self._slopes = np.zeros((0, parameters, 3))
        self._sum = np.zeros((0, 3))
        """Fading sum of weighted residuals, ICRS axes."""
        self._weight = np.zeros((0, 4))
        """Fading sums of weights, of their squares times the variances, of numbers; variance by the lens."""
        self.covariance: FloatArray = np.zeros((parameters, parameters))
        """Covariance (P, P) of the lens due to the constant errors of the stars."""

    def rows(self, star_id: IntArray) -> IntArray:
        """Indices (M,) of stars in this table; new stars are appended."""
        for number in star_id.tolist():
            self._row.setdefault(number, len(self._row))
        new = len(self._row) - len(self._slopes)
        if new:
            self._slopes = np.concatenate([self._slopes, np.zeros((new, *self._slopes.shape[1:]))])
            self._sum = np.concatenate([self._sum, np.zeros((new, 3))])
            self._weight = np.concatenate([self._weight, np.zeros((new, 4))])
        return np.array([self._row[number] for number in star_id.tolist()], dtype=np.int64)

    def trusted(self, rows: IntArray) -> BoolArray:
        """Mask (M,) of stars whose mean residuals are explained.

        Explanations are noise, the uncertainty of the lens when the stars were last observed, and the usual constant
        errors.
        """
        weight, square, number, lens_rad2 = self._weight[rows].T
        known = number >= _FEWEST
        weight = np.where(known, weight, 1.0)
        mean2 = np.sum((self._sum[rows] / weight[:, None]) ** 2, axis=1)
        return np.asarray(~known | (mean2 <= _REJECT2 * (square / weight**2 + lens_rad2 + self.sigma_rad**2)))

    def sightings(self, rows: IntArray) -> FloatArray:
        """Fading number of earlier observations of each star, (M,), at most 99."""
        return np.asarray(self._weight[rows, 2])

    def add_residuals(
        self, rows: IntArray, residual_rad: FloatArray, sigma_rad: FloatArray, lens_rad: FloatArray
    ) -> None:
        """Add residuals (M, 3), ICRS axes, with standard errors (M,) on one axis, of the centroids and of the lens."""
        length = np.linalg.norm(residual_rad, axis=1)
        most = _LONGEST * np.hypot(sigma_rad, lens_rad)
        residual = residual_rad * np.minimum(1.0, most / np.maximum(length, 1e-300))[:, None]
        weight, fading = sigma_rad**-2.0, _FADING
        self._sum[rows] = fading * self._sum[rows] + weight[:, None] * residual
        new = np.stack([weight, weight, np.ones(len(rows)), lens_rad**2], axis=1)
        self._weight[rows] = np.array([fading, fading**2, fading, 0.0]) * self._weight[rows] + new

    def follow(self, update: FloatArray, rows: IntArray, by_star: FloatArray) -> None:
        """Propagate the derivatives through an update of the lens: M (P, P), and derivatives (M, P, 3) of its
        correction for the stars used."""
        self._slopes = update @ self._slopes
        self._slopes[rows] += by_star
        flat = self._slopes.transpose(1, 0, 2).reshape(self._slopes.shape[1], -1)
        self.covariance = np.asarray(self.sigma_rad**2 * flat @ flat.T)
