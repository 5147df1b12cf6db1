"""Kernels of a fit's inner loop: the star image interpolated in pixels, and the sums over them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["interpolate", "interpolated", "sums", "sums_of_one"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def sums(
    table: FloatArray,
    oversampling: int,
    x: FloatArray,
    y: FloatArray,
    flux: FloatArray,
    px: IntArray,
    py: IntArray,
    signal: FloatArray,
    dark: FloatArray,
    variances: FloatArray,
    inverse_gain: float,
    flat_error: float,
    weigh: bool,
    weights: FloatArray,
    normal: FloatArray,
    right: FloatArray,
) -> float:
    """χ² of the model of stars (x, y, flux) in pixels; Fisher matrix and score go to `normal` and `right`.

    Pixels have places (px, py), steps of the table; signal; variance of the dark. Their variances are kept in
    `variances`, and made anew where `weigh` is set. `weights` is working space.
    """
    m, size = len(x), 3 * len(x)
    gradient = np.empty(size)
    first_x, first_y = np.empty(m, np.int64), np.empty(m, np.int64)
    normal[:], right[:] = 0.0, 0.0
    chi2 = 0.0
    for star in range(m):
        first_x[star] = interpolate(table.shape[0], oversampling, -x[star], weights, 2 * star)
        first_y[star] = interpolate(table.shape[0], oversampling, -y[star], weights, 2 * star + 1)
    for n in range(len(variances)):
        model = 0.0
        for star in range(m):
            i, j = first_x[star] + px[n], first_y[star] + py[n]
            p, by_x, by_y = interpolated(table, oversampling, i, j, weights, 2 * star)
            model += flux[star] * p
            gradient[3 * star] = -flux[star] * by_x
            gradient[3 * star + 1] = -flux[star] * by_y
            gradient[3 * star + 2] = flux[star] * p
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


@njit(cache=True, error_model="numpy")
def sums_of_one(
    table: FloatArray,
    oversampling: int,
    x: float,
    y: float,
    flux: float,
    px: IntArray,
    py: IntArray,
    signal: FloatArray,
    dark: FloatArray,
    variances: FloatArray,
    inverse_gain: float,
    flat_error: float,
    weigh: bool,
    weights: FloatArray,
    normal: FloatArray,
    right: FloatArray,
) -> float:
    """The sums of `sums` for a star alone, without an array in the loop."""
    first_x = interpolate(table.shape[0], oversampling, -x, weights, 0)
    first_y = interpolate(table.shape[0], oversampling, -y, weights, 1)
    chi2, rx, ry, rf, xx, xy, yy, xf, yf, ff = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(len(variances)):
        p, by_x, by_y = interpolated(table, oversampling, first_x + px[n], first_y + py[n], weights, 0)
        model, gx, gy = flux * p, -flux * by_x, -flux * by_y
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
