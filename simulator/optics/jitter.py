"""Jitter: a small random rotation of the camera during the exposure, with a given power spectrum.

About each axis the angle is a stationary Gaussian process of variance rms² and one-sided power spectral density
rms² s(f), ∫ s df = 1, synthesised from M cosines:

    φ(t) = Σ_m  a_m cos 2π f_m t + b_m sin 2π f_m t,      a_m, b_m ~ N(0, rms² w_m)

For a frame the band is divided into M parts of equal variance, w = 1/M, and f_m is random within each with density s,
so that the expected autocovariance is that of the spectrum at every lag, and φ is not periodic. It can be evaluated at
any time.

Over a sequence, and for spectra from a table, both the slow motion from frame to frame and the fast motion within an
exposure matter, and either may have a small part of the variance. Half of the frequencies are then from parts of equal
variance, and half from parts of equal width in log f; each has the variance

    w_m = s(f_m) / (M/2 (s(f_m) + q(f_m))),      q(f) = 1/(f ln(f_max/f_min)),

so that the expectation is the same (multiple importance sampling with the balance heuristic of Veach & Guibas 1995) and
every octave has lines. Their amplitudes a² + b² = 2 rms² w are fixed and only their phases are random, so that every
single realisation has the requested spectrum and rms; with some seventy lines per octave its angles are Gaussian.

Source: spectral representation of Shinozuka & Deodatis 1991, Appl. Mech. Rev. 44, 191, with random frequencies within
the parts. Spectra of real spacecraft are given as tables.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import ARCSEC_RAD, FloatArray
from startracker.errors import InputError
from startracker.files import CURVE_BYTES, read_text


@dataclass(frozen=True)
class Jitter:
    """Random rotation of the camera during exposures and, in a sequence, between them."""

    rms_arcsec: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Root mean square of the angle about x, y, z; 0: none."""
    psd: str = "lorentz"
    """Power spectrum: ``white`` up to the corner; ``lorentz``, 1/(1 + (f/corner)²) up to 8 corners; ``table``."""
    corner_hz: float = 10.0
    """Corner frequency."""
    table: str | None = None
    """CSV file (frequency_hz, psd) with the shape for ``table``."""
    series: str | None = None
    """Table of measured angles instead of a spectrum, CSV or Parquet: ``t_s`` (or ``utc``), ``x_arcsec``, ``y_arcsec``,
    ``z_arcsec``. A sequence follows it in time, a single frame takes a random section of it."""
    axes: str = "camera"
    """Axes of `rms_arcsec` and of `series`."""

    @property
    def is_off(self) -> bool:
        """Whether there is no jitter."""
        return not any(self.rms_arcsec) and self.series is None


NO_JITTER = Jitter()

COMPONENTS = 256
"""Number of cosines per axis of a frame."""

SEQUENCE_COMPONENTS = 2048
"""Number of cosines per axis of a sequence, and of a spectrum from a table: the lines of its logarithmic half are 1.1 %
of their frequency apart."""

_DECADES = 5.0
"""Frequencies of the logarithmic half begin at this many decades below the highest one."""

LORENTZ_BAND = 8.0
"""A Lorentz spectrum is truncated at this multiple of the corner frequency; the 8 % of its variance beyond it are
distributed over the rest."""

_TABLE_STEPS = 8193


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Shape of a power spectrum on 0 … `max_hz`."""

    name: str
    """``white``, ``lorentz`` or ``table``."""
    corner_hz: float
    """Corner frequency of ``white`` and ``lorentz``."""
    max_hz: float
    """Upper limit of the band."""
    frequency_hz: FloatArray = field(default_factory=lambda: np.empty(0))
    """(F,): Frequencies of a table; empty for the others."""
    density: FloatArray = field(default_factory=lambda: np.empty(0))
    """(F,): Density per Hz, whose integral is 1, linear between its points."""
    cumulative: FloatArray = field(default_factory=lambda: np.empty(0))
    """(F,): Integral of the density from 0."""

    def per_hz(self, frequency_hz: ArrayLike) -> FloatArray:
        """One-sided density s(f) of a process with variance 1, 1/Hz."""
        f = np.asarray(frequency_hz, dtype=float)
        if self.name == "white":
            inside = np.full_like(f, 1.0 / self.corner_hz)
        elif self.name == "lorentz":
            inside = 1.0 / (self.corner_hz * math.atan(LORENTZ_BAND) * (1.0 + (f / self.corner_hz) ** 2))
        else:
            inside = np.interp(f, self.frequency_hz, self.density, left=0.0)
        return np.where((f >= 0.0) & (f <= self.max_hz), inside, 0.0)

    def quantile(self, share: ArrayLike) -> FloatArray:
        """Frequency below which the given fraction (0 … 1) of the variance lies."""
        u = np.asarray(share, dtype=float)
        if self.name == "white":
            return np.asarray(self.corner_hz * u)
        if self.name == "lorentz":
            return np.asarray(self.corner_hz * np.tan(u * math.atan(LORENTZ_BAND)))
        return np.asarray(np.interp(u, self.cumulative, self.frequency_hz), dtype=float)


def load_spectrum(parameters: Jitter, base_dir: str | Path = ".") -> Spectrum:
    """Spectrum: ``white`` up to the corner, ``lorentz`` 1/(1 + (f/corner)²), or a CSV ``table``.

    A table has the columns frequency (Hz, ascending, from 0 or more) and power spectral density (any unit: `rms_arcsec`
    sets the variance); lines that begin with ``#`` or a letter are skipped.

    Raises
    ------
    InputError
        If the table is missing, cannot be read, or is not a valid spectrum.
    """
    if parameters.psd == "white":
        return Spectrum("white", parameters.corner_hz, parameters.corner_hz)
    if parameters.psd == "lorentz":
        return Spectrum("lorentz", parameters.corner_hz, LORENTZ_BAND * parameters.corner_hz)
    if parameters.table is None:
        raise InputError("pointing.jitter.psd: table needs pointing.jitter.table, a CSV file (frequency_hz, psd)")
    path = Path(base_dir) / parameters.table
    wanted = "pointing.jitter.table is a CSV file with two columns of numbers (frequency_hz, psd)"
    lines = read_text(path, CURVE_BYTES, wanted).splitlines()
    try:
        rows = [line.split(",") for line in map(str.strip, lines) if line and line[0] != "#" and not line[0].isalpha()]
        f, density = np.array([[float(cell) for cell in row] for row in rows]).T
    except ValueError as error:
        raise InputError(f"pointing.jitter.table: {path}: needs two columns of numbers (frequency_hz, psd)") from error
    area = float(np.trapezoid(density, f))
    if not (np.isfinite(area) and area > 0.0 and (np.diff(f) > 0.0).all() and f[0] >= 0.0 and (density >= 0.0).all()):
        raise InputError(
            f"pointing.jitter.table: {path}: frequencies must be ascending from 0 Hz, densities 0 or more, not all 0"
        )
    fine = np.unique(np.concatenate([f, np.linspace(f[0], f[-1], _TABLE_STEPS)]))
    values = np.interp(fine, f, density / area)
    steps = np.diff(fine) * (values[1:] + values[:-1]) / 2.0
    # The table is refined because `quantile` interpolates linearly in the integral of a density that is itself linear.
    cumulative = np.concatenate([[0.0], np.cumsum(steps)])
    return Spectrum("table", parameters.corner_hz, float(f[-1]), fine, values, cumulative / cumulative[-1])


@dataclass(frozen=True, eq=False)
class JitterPath:
    """One realisation, as a function of time."""

    frequency_hz: FloatArray
    """(M, 3): Frequencies of the components about each axis."""
    cosine_rad: FloatArray
    """(M, 3): Amplitudes of their cosines."""
    sine_rad: FloatArray
    """(M, 3): Amplitudes of their sines."""
    max_hz: float
    """Upper limit of the frequencies."""
    matrix: FloatArray = field(default_factory=lambda: np.eye(3))
    """(3, 3): From the axes of the jitter to camera axes."""
    offset_rad: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,): Rotation vector subtracted from the sum, camera axes."""
    origin_s: float = 0.0
    """Time of mid-exposure on the scale of the realisation."""

    def at(self, t_s: ArrayLike) -> FloatArray:
        """Rotation vectors (..., 3) in camera axes, radians, from the undisturbed attitude, at seconds from
        mid-exposure."""
        t = np.asarray(t_s, dtype=float) + self.origin_s
        own = np.empty((*t.shape, 3))
        for axis in range(3):
            phase = 2.0 * np.pi * t[..., None] * self.frequency_hz[:, axis]
            own[..., axis] = np.cos(phase) @ self.cosine_rad[:, axis] + np.sin(phase) @ self.sine_rad[:, axis]
        return np.asarray(own @ self.matrix.T - self.offset_rad)

    def mean(self, exposure_s: float) -> FloatArray:
        """Mean rotation vector (3,) over an exposure T about t = 0: each component is reduced by sin(πfT)/(πfT)."""
        shares = np.sinc(self.frequency_hz * exposure_s)
        phase = 2.0 * np.pi * self.frequency_hz * self.origin_s
        now = self.cosine_rad * np.cos(phase) + self.sine_rad * np.sin(phase)
        return np.asarray(self.matrix @ (shares * now).sum(axis=0) - self.offset_rad)

    def centred(self, exposure_s: float) -> JitterPath:
        """The same path minus its mean over the exposure."""
        return replace(self, offset_rad=self.offset_rad + self.mean(exposure_s))

    def rate(self, exposure_s: float) -> FloatArray:
        """Mean angular rate (3,) over an exposure about t = 0, camera axes, rad/s."""
        ends = self.at(np.array([-0.5, 0.5]) * exposure_s)
        return np.asarray((ends[1] - ends[0]) / exposure_s)

    def shifted(self, t_s: float) -> JitterPath:
        """The same path with time relative to `t_s`: `shifted(t).at(u)` is `at(t + u)`."""
        return replace(self, origin_s=self.origin_s + t_s)

    def in_axes(self, matrix: FloatArray) -> JitterPath:
        """The same path in other axes, into which the matrix (3, 3) transforms the present ones."""
        return replace(self, matrix=matrix @ self.matrix, offset_rad=matrix @ self.offset_rad)

    def rms_rate_rad_s(self) -> FloatArray:
        """Root mean square (3,) of the angular rate, camera axes."""
        # Independent components add in variance, also after the rotation into camera axes.
        power = (2.0 * np.pi * self.frequency_hz) ** 2 * (self.cosine_rad**2 + self.sine_rad**2) / 2.0
        return np.asarray(np.sqrt((self.matrix**2) @ power.sum(axis=0)))


def draw_jitter(
    parameters: Jitter,
    spectrum: Spectrum,
    rng: np.random.Generator,
    body_to_camera: ArrayLike | None = None,
    *,
    over_sequence: bool = False,
) -> JitterPath | None:
    """One realisation, for one exposure or a whole sequence; None, without using random numbers, if there is no jitter.

    Parameters
    ----------
    parameters : Jitter
        Variances and axes.
    spectrum : Spectrum
        From `load_spectrum`.
    rng : Generator
        Stream ``jitter`` of the trial, or of the sequence.
    body_to_camera : (3, 3) array, optional
        Matrix of the mounting, for `axes`: ``body``.
    over_sequence : bool
        Draw the jitter of a sequence; the realisation does not depend on the number of frames.

    Notes
    -----
    The true attitude of a frame is that at mid-exposure plus the mean jitter over the exposure, at which the star
    images are centred. `JitterPath.mean` is this mean and `JitterPath.centred` the remaining jitter, which blurs.
    """
    if not any(parameters.rms_arcsec):
        return None
    matrix = camera_axes(parameters, body_to_camera)
    rms_rad = np.array(parameters.rms_arcsec) * ARCSEC_RAD
    # Fixed amplitudes and random phases for sequences and tables, Gaussian amplitudes for frames; see the module's
    # docstring.
    if over_sequence or spectrum.name == "table":
        frequency, weight = _lines_in_all_octaves(spectrum, rng)
        amplitude, phase = rms_rad * np.sqrt(2.0 * weight), math.tau * rng.random(frequency.shape)
        cosine, sine = amplitude * np.cos(phase), amplitude * np.sin(phase)
    else:
        frequency = spectrum.quantile(_stratified(COMPONENTS, rng))
        cosine, sine = rng.standard_normal((2, COMPONENTS, 3)) * (rms_rad / math.sqrt(COMPONENTS))
    return JitterPath(frequency, cosine, sine, spectrum.max_hz, matrix)


def camera_axes(parameters: Jitter, body_to_camera: ArrayLike | None) -> FloatArray:
    """Matrix (3, 3) from the axes of the jitter to camera axes; `InputError` if the mounting is needed and missing."""
    matrix = np.asarray(body_to_camera, dtype=float) if parameters.axes == "body" else np.eye(3)
    if matrix.shape != (3, 3):
        raise InputError("jitter in body axes needs the matrix (3, 3) of the mounting, body to camera")
    return matrix


def _stratified(count: int, rng: np.random.Generator) -> FloatArray:
    """Stratified uniform deviates (count, 3): one in each of `count` equal parts of [0, 1) for each axis."""
    return np.asarray((np.arange(count)[:, None] + rng.uniform(size=(count, 3))) / count)


def _lines_in_all_octaves(spectrum: Spectrum, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Frequencies (M, 3), Hz, and their fractions of the variance (M, 3); see the module's docstring."""
    half = SEQUENCE_COMPONENTS // 2
    by_variance = spectrum.quantile(_stratified(half, rng))
    span = _DECADES * math.log(10.0)
    by_octave = spectrum.max_hz * np.exp(span * (_stratified(half, rng) - 1.0))
    frequency = np.concatenate([by_variance, by_octave])
    density = spectrum.per_hz(frequency)
    # Both halves are samples of the same integral, so a frequency is weighted by the sum of both densities there.
    with np.errstate(divide="ignore"):
        logarithmic = np.where(frequency >= spectrum.max_hz * 10.0**-_DECADES, 1.0 / (frequency * span), 0.0)
    total = half * (density + logarithmic)
    return frequency, np.divide(density, total, out=np.zeros_like(total), where=total > 0.0)
