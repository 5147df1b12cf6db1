"""Kernels of a fit's inner loop: the star image interpolated in pixels, and the sums over them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.psf_model import Samples
from startracker.kernels import kernel, kernel_with

__all__ = ["fill_window", "interpolate", "interpolated", "normal_equations", "weigh_pixels"]

FloatArray = NDArray[np.float64]


@kernel
def interpolate(size: int, oversampling: int, distance: float, weights: FloatArray, row: int) -> int:
    """Point of the table before a pixel at `distance` from the star; the weights of four points about it go to
    a row of `weights`, and those of the derivative by the place in the table.

    A pixel further on adds `oversampling` to the point, and leaves the weights as they are.
    """
    place = distance * oversampling + (size - 1) // 2
    first = math.floor(place)
    t = place - first
    weights[row, 0], weights[row, 1] = ((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0
    weights[row, 2], weights[row, 3] = ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t
    weights[row, 4], weights[row, 5] = (-1.5 * t + 2.0) * t - 0.5, (4.5 * t - 5.0) * t
    weights[row, 6], weights[row, 7] = (-4.5 * t + 4.0) * t + 0.5, (1.5 * t - 1.0) * t
    return first


@kernel
def interpolated(
    table: FloatArray, oversampling: int, i: int, j: int, weights: FloatArray, row: int
) -> tuple[float, float, float]:
    """Light in the pixel at (dx, dy) from the star, and its derivatives by dx and dy: bicubic (Keys 1981, a = −½).

    (i, j) is the point of the table before it; the weights of x stand in a row, those of y in the next. Zero outside
    the table.
    """
    size = table.shape[0]
    if i < 1 or j < 1 or i > size - 3 or j > size - 3:
        return 0.0, 0.0, 0.0
    value, by_x, by_y = 0.0, 0.0, 0.0
    for k in range(4):
        line = table[j - 1 + k]
        p0, p1, p2, p3 = line[i - 1], line[i], line[i + 1], line[i + 2]
        across = weights[row, 0] * p0 + weights[row, 1] * p1 + weights[row, 2] * p2 + weights[row, 3] * p3
        slope = weights[row, 4] * p0 + weights[row, 5] * p1 + weights[row, 6] * p2 + weights[row, 7] * p3
        value += weights[row + 1, k] * across
        by_x += weights[row + 1, k] * slope
        by_y += weights[row + 1, 4 + k] * across
    return value, by_x * oversampling, by_y * oversampling


@kernel
def fill_window(psf: Samples, dx: float, dy: float, wide: int, high: int, out: FloatArray, lines: FloatArray) -> None:
    """Light of a star in all pixels of a window, row by row, and its derivatives by dx and dy, to `out` (3, N).

    The first pixel is at (dx, dy) from the star. Where the table is a sum of products of two axes its interpolation is
    that of theirs, and it is not read. `lines` (4, L) is working space, L no less than `wide` and `high`.
    """
    table, axes, oversampling = psf.table, psf.axes, psf.oversampling
    weights = np.empty((2, 8))
    size = axes.shape[1] if len(axes) else table.shape[0]
    first_x = interpolate(size, oversampling, dx, weights, 0)
    first_y = interpolate(size, oversampling, dy, weights, 1)
    share, by_x, by_y, n = out[0], out[1], out[2], np.uint64(0)
    if not len(axes):
        for j in range(high):
            for i in range(wide):
                at_x, at_y = first_x + i * oversampling, first_y + j * oversampling
                share[n], by_x[n], by_y[n] = interpolated(table, oversampling, at_x, at_y, weights, 0)
                n += np.uint64(1)
        return
    share_x, slope_x, share_y, slope_y = lines[0], lines[1], lines[2], lines[3]
    for term in range(0, len(axes), 2):
        _along(axes[term], oversampling, first_x, wide, weights[0], share_x, slope_x)
        _along(axes[term + 1], oversampling, first_y, high, weights[1], share_y, slope_y)
        n = np.uint64(0)
        for j in range(high):
            s, t = share_y[j], slope_y[j]
            for i in range(wide):
                p, px, py = share_x[i] * s, slope_x[i] * s, share_x[i] * t
                if term == 0:
                    share[n], by_x[n], by_y[n] = p, px, py
                else:
                    share[n], by_x[n], by_y[n] = share[n] + p, by_x[n] + px, by_y[n] + py
                n += np.uint64(1)


@kernel
def _along(
    axis: FloatArray,
    oversampling: int,
    first: int,
    count: int,
    weights: FloatArray,
    value: FloatArray,
    slope: FloatArray,
) -> None:
    """Values and slopes of one axis at so many pixels from the point `first` on; zero outside."""
    for k in range(count):
        i = first + k * oversampling
        value[k], slope[k] = 0.0, 0.0
        if 1 <= i <= len(axis) - 3:
            p0, p1, p2, p3 = axis[i - 1], axis[i], axis[i + 1], axis[i + 2]
            value[k] = weights[0] * p0 + weights[1] * p1 + weights[2] * p2 + weights[3] * p3
            slope[k] = oversampling * (weights[4] * p0 + weights[5] * p1 + weights[6] * p2 + weights[7] * p3)


# sums in any order: added up in the order of the pixels each sum waits for the one before, five times as long
@kernel_with(fastmath={"reassoc"})
def weigh_pixels(
    shares: FloatArray,
    flux: FloatArray,
    signal: FloatArray,
    dark: FloatArray,
    noise: tuple[float, float],
    weigh: bool,
    rows: FloatArray,
) -> float:
    """χ² of the model of M stars in N pixels; makes `shares` the model's slopes by ln(flux), x and y of each star.

    Parameters
    ----------
    shares : (3 M, N)
        Light of each star of flux 1, and its derivatives by dx and dy, see `fill_window`.
    flux : (M,)
    signal, dark : (N,)
        Of the pixels above the background, and its variance in the dark.
    noise : (float, float)
        DN an electron, and relative error of the flat field.
    weigh : bool
        Whether the variances are made anew.
    rows : (4, N)
        Variances, which are kept where they are not made anew; gets weights, residuals; the last is working space.
    """
    variances, weights, residuals, model = rows[0], rows[1], rows[2], rows[3]
    model[:] = 0.0
    for star in range(len(flux)):
        light, by_x, by_y, f = shares[3 * star], shares[3 * star + 1], shares[3 * star + 2], flux[star]
        for n in range(len(signal)):
            light[n], by_x[n], by_y[n] = f * light[n], -f * by_x[n], -f * by_y[n]
            model[n] += light[n]
    chi2 = 0.0
    for n in range(len(signal)):
        if weigh:
            light_here = max(model[n], 0.0)
            variances[n] = dark[n] + light_here * noise[0] + (noise[1] * light_here) ** 2
        weights[n], residuals[n] = 1.0 / variances[n], signal[n] - model[n]
        chi2 += weights[n] * residuals[n] * residuals[n]
    return chi2


@kernel_with(fastmath={"reassoc"})
def normal_equations(
    slopes: FloatArray,
    weights: FloatArray,
    residuals: FloatArray,
    count: int,
    normal: FloatArray,
    right: FloatArray,
    work: FloatArray,
) -> None:
    """Normal matrix, its lower half, and right side of so many weighted pixels, whose model has the slopes (M, N).

    The sums are in any order; `work` is working space for N numbers.
    """
    for a in range(len(slopes)):
        slope, total = slopes[a], 0.0
        for n in range(count):
            work[n] = slope[n] * weights[n]
            total += work[n] * residuals[n]
        right[a] = total
        for b in range(a + 1):
            other, total = slopes[b], 0.0
            for n in range(count):
                total += work[n] * other[n]
            normal[a, b] = total
