"""Separation of attitude errors into the classes of ECSS-E-ST-60-20C, by repetition.

Every field is scanned in four passes (`scan`), each with independent noise: twice with the device at the same
attitudes, and twice with other pixels behind the same lens, with the stars at other positions within the pixels. With
the errors e₁ and e₂ of the first two and the mean e₃ of the others at the same position in the field,

- temporal noise is what differs between the first two: its variance is ⟨(e₁ − e₂)²⟩ / 2;
- spatial errors are what both repeat: ⟨e₁ e₂⟩ has no contribution of the noise;
- of these the covariance with e₃ does not retain what depends on single pixels or on the position within a pixel: the
  pixel spatial error, ⟨e₁ e₂⟩ − ⟨(e₁ + e₂) e₃⟩ / 2, over the frames in which all passes have the same stars at the
  border of the field. All other repeated errors are the FOV spatial error, which changes over many pixels, from field
  to field, and where stars enter or leave the field;
- the mean over all fields is the bias.

The mean square error of all frames is the sum of the squares of these four. The spectra of the same products show at
which periods the errors are. Spectra alone cannot separate the classes: the error by uneven pixels across the
direction of motion extends to zero frequency, and a star that enters or leaves the field modulates the harmonics of
the pixel period.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd
from scipy.signal.windows import dpss

from simulator.study.datasheet.scan import ScanGeometry
from simulator.study.datasheet.sheet import Estimate
from simulator.study.intervals import moment_intervals
from startracker.core import FloatArray

CLASSES = ("bias", "fov_spatial", "pixel_spatial", "temporal_noise")
"""Classes that a scan separates."""

BANDWIDTH, TAPERS = 2.5, 2
"""Half bandwidth of the windows of the plotted spectra in units of one over the length of the scan, and their number.
The first two discrete prolate spheroidal sequences have less than 0.1 % of their power outside (Thomson 1982, Proc.
IEEE 70, 1055; Slepian 1978, Bell Syst. Tech. J. 57, 1371)."""

LEAST_COMPLETE = 0.9
"""Minimum fraction of the frames of a field with an error in all passes; fewer, and the field is left out."""

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
    """Cross-spectral density of the first two passes with those of other pixels."""
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


def separate(
    passes: FloatArray, geometry: ScanGeometry, seed: int = 0, same_field: NDArray[np.bool_] | None = None
) -> Separated:
    """Separate the errors of the passes over several fields.

    Parameters
    ----------
    passes : (passes, fields, frames, axes) array
        Errors of the passes of `scan_attitudes`, any unit; NaN for frames without an attitude, which are interpolated.
    geometry : ScanGeometry
        The scans.
    seed : int
        Seed of the bootstrap over the fields.
    same_field : (fields, frames) array of bool, optional
        Frames in which all passes have the same stars at the border of the field. In the others what the first two
        repeat is FOV spatial error. None: all.

    Raises
    ------
    ValueError
        If fewer than two fields are complete.
    """
    known: NDArray[np.bool_] = np.isfinite(passes.sum(axis=(0, 3)))
    use = known.mean(axis=1) >= LEAST_COMPLETE
    if use.sum() < 2:
        raise ValueError("fewer than two fields have attitudes in at least nine tenths of their frames")
    one, two, *others = (_filled(errors[use], known[use]) for errors in passes)
    other = np.mean(others, axis=0)
    bias = 0.5 * (one + two).mean(axis=(0, 1))
    density = _densities(one - bias, two - bias, other - bias, geometry.step_px)
    repeated, common = (one - bias) * (two - bias), (0.5 * (one + two) - bias) * (other - bias)
    same = np.ones(one.shape[:2], dtype=bool) if same_field is None else same_field[use]
    pixel = np.einsum("fn,fna->fa", same, repeated - common) / np.maximum(same.sum(axis=1), 1)[:, None]
    powers = {
        "bias": 0.5 * (one + two).mean(axis=1),
        # the bias is estimated from the same fields, which lowers the differences between them
        "fov_spatial": (repeated.mean(axis=1) - pixel) * use.sum() / (use.sum() - 1.0),
        "pixel_spatial": pixel,
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
