"""Monotone cubic interpolation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from startracker.core import FloatArray


@dataclass(frozen=True, eq=False)
class MonotoneCubic:
    """Cubic Hermite interpolant through points, monotone wherever the points are.

    The slope at a point is the weighted harmonic mean of the adjacent intervals' slopes, and 0 at an extremum; at the
    ends it is that of the parabola through three points, limited to avoid overshoot (Fritsch & Butland 1984, SIAM J.
    Sci. Stat. Comput. 5, 300; Moler 2004, *Numerical Computing with MATLAB*, section 3.6). Equivalent to SciPy's
    `PchipInterpolator`, whose import takes 13 MB and a tenth of a second."""

    x: FloatArray
    """(N,): Ascending, at least three."""
    y: FloatArray
    """(N,): Values; each column is a separate curve."""
    slope: FloatArray
    """Slopes at the points, of the shape of `y`."""

    @classmethod
    def through(cls, x: FloatArray, y: FloatArray) -> MonotoneCubic:
        """The interpolant of these points."""
        h = np.diff(x).reshape(-1, *[1] * (y.ndim - 1))
        m = np.diff(y, axis=0) / h
        slope = np.zeros(y.shape)
        left, right = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
        same_way = m[:-1] * m[1:] > 0.0
        # The replaced slopes only avoid a division by zero; at an extremum the slope is 0 in any case.
        mean = left / np.where(same_way, m[:-1], 1.0) + right / np.where(same_way, m[1:], 1.0)
        slope[1:-1] = np.where(same_way, (left + right) / mean, 0.0)
        slope[0], slope[-1] = _end(h[0], h[1], m[0], m[1]), _end(h[-1], h[-2], m[-1], m[-2])
        return cls(x, y, slope)

    def __call__(self, at: FloatArray) -> FloatArray:
        """Values (K,) or (K, M) at abscissas (K,) within those of the points."""
        k = np.clip(np.searchsorted(self.x, at, side="right") - 1, 0, len(self.x) - 2)
        h = (self.x[k + 1] - self.x[k]).reshape(-1, *[1] * (self.y.ndim - 1))
        t = (at - self.x[k]).reshape(h.shape) / h
        step = self.y[k + 1] - self.y[k]
        first, last = self.slope[k] * h, self.slope[k + 1] * h
        bend = 3.0 * step - 2.0 * first - last
        return np.asarray(self.y[k] + t * (first + t * (bend + t * (first + last - 2.0 * step))))


def _end(h0: FloatArray, h1: FloatArray, m0: FloatArray, m1: FloatArray) -> FloatArray:
    """Slope at an end, from the adjacent intervals and their slopes."""
    slope = ((2.0 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    slope = np.where((m0 * m1 < 0.0) & (np.abs(slope) > 3.0 * np.abs(m0)), 3.0 * m0, slope)
    return np.asarray(np.where(slope * m0 > 0.0, slope, 0.0))
