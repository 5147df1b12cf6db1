"""Separation of attitude errors into the classes of ECSS-E-ST-60-20C, by repetition and by their spatial spectra.

Every field is scanned three times (`scan`) at the same attitudes, each time with independent noise: twice with the
device, and once with other pixels behind the same lens. With the errors e₁, e₂ and e₃ at the same position,

- temporal noise is what differs between the first two: its variance is ⟨(e₁ − e₂)²⟩ / 2;
- spatial errors are what both repeat: ⟨e₁ e₂⟩, the integral of their cross-spectral density, has no contribution of the
  noise;
- of these the covariance with e₃ retains what does not depend on single pixels. At the harmonics of the pixel period
  this is the interpolation error; the rest is the FOV spatial error, which changes over many pixels, from field to
  field, and where stars enter or leave the field. All other repeated errors are the pixel spatial error. A spectrum
  alone cannot separate these, as the error by uneven pixels across the direction of motion extends to zero frequency;
- the mean over all fields is the bias.

The mean square error of all frames is the sum of the squares of these four.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd
from scipy.signal.windows import dpss

from simulator.study.datasheet.estimates import Estimate
from simulator.study.datasheet.scan import STEP_PX, ScanGeometry
from simulator.study.intervals import moment_intervals

__all__ = ["BANDWIDTH", "CLASSES", "Separated", "Spectra", "separate"]

FloatArray = NDArray[np.float64]

CLASSES = ("bias", "fov_spatial", "pixel_spatial", "temporal_noise")
"""Classes that a scan separates."""

BANDWIDTH, TAPERS = 2.5, 2
"""Half bandwidth of the windows of the plotted spectra in units of one over the length of the scan, and their number.
The first two discrete prolate spheroidal sequences have less than 0.1 % of their power outside (Thomson 1982, Proc.
IEEE 70, 1055; Slepian 1978, Bell Syst. Tech. J. 57, 1371)."""

LEAST_COMPLETE = 0.9
"""Minimum fraction of the frames of a field with an error in both passes; fewer, and the field is left out."""

FEWEST_FIELDS = 5
"""Minimum number of fields for an interval."""


class Spectra(NamedTuple):
    """One-sided spectral densities (frequencies, axes), squared unit of the errors times pixels, mean of all fields."""

    cycles_per_px: FloatArray
    """(frequencies,)"""
    total: FloatArray
    """Of single frames: mean of the densities of the first two passes."""
    repeated: FloatArray
    """Cross-spectral density of the first two passes. Noise makes single values negative, here and in `common`."""
    common: FloatArray
    """Cross-spectral density of the first two passes with the third."""
    noise: FloatArray
    """Of the difference of the first two passes, divided by two."""


class Separated(NamedTuple):
    """Classes of errors about A axes."""

    figures: dict[str, list[Estimate]]
    """By the names of `CLASSES`, and ``total`` for all frames: rms of each axis, or mean for the bias; intervals over
    the fields."""
    field_powers: dict[str, FloatArray]
    """(fields, axes): Mean squares of each field by class; for the bias the mean errors."""
    spectra: Spectra
    """Spectra of the errors."""
    differences: FloatArray
    """(fields, frames, axes): (e₁ − e₂)/√2, samples of the temporal noise."""
    fields: int
    """Number of fields used."""
    left_out: int
    """Fields without errors in too many frames."""


def separate(passes: FloatArray, geometry: ScanGeometry, seed: int = 0) -> Separated:
    """Separate the errors of three passes over several fields.

    Parameters
    ----------
    passes : (3, fields, frames, axes) array
        Errors of the passes, any unit; NaN for frames without an attitude, which are interpolated.
    geometry : ScanGeometry
        The scans.
    seed : int
        Seed of the bootstrap over the fields.

    Raises
    ------
    ValueError
        If fewer than two fields are complete.
    """
    known: NDArray[np.bool_] = np.isfinite(passes.sum(axis=(0, 3)))
    use = known.mean(axis=1) >= LEAST_COMPLETE
    if use.sum() < 2:
        raise ValueError("fewer than two fields have attitudes in at least nine tenths of their frames")
    one, two, other = (_filled(errors[use], known[use]) for errors in passes)
    bias = 0.5 * (one + two).mean(axis=(0, 1))
    density = _densities(one - bias, two - bias, other - bias, geometry.step_px)
    both = 0.5 * (one + two) - bias
    fov = np.mean(both * (other - bias), axis=1) - _periodic_power(both, other - bias, geometry)
    powers = {
        "bias": 0.5 * (one + two).mean(axis=1),
        # the bias is estimated from the same fields, which lowers the differences between them
        "fov_spatial": fov * use.sum() / (use.sum() - 1.0),
        "pixel_spatial": np.mean((one - bias) * (two - bias), axis=1) - fov,
        "temporal_noise": 0.5 * np.mean((one - two) ** 2, axis=1),
        "total": 0.5 * np.mean(one**2 + two**2, axis=1),
    }
    differences = (one - two) / math.sqrt(2.0)
    mean = Spectra(density.cycles_per_px, *(part.mean(axis=0) for part in density[1:]))
    return Separated(_figures(powers, seed), powers, mean, differences, int(use.sum()), int(np.sum(~use)))


def _filled(errors: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Errors (fields, frames, axes) with missing frames interpolated linearly."""
    filled = errors.copy()
    at = np.arange(errors.shape[1])
    for series, here in zip(filled, known, strict=True):
        if not here.all():
            for column in series.T:
                column[~here] = np.interp(at[~here], at[here], column[here])
    return filled


def _periodic_power(both: FloatArray, other: FloatArray, geometry: ScanGeometry) -> FloatArray:
    """Power (fields, axes) at the harmonics of the pixel period that two series (fields, frames, axes) have in common.

    Harmonic analysis: least-squares fit of slow functions (periods longer than the cut-off) and of the harmonics
    together. The mean power of the remainder per dimension is the continuum under the harmonics, and is subtracted.
    """
    frames = both.shape[1]
    at = np.arange(frames)
    slow = [np.ones(frames), at - at.mean()]
    for cycles in range(1, int(geometry.length_px / geometry.cut_period_px) + 1):
        slow += _waves(cycles * at / frames)
    pixel = [wave for cycles in _harmonics(frames) for wave in _waves(cycles * at)]
    design = np.stack([*slow, *pixel], axis=1)
    solve = np.linalg.pinv(design)
    fit, of_pixel = design @ solve, design[:, len(slow) :] @ solve[len(slow) :]
    waves = np.einsum("nm,fma->fna", of_pixel, both) * np.einsum("nm,fma->fna", of_pixel, other)
    rest = np.sum(both * other, axis=1) - np.sum(both * np.einsum("nm,fma->fna", fit, other), axis=1)
    continuum = rest / (frames - np.trace(fit))
    return np.asarray((waves.sum(axis=1) - np.sum(of_pixel**2) * continuum) / frames)


def _harmonics(frames: int) -> list[float]:
    """Frequencies of the harmonics of the pixel period, cycles per frame, as far as so many frames distinguish them.

    Off the middle of a field of 13 degrees stars move by up to 1.3 % more than in it: frequencies at most half a cycle
    apart over the scan represent all between.
    """
    along_x, along_y = STEP_PX
    if frames < 40:
        return [along_x, along_y]
    of_x = [order * along_x * more for order in (1, 2) for more in (1.0, 1.0065, 1.013)]
    of_y = [order * along_y * more for order in (1, 2) for more in (1.0, 1.013)]
    return [*of_x, *of_y, 3.0 * along_x, 3.0 * along_y]


def _waves(cycles: NDArray[np.floating[Any]]) -> list[NDArray[np.floating[Any]]]:
    return [np.cos(2.0 * math.pi * cycles), np.sin(2.0 * math.pi * cycles)]


def _densities(one: FloatArray, two: FloatArray, other: FloatArray, step_px: float) -> Spectra:
    """Multitaper spectra of every field (fields, frequencies, axes)."""
    frames = one.shape[1]
    both, apart = 0.5 * (one + two), (one - two) / math.sqrt(2.0)
    found = []
    for taper in dpss(frames, BANDWIDTH, TAPERS):
        pairs = ((one, one), (two, two), (one, two), (both, other), (apart, apart))
        made = [csd(x, y, 1.0 / step_px, window=taper, nperseg=frames, detrend=False, axis=1) for x, y in pairs]
        cycles = made[0][0]
        first, second, repeated, common, noise = (np.real(density) for _, density in made)
        found.append((0.5 * (first + second), repeated, common, noise))
    return Spectra(cycles, *(np.mean(part, axis=0) for part in zip(*found, strict=True)))


def _figures(powers: dict[str, FloatArray], seed: int) -> dict[str, list[Estimate]]:
    """Rms of each class from the mean of its power over the fields, with intervals of that mean by the bootstrap."""
    figures = {}
    for name, of_field in powers.items():
        mean = of_field.mean(axis=0)
        ends = moment_intervals(of_field, seed)["mean"] if len(of_field) >= FEWEST_FIELDS else None
        if ends is None:
            ends = np.full((len(mean), 2), np.nan)
        if name != "bias":
            # noise makes an unresolved power negative; its upper limit is at least half the width of the interval
            ends[:, 1] = np.maximum(ends[:, 1], 0.5 * (ends[:, 1] - ends[:, 0]))
            mean, ends = np.sqrt(np.maximum(mean, 0.0)), np.sqrt(np.maximum(ends, 0.0))
        figures[name] = [Estimate(float(m), float(e[0]), float(e[1])) for m, e in zip(mean, ends, strict=True)]
    return figures
