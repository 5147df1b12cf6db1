"""Kernel that fits stars which stand alone, nearly all of a frame: what a group needs arrays for are numbers here."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.cholesky import factorise, substitute
from startracker.centroid.psf_sums import fill_window, sums_of_one
from startracker.centroid.window import read_pixels
from startracker.detection.plane import Plane
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = [
    "ACCEPTED_PX",
    "CONVERGED_PX",
    "FITTED",
    "ITERATIONS",
    "LARGEST_GROWTH",
    "LONGEST_STEP_PX",
    "WEIGHINGS",
    "amplitude",
    "fit_alone",
    "note_star",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FITTED = 8
"""Columns of a fit: x, y, flux, var x, var y, cov xy, χ², degrees of freedom."""
ITERATIONS = 25
LONGEST_STEP_PX = 0.5
CONVERGED_PX = 2e-4
"""Of the last step; the steps shrink tenfold and more, so that the next would be below 2e-5."""
_CONVERGED_SIGMA = 0.02
"""Of the last step of a star alone, in its own standard errors, where it is accepted: the next would be below 0.002 of
them and 1e-4 px."""
ACCEPTED_PX = 1e-3
WEIGHINGS = 3
LARGEST_GROWTH = 2.0


@kernel
def amplitude(share: FloatArray, signal: FloatArray, dark: FloatArray) -> float:
    """Flux by unweighted least squares, Σ p d / Σ p², over the pixels of finite variance."""
    above, below = 0.0, 0.0
    for n in range(len(signal)):
        p = share[n] if dark[n] < np.inf else 0.0
        above += p * signal[n]
        below += p * p
    return above / below if below > 0.0 else np.nan


@kernel
def note_star(
    row: FloatArray, x: float, y: float, flux: float, chi2: float, freedom: int, normal: FloatArray, first: int,
    column: FloatArray,
) -> None:  # fmt: skip
    """Row of a star's fit, see `FITTED`; its x and y are the parameters from `first` on of a matrix that is factorised,
    of as many as `column`, which is working space."""
    row[0], row[1], row[2], row[6], row[7] = x, y, flux, chi2, freedom
    for axis in range(2):
        column[:] = 0.0
        column[first + axis] = 1.0
        substitute(normal, len(column), column)
        row[3 + axis] = column[first + axis]
        row[5] = column[first]


@kernel
def fit_alone(
    image: Image,
    level: Plane,
    noise: Plane,
    table: FloatArray,
    axes: FloatArray,
    oversampling: int,
    stars: IntArray,
    xs: FloatArray,
    ys: FloatArray,
    halves: IntArray,
    ceilings: FloatArray,
    inverse_gain: float,
    flat_error: float,
    reweigh: bool,
    out: FloatArray,
) -> None:
    """Fits of the stars of which `stars` are the numbers, see `startracker.centroid.psf_kernel.fit_stars`, to `out`."""
    height, width = image.shape
    side = 0
    for index in stars:
        side = max(side, 2 * halves[index] + 1)
    every_signal, every_dark, every_variance = np.empty(side * side), np.empty(side * side), np.empty(side * side)
    shares, lines, weights = np.empty((3, side * side)), np.empty((4, side)), np.empty((2, 8))
    normal, right, column = np.empty((3, 3)), np.empty(3), np.empty(3)
    for index in stars:
        x, y, half, ceiling = xs[index], ys[index], halves[index], ceilings[index]
        cx, cy = round(x), round(y)
        left, top = max(cx - half, 0), max(cy - half, 0)
        wide, high = min(cx + half + 1, width) - left, min(cy + half + 1, height) - top
        pixels = wide * high
        signal, dark, variances = every_signal[:pixels], every_dark[:pixels], every_variance[:pixels]
        count = read_pixels(image, level, noise, left, top, wide, high, ceiling, signal, dark)
        if count <= 3:
            continue
        fill_window(table, axes, oversampling, left - x, top - y, wide, high, shares, weights, lines)
        flux, chi2, step = amplitude(shares[0], signal, dark), 0.0, 1.0
        if not flux > 0.0:
            continue
        for iteration in range(ITERATIONS):
            weigh = reweigh or iteration < WEIGHINGS
            if iteration > 0:
                fill_window(table, axes, oversampling, left - x, top - y, wide, high, shares, weights, lines)
            chi2 = sums_of_one(shares, flux, signal, dark, variances, inverse_gain, flat_error, weigh, normal, right)
            if not factorise(normal, 3):
                break
            column[0], column[1], column[2] = right[0], right[1], right[2]
            substitute(normal, 3, right)
            gain = column[0] * right[0] + column[1] * right[1] + column[2] * right[2]
            step = max(abs(right[0]), abs(right[1]))
            if not math.isfinite(step):
                break
            short = min(1.0, LONGEST_STEP_PX / step) if step > 0.0 else 1.0
            x, y = x + short * right[0], y + short * right[1]
            flux *= min(max(1.0 + short * right[2], 1.0 / LARGEST_GROWTH), LARGEST_GROWTH)
            if abs(x - cx) > half or abs(y - cy) > half:
                step = np.inf
                break
            enough = (reweigh or iteration > WEIGHINGS) and step < ACCEPTED_PX and gain < _CONVERGED_SIGMA**2
            if step < CONVERGED_PX or enough:
                # what the last step gains is known; matrix and χ² are those of its start but for that
                chi2, step = chi2 - gain, 0.0
                break
        if step > ACCEPTED_PX:
            continue
        note_star(out[index], x, y, flux, chi2, count - 3, normal, 0, column)
