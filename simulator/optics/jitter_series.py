"""Jitter given as a time series, such as the measured or simulated vibration by reaction wheels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics.jitter import Jitter, JitterPath, camera_axes
from startracker.core import FloatArray
from startracker.errors import InputError

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


@dataclass(frozen=True, eq=False)
class JitterSeries:
    """Angles over time, interpolated by a cubic spline.

    The error of the spline is some 1e-3 of the amplitude of a sinusoid with eight samples per period."""

    t_s: FloatArray
    """(N,): Ascending, seconds after the scenario's epoch."""
    angles_rad: FloatArray
    """(N, 3): About the axes of the section."""
    name: str
    """The file, for messages."""

    @cached_property
    def spline(self) -> CubicSpline:
        """The angles as a function of time."""
        from scipy.interpolate import CubicSpline  # takes 0.3 s to import, so only runs with a series do

        return CubicSpline(self.t_s, self.angles_rad)

    @cached_property
    def max_hz(self) -> float:
        """Nyquist frequency of the samples: half of the sampling rate."""
        return 0.5 / float(np.median(np.diff(self.t_s)))

    @cached_property
    def rms_rate_rad_s(self) -> FloatArray:
        """Root mean square (3,) of the angular rate, own axes."""
        return np.asarray(np.sqrt(np.mean(self.spline(self.t_s, 1) ** 2, axis=0)))

    def section(
        self, parameters: Jitter, rng: np.random.Generator, exposure_s: float, body_to_camera: ArrayLike
    ) -> SampledJitter:
        """A random section for one exposure; `InputError` if the series is shorter than the exposure."""
        first, last = self.t_s[0] + 0.5 * exposure_s, self.t_s[-1] - 0.5 * exposure_s
        if last < first:
            length_s = self.t_s[-1] - self.t_s[0]
            raise InputError(
                f"pointing.jitter.series: {self.name}: {length_s:g} s are shorter than the exposure, with a rolling "
                f"shutter that of all rows, {exposure_s:g} s"
            )
        middle_s = first + (last - first) * float(rng.random())
        return SampledJitter(self, middle_s, camera_axes(parameters, body_to_camera))


@dataclass(frozen=True, eq=False)
class SampledJitter:
    """A time series relative to a mid-exposure, with the methods of `JitterPath`."""

    series: JitterSeries
    """The series."""
    origin_s: float
    """Time of mid-exposure on the scale of the series."""
    matrix: FloatArray
    """(3, 3): From the axes of the series to camera axes."""
    offset_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,): Rotation vector subtracted from that of the series, camera axes."""

    @property
    def max_hz(self) -> float:
        """Upper limit of the frequencies."""
        return self.series.max_hz

    def at(self, t_s: ArrayLike) -> FloatArray:
        """Rotation vectors (..., 3) in camera axes, radians, at seconds from mid-exposure.

        Raises
        ------
        InputError
            Outside the series.
        """
        t = np.asarray(t_s, dtype=float) + self.origin_s
        self._refuse_outside(t)
        return np.asarray(self.series.spline(t) @ self.matrix.T - self.offset_rad)

    def mean(self, exposure_s: float) -> FloatArray:
        """Mean rotation vector (3,) over an exposure about t = 0, exact."""
        ends = self.origin_s + np.array([-0.5, 0.5]) * exposure_s
        self._refuse_outside(ends)
        # The spline is integrated exactly, while samples within the exposure may be few.
        total = self.series.spline.integrate(float(ends[0]), float(ends[1]))
        return np.asarray(self.matrix @ total / exposure_s - self.offset_rad)

    def centred(self, exposure_s: float) -> SampledJitter:
        """The same motion minus its mean over the exposure."""
        return replace(self, offset_rad=self.offset_rad + self.mean(exposure_s))

    def rate(self, exposure_s: float) -> FloatArray:
        """Mean angular rate (3,) over an exposure about t = 0, camera axes, rad/s."""
        ends = self.at(np.array([-0.5, 0.5]) * exposure_s)
        return np.asarray((ends[1] - ends[0]) / exposure_s)

    def shifted(self, t_s: float) -> SampledJitter:
        """The same motion with time relative to `t_s`: `shifted(t).at(u)` is `at(t + u)`."""
        return replace(self, origin_s=self.origin_s + t_s)

    def in_axes(self, matrix: FloatArray) -> SampledJitter:
        """The same motion in other axes, into which the matrix (3, 3) transforms the present ones."""
        return replace(self, matrix=matrix @ self.matrix, offset_rad=matrix @ self.offset_rad)

    def rms_rate_rad_s(self) -> FloatArray:
        """Root mean square (3,) of the angular rate, camera axes."""
        return np.asarray(np.sqrt(self.matrix**2 @ self.series.rms_rate_rad_s**2))

    def _refuse_outside(self, t_s: FloatArray) -> None:
        first, last = self.series.t_s[[0, -1]]
        outside = ~((t_s >= first) & (t_s <= last))
        if outside.any():
            raise InputError(
                f"pointing.jitter.series: {self.series.name} covers {first:g} to {last:g} s after the epoch; "
                f"{float(t_s[outside][0]):g} s is outside: change sequence.start_s or the number of frames, or give a "
                "longer series (half an exposure before the first frame and after the last one)"
            )


JitterMotion = JitterPath | SampledJitter
"""Either kind of jitter."""
