"""Size of the centroid errors from previous frames, and the consistency of recent innovations.

A single innovation is not informative if the filter is much more accurate than a frame: an error of several of its
standard deviations is hidden by the noise of the frame. Over a window the whitened innovations are independent Gaussian
deviates of variance 1, and two sums have known distributions: the sum of their squares, χ² of all degrees of freedom,
and the square of their vector sum divided by the number of frames, χ² of three, which detects a constant error
(Bar-Shalom, Li & Kirubarajan 2001, *Estimation with Applications to Tracking and Navigation*, section 5.4).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from startracker.core import FloatArray
from startracker.estimation.wahba import attitude_covariance
from startracker.geometry.camera import Camera
from startracker.tracking.mekf import Innovation, chi_square_limit

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


_Sums = tuple[float, float, float, float, float, float]
"""Sums of squares, of degrees of freedom, of frames with a whitened innovation, and of its three components."""
_NOTHING: _Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_LENGTH = 32
_FALSE_ALARM = 1e-3
"""Probability that either sum exceeds its limit by chance. A false alarm reduces the averaging but loses no frame."""
_TOO_SMALL = 0.99
"""Probability of a lower limit of the sum of squares, below which the increased noise is too large."""
_FEWEST = 2
_RAISE = 10.0
"""Factor on the variances after an alarm."""
_FADE = 1.0 / 256.0
"""Fraction by which the excess process noise is reduced with every consistent frame."""
_LARGEST = 1e8


class InnovationWindow:
    """Innovations of recent frames, and the factor on the configured process noise."""

    def __init__(self) -> None:
        self.noise_factor = 1.0
        self._frames: deque[_Sums] = deque()
        self._total = _NOTHING
        self._last: tuple[Innovation, _Sums] | None = None

    def contradicts(self, innovation: Innovation) -> bool:
        """Whether the recent frames and one more contradict the filter."""
        self._last = innovation, _sums(innovation)
        total = _add(self._total, self._last[1])
        if len(self._frames) == _LENGTH:
            total = _add(total, self._frames[0], -1.0)
        distance2, freedom, number, x, y, z = total
        if len(self._frames) + 1 < _FEWEST:
            return False
        if distance2 > chi_square_limit(round(freedom), _FALSE_ALARM):
            return True
        return number >= _FEWEST and (x * x + y * y + z * z) / number > chi_square_limit(3, _FALSE_ALARM)

    def add(self, innovation: Innovation) -> None:
        """Add a consistent innovation."""
        if len(self._frames) == _LENGTH:
            self._total = _add(self._total, self._frames.popleft(), -1.0)
        sums = self._last[1] if self._last is not None and self._last[0] is innovation else _sums(innovation)
        self._frames.append(sums)
        self._total = _add(self._total, sums)
        self.noise_factor += _FADE * (1.0 - self.noise_factor)
        full = len(self._frames) == _LENGTH
        if full and self.noise_factor > 1.0 and self._total[0] < chi_square_limit(round(self._total[1]), _TOO_SMALL):
            self.forget()
            self.noise_factor = max(1.0, self.noise_factor / _RAISE)

    def alarm(self) -> float:
        """Increase the process noise and begin a new window; returns the factor for the covariance."""
        self.forget()
        self.noise_factor = min(self.noise_factor * _RAISE, _LARGEST)
        return _RAISE

    def restart(self) -> None:
        """Begin a new window after an innovation beyond the gate; the second within a window is an alarm."""
        if len(self._frames) < _LENGTH:
            self.alarm()
        self.forget()

    def forget(self) -> None:
        """Begin a new window after a restart of the filter."""
        self._frames.clear()
        self._total = _NOTHING


def _sums(innovation: Innovation) -> _Sums:
    if innovation.whitened is None:
        return innovation.distance2, innovation.freedom, 0.0, 0.0, 0.0, 0.0
    x, y, z = innovation.whitened.tolist()
    return innovation.distance2, innovation.freedom, 1.0, x, y, z


def _add(a: _Sums, b: _Sums, sign: float = 1.0) -> _Sums:
    return (
        a[0] + sign * b[0],
        a[1] + sign * b[1],
        a[2] + sign * b[2],
        a[3] + sign * b[3],
        a[4] + sign * b[4],
        a[5] + sign * b[5],
    )
