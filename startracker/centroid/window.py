"""Kernels that read a star's window: its moments, their noise, and the corrected position."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.centroid.bias import GUESSES, fill_centres, guess_centre, invert_from, invert_moments, window_moments
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.detection.tiles import Plane
from startracker.detection.values import Image, is_value
from startracker.sorting import finite_medians

FloatImage = NDArray[np.float32]

Moments: TypeAlias = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
MEASURED = 6
"""Number of columns of a measurement: x, y, flux, var x, var y, cov xy."""

_WIDTH_STARS = 15
"""Number of the brightest clean stars from whose widths the median is taken."""
_RECENTRINGS = 3
_LARGEST_FLAT_TOP_PX = 12
_FLAT_TOP_ERROR_PX = 0.05
"""Position error of a saturated star, px: truncated Gaussians of σ 0.7 to 1.8 px, saturated 1.2 to 1000 times, have
0.03 px rms (tests/statistical)."""
_BLOOM_SHARE = 0.25
_WITHIN_PIXEL = 0.35
_PIXEL_VARIANCE = 1.0 / 12.0


class Pixels(NamedTuple):
    """Pixels of a frame and their noise, in the form that kernels read.

    Parameters
    ----------
    image : (H, W)
        DN.
    level, noise : Plane
        Background, DN.
    inverse_gain : float
        DN per electron.
    flat_error : float
        Relative standard deviation of the pixels' sensitivities.
    """

    image: Image
    level: Plane
    noise: Plane
    inverse_gain: float
    flat_error: float


class Peaks(NamedTuple):
    """Columns of `startracker.detection.spots.Spots` for kernels: brightest pixels, number of pixels, saturation."""

    x: IntArray
    y: IntArray
    pixels: IntArray
    saturated: BoolArray


@kernel_part
def _lines_about(plane: Plane, y: np.uint64) -> tuple[np.uint64, np.uint64, np.float32]:
    """Indices of the lines of a map above and below a row, and the position of the row between them (0 to 1)."""
    cell = np.uint64(plane.cell[y])
    return cell, min(cell + np.uint64(1), np.uint64(len(plane.lines) - 1)), plane.share[y]


@kernel
def read_pixels(
    pixels: Pixels, left: int, top: int, wide: int, high: int, ceiling: float, signal: FloatArray, dark: FloatArray
) -> int:
    """Signal above the background in a window, row by row, and its variance in the dark; returns the number of usable
    pixels.

    Pixels that are not usable, because they are not finite or are at the ceiling, get no signal and an infinite
    variance.
    """
    image, sky, noise, n, count = pixels.image, pixels.level.lines, pixels.noise.lines, np.uint64(0), 0
    # Single elements and no slices, because numba counts references to slices.
    for j in range(np.uint64(top), np.uint64(top + high)):
        upper, lower, share = _lines_about(pixels.level, j)
        quiet, loud, part = _lines_about(pixels.noise, j)
        for i in range(np.uint64(left), np.uint64(left + wide)):
            usable = is_value(image[j, i]) and np.float64(image[j, i]) < ceiling
            above = np.float64(image[j, i]) - np.float64(sky[upper, i] + share * (sky[lower, i] - sky[upper, i]))
            sigma = np.float64(noise[quiet, i] + part * (noise[loud, i] - noise[quiet, i]))
            signal[n], dark[n] = above if usable else 0.0, sigma**2 if usable else np.inf
            count += int(usable)
            n += np.uint64(1)
    return count


@kernel
def read_window(pixels: Pixels, x: int, y: int, half: int) -> Moments:
    """Moments of the signal over the pixels within `half` of (x, y) that lie on the image.

    Returns
    -------
    tuple of 12 numbers
        Signal S; mean x and y relative to (x, y); variances of x and y; the noise variances of the two means and their
        covariance; limits low x, high x, low y, high y of the window relative to (x, y). S is NaN if a pixel is not
        finite.

    Notes
    -----
    var(m_x) = Σ (k − m_x)² v_k / S², v = noise² + max(signal, 0) / gain: independent pixels, to first order in the
    noise.
    """
    image, sky, noise = pixels.image, pixels.level.lines, pixels.noise.lines
    inverse_gain = pixels.inverse_gain
    height, width = image.shape
    low_x, high_x = -min(half, x), min(half, width - 1 - x)
    low_y, high_y = -min(half, y), min(half, height - 1 - y)
    # Sums of the signal and of its variance, times 1, i, j, i², j² and ij.
    s = si = sj = sii = sjj = 0.0
    v = vi = vj = vii = vjj = vij = 0.0
    for j in range(low_y, high_y + 1):
        at = np.uint64(y + j)
        upper, lower, share = _lines_about(pixels.level, at)
        quiet, loud, part = _lines_about(pixels.noise, at)
        row = row_i = row_ii = noisy = noisy_i = noisy_ii = 0.0
        for i in range(low_x, high_x + 1):
            n = np.uint64(x + i)
            signal = np.float64(image[at, n]) - np.float64(sky[upper, n] + share * (sky[lower, n] - sky[upper, n]))
            sigma = np.float64(noise[quiet, n] + part * (noise[loud, n] - noise[quiet, n]))
            variance = sigma * sigma + max(signal, 0.0) * inverse_gain
            row, row_i, row_ii = row + signal, row_i + signal * i, row_ii + signal * i * i
            noisy, noisy_i, noisy_ii = noisy + variance, noisy_i + variance * i, noisy_ii + variance * i * i
        s, si, sj = s + row, si + row_i, sj + row * j
        sii, sjj = sii + row_ii, sjj + row * j * j
        v, vi, vj = v + noisy, vi + noisy_i, vj + noisy * j
        vii, vjj, vij = vii + noisy_ii, vjj + noisy * j * j, vij + noisy_i * j
    mx, my = si / s, sj / s
    noise_x, noise_y = vii - 2.0 * mx * vi + mx * mx * v, vjj - 2.0 * my * vj + my * my * v
    noise_xy = vij - mx * vj - my * vi + mx * my * v
    return (
        s,
        mx,
        my,
        sii / s - mx * mx,
        sjj / s - my * my,
        noise_x / s**2,
        noise_y / s**2,
        noise_xy / s**2,
        float(low_x),
        float(high_x),
        float(low_y),
        float(high_y),
    )


def frame_widths(pixels: Pixels, xs: IntArray, ys: IntArray, unfit: BoolArray, half: int) -> tuple[float, ...]:
    """Median Gaussian widths along x and y, px, of the brightest clean stars, given by their brightest pixels.

    On each axis, mean and variance of the marginal over the window are inverted to centre and width. NaN if no window
    determines them.
    """
    clean = (~unfit).nonzero()[0][:_WIDTH_STARS]
    widths = np.full((len(clean), 2), np.nan)
    _fill_widths(pixels, xs[clean], ys[clean], half, widths)
    return finite_medians(widths)


@kernel
def _fill_widths(pixels: Pixels, xs: IntArray, ys: IntArray, half: int, widths: FloatArray) -> None:
    """Fill the widths (N, 2) of stars whose windows determine them."""
    for n in range(len(xs)):
        w = read_window(pixels, xs[n], ys[n], half)
        for axis in range(2):
            if w[0] > 0.0 and abs(w[1 + axis]) < half and w[3 + axis] > 0.0:
                low, high = int(w[8 + 2 * axis]), int(w[9 + 2 * axis])
                widths[n, axis] = invert_moments(w[1 + axis], w[3 + axis], low, high)[1]


@kernel_part
def _recentred(pixels: Pixels, x: int, y: int, half: int) -> tuple[int, int]:
    """Pixel in which the moment of its own window lies: a flat top has many equally bright pixels."""
    height, width = pixels.image.shape
    for _ in range(8):
        w = read_window(pixels, x, y, half)
        if not w[0] > 0.0:
            break
        dx, dy = round(w[1]), round(w[2])
        if dx == 0 and dy == 0:
            break
        x, y = min(max(x + dx, 0), width - 1), min(max(y + dy, 0), height - 1)
    return x, y


def measure_stars(pixels: Pixels, peaks: Peaks, half: int, sigma_x: float, sigma_y: float, correct: bool) -> FloatArray:
    """Measurements (N, 6), see `MEASURED`, of stars given by their brightest pixels; NaN if no star image is found.

    Parameters
    ----------
    sigma_x, sigma_y : float
        Widths for the bias correction, px.
    correct : bool
        Whether to correct the bias; the flux is corrected for the light outside the window in any case.
    """
    out = np.full((len(peaks.x), MEASURED), np.nan)
    _measure(pixels, peaks, half, (sigma_x, sigma_y), correct, np.empty((2, GUESSES, 2)), np.empty((2, 3)), out)
    return out


@kernel
def _measure(
    pixels: Pixels, peaks: Peaks, half: int, sigma: tuple[float, float], correct: bool, centres: FloatArray,
    axes: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill the rows of `measure_stars`; `centres` (2, `GUESSES`, 2) and `axes` (2, 3) are working space."""
    for axis in range(2):
        fill_centres(sigma[axis], half, centres[axis])
    limit = max(sigma[0], sigma[1], 1.0) ** 2
    for index in range(len(out)):
        row = out[index]
        if peaks.saturated[index]:
            _measure_flat_top(pixels, peaks, index, half, row)
            continue
        _measure_star(pixels, peaks.x[index], peaks.y[index], half, sigma, correct, centres, axes, row)
        if row[3] > limit or row[4] > limit:
            # A fit with a standard deviation above a pixel and above the PSF's found no star image.
            for k in range(MEASURED):
                row[k] = np.nan


@kernel_part
def _measure_flat_top(pixels: Pixels, peaks: Peaks, index: int, half: int, out: FloatArray) -> None:
    """Row of a saturated star: its moment over a window enlarged by its radius."""
    radius = math.sqrt(peaks.pixels[index] / math.pi)
    reach = min(half + math.ceil(radius), _LARGEST_FLAT_TOP_PX)
    x, y = _recentred(pixels, peaks.x[index], peaks.y[index], reach)
    w = read_window(pixels, x, y, reach)
    if not w[0] > 0.0:
        return
    # Blooming, in which charge spreads along one axis, makes the two widths different.
    bloomed = math.sqrt(max(w[3], 0.0)) - math.sqrt(max(w[4], 0.0))
    extra = _FLAT_TOP_ERROR_PX**2 + (_BLOOM_SHARE * bloomed) ** 2
    out[0], out[1], out[2] = x + w[1], y + w[2], w[0]
    out[3], out[4], out[5] = w[5] + extra, w[6] + extra, w[7]


@kernel
def _measure_star(
    pixels: Pixels, x: int, y: int, half: int, sigma: tuple[float, float], correct: bool, centres: FloatArray,
    axes: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Row of a star from its corrected moment, with the window moved until its central pixel contains the centre.

    A row of `axes` receives the centre along an axis, d(centre)/d(moment), and the share of the light in the window.
    """
    height, width = pixels.image.shape
    for attempt in range(_RECENTRINGS):
        w = read_window(pixels, x, y, half)
        if not w[0] > 0.0:
            return
        for axis in range(2):
            moment, low, high = w[1 + axis], int(w[8 + 2 * axis]), int(w[9 + 2 * axis])
            if correct:
                # For a complete window the table is so accurate that one step of Newton's method is sufficient.
                guess = guess_centre(moment, centres[axis]) if low == -half and high == half else moment
                axes[axis, 0], axes[axis, 1], axes[axis, 2] = invert_from(guess, moment, sigma[axis], low, high)
            else:
                axes[axis, 0], axes[axis, 1] = moment, 1.0
                axes[axis, 2] = window_moments(moment, sigma[axis], low, high)[0]
        x_next = min(max(x + round(min(max(axes[0, 0], -half), half)), 0), width - 1)
        y_next = min(max(y + round(min(max(axes[1, 0], -half), half)), 0), height - 1)
        if x_next == x and y_next == y:
            break
        if attempt < _RECENTRINGS - 1:
            x, y = x_next, y_next
    if not math.isfinite(axes[0, 1] + axes[1, 1]):
        return
    for axis in range(2):
        # If all light is within one pixel, the moments hardly determine the position, but it is at least known to be in
        # this pixel, with a variance of 1/12 px².
        if sigma[axis] < _WITHIN_PIXEL:
            axes[axis, 1] = min(axes[axis, 1], math.sqrt(1.0 + _PIXEL_VARIANCE / w[5 + axis]))
    slope_x, slope_y = axes[0, 1], axes[1, 1]
    out[0], out[1] = x + axes[0, 0], y + axes[1, 0]
    out[2] = w[0] / max(axes[0, 2] * axes[1, 2], 0.05)
    out[3], out[4], out[5] = w[5] * slope_x**2, w[6] * slope_y**2, w[7] * slope_x * slope_y
