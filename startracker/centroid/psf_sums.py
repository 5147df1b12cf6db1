"""Kernels of a fit's inner loop: the star image interpolated in pixels, and the sums over them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.kernels import kernel, kernel_with

__all__ = ["fill", "fill_window", "interpolate", "interpolated", "normal_equations", "sums", "sums_of_one"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
def fill(
    table: FloatArray,
    axes: FloatArray,
    oversampling: int,
    x: float,
    y: float,
    px: IntArray,
    py: IntArray,
    low_x: int,
    low_y: int,
    out: FloatArray,
    weights: FloatArray,
    lines: FloatArray,
) -> None:
    """Light of a star at (x, y) in pixels (px, py), and its derivatives by dx and dy, to the rows of `out` (3, N).

    Where the table is the product of two `axes` (x, y), its interpolation is the product of theirs, and it is not read.

    Parameters
    ----------
    low_x, low_y : int
        No pixel is left of, or above, this one, nor L or more beyond it.
    weights, lines : array
        Working space, of the shapes (2, 8) and (4, L).
    """
    size = axes.shape[1] if len(axes) else table.shape[0]
    first_x = interpolate(size, oversampling, -x, weights, 0)
    first_y = interpolate(size, oversampling, -y, weights, 1)
    if not len(axes):
        for n in range(len(px)):
            at_x, at_y = first_x + px[n] * oversampling, first_y + py[n] * oversampling
            out[0, n], out[1, n], out[2, n] = interpolated(table, oversampling, at_x, at_y, weights, 0)
        return
    share_x, slope_x, share_y, slope_y = lines[0], lines[1], lines[2], lines[3]
    share, by_x, by_y = out[0], out[1], out[2]
    out[:, : len(px)] = 0.0
    for term in range(0, len(axes), 2):
        _along(axes[term], oversampling, first_x + low_x * oversampling, weights[0], share_x, slope_x)
        _along(axes[term + 1], oversampling, first_y + low_y * oversampling, weights[1], share_y, slope_y)
        for n in range(len(px)):
            i, j = np.uint64(px[n] - low_x), np.uint64(py[n] - low_y)
            share[n] += share_x[i] * share_y[j]
            by_x[n] += slope_x[i] * share_y[j]
            by_y[n] += share_x[i] * slope_y[j]


@kernel
def fill_window(
    table: FloatArray,
    axes: FloatArray,
    oversampling: int,
    dx: float,
    dy: float,
    wide: int,
    high: int,
    out: FloatArray,
    weights: FloatArray,
    lines: FloatArray,
) -> None:
    """`fill` for all pixels of a window, row by row, whose first one is at (dx, dy) from the star."""
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
        _along(axes[term], oversampling, first_x, weights[0], share_x, slope_x)
        _along(axes[term + 1], oversampling, first_y, weights[1], share_y, slope_y)
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
    axis: FloatArray, oversampling: int, first: int, weights: FloatArray, value: FloatArray, slope: FloatArray
) -> None:
    """Values and slopes of one axis at every pixel from the point `first` on; zero outside."""
    for k in range(len(value)):
        i = first + k * oversampling
        value[k], slope[k] = 0.0, 0.0
        if 1 <= i <= len(axis) - 3:
            p0, p1, p2, p3 = axis[i - 1], axis[i], axis[i + 1], axis[i + 2]
            value[k] = weights[0] * p0 + weights[1] * p1 + weights[2] * p2 + weights[3] * p3
            slope[k] = oversampling * (weights[4] * p0 + weights[5] * p1 + weights[6] * p2 + weights[7] * p3)


@kernel
def sums(
    shares: FloatArray,
    flux: FloatArray,
    signal: FloatArray,
    dark: FloatArray,
    variances: FloatArray,
    inverse_gain: float,
    flat_error: float,
    weigh: bool,
    gradient: FloatArray,
    normal: FloatArray,
    right: FloatArray,
) -> float:
    """χ² of the model of stars in pixels; Fisher matrix and score go to `normal` and `right`.

    `shares` (M, 3, N) are the stars' light of flux 1 and its derivatives, see `fill`. Pixels have a signal and a
    variance of the dark; their variances are kept in `variances`, and made anew where `weigh` is set. `gradient` is
    working space.
    """
    m, size = len(flux), 3 * len(flux)
    normal[:], right[:] = 0.0, 0.0
    chi2 = 0.0
    for n in range(len(variances)):
        model = 0.0
        for star in range(m):
            light = flux[star] * shares[star, 0, n]
            model += light
            gradient[3 * star] = -flux[star] * shares[star, 1, n]
            gradient[3 * star + 1] = -flux[star] * shares[star, 2, n]
            gradient[3 * star + 2] = light
        if weigh:
            light = max(model, 0.0)
            variances[n] = dark[n] + light * inverse_gain + (flat_error * light) ** 2
        weight = 1.0 / variances[n]
        residual = signal[n] - model
        chi2 += weight * residual * residual
        for a in range(size):
            g = weight * gradient[a]
            right[a] += g * residual
            for b in range(a + 1):
                normal[a, b] += g * gradient[b]
    return chi2


# sums in any order: added up in the order of the pixels each sum waits for the one before, five times as long
@kernel_with(fastmath={"reassoc"})
def sums_of_one(
    shares: FloatArray,
    flux: float,
    signal: FloatArray,
    dark: FloatArray,
    variances: FloatArray,
    inverse_gain: float,
    flat_error: float,
    weigh: bool,
    normal: FloatArray,
    right: FloatArray,
) -> float:
    """The sums of `sums` for a star alone, whose `shares` are (3, N), without an array in the loop, to rounding."""
    chi2, rx, ry, rf, xx, xy, yy, xf, yf, ff = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    share, by_x, by_y = shares[0], shares[1], shares[2]
    for n in range(len(variances)):
        model, gx, gy = flux * share[n], -flux * by_x[n], -flux * by_y[n]
        if weigh:
            light = max(model, 0.0)
            variances[n] = dark[n] + light * inverse_gain + (flat_error * light) ** 2
        weight = 1.0 / variances[n]
        residual = signal[n] - model
        chi2 += weight * residual * residual
        wx, wy, wf = weight * gx, weight * gy, weight * model
        rx, ry, rf = rx + wx * residual, ry + wy * residual, rf + wf * residual
        xx, xy, yy = xx + wx * gx, xy + wy * gx, yy + wy * gy
        xf, yf, ff = xf + wf * gx, yf + wf * gy, ff + wf * model
    right[0], right[1], right[2] = rx, ry, rf
    normal[0, 0], normal[1, 0], normal[1, 1] = xx, xy, yy
    normal[2, 0], normal[2, 1], normal[2, 2] = xf, yf, ff
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

    The sums are in any order, as those of `sums_of_one`; `work` is working space for N numbers.
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
