"""Kernels of a fit's inner loop: interpolation of the star image in pixels, and the sums over them."""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel, kernel_part, kernel_with
from startracker.centroid.psf_model import Samples
from startracker.core import FloatArray


@kernel
def interpolate(size: int, oversampling: int, distance: float, weights: FloatArray, row: int) -> int:
    """Index of the table's point before a pixel at `distance` from the star, and the interpolation weights.

    A row of `weights` receives the weights of the four points around the pixel, and those of the derivative with
    respect to the index. The next pixel adds `oversampling` to the index, and has the same weights.
    """
    position = distance * oversampling + (size - 1) // 2
    first = math.floor(position)
    t = position - first
    # Keys' cubic with a = −½ in Horner's form, then its derivative by t.
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

    (i, j) is the table's point before it; the weights of x are in row `row` of `weights`, those of y in the next. Zero
    outside the table.
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
    """Light of a star in all pixels of a window, row by row, and its derivatives by dx and dy, into `out` (3, N).

    The first pixel is at (dx, dy) from the star. If the table is a sum of products, its factors are interpolated and
    the table is not used. `lines` (6, L) is working space, with L at least 8, `wide` and `high`.
    """
    table, axes, oversampling, weights = psf.table, psf.axes, psf.oversampling, lines[4:]
    size = axes.shape[1] if len(axes) else table.shape[0]
    first_x = interpolate(size, oversampling, dx, weights, np.int64(0))
    first_y = interpolate(size, oversampling, dy, weights, np.int64(1))
    # numba tests signed indices for negative values, which prevents vectorisation; `n` is therefore unsigned.
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
        for axis in range(2):
            first, count = (first_y, high) if axis else (first_x, wide)
            _along(axes[term + axis], oversampling, first, count, weights[axis], lines[2 * axis], lines[2 * axis + 1])
        n = np.uint64(0)
        for j in range(high):
            s, t = share_y[j], slope_y[j]
            for i in range(wide):
                p, px, py = share_x[i] * s, slope_x[i] * s, share_x[i] * t
                # `out` is not initialised, so the first product is stored and the others are added.
                if term == 0:
                    share[n], by_x[n], by_y[n] = p, px, py
                else:
                    share[n], by_x[n], by_y[n] = share[n] + p, by_x[n] + px, by_y[n] + py
                n += np.uint64(1)


@kernel_part
def _along(
    axis: FloatArray,
    oversampling: int,
    first: int,
    count: int,
    weights: FloatArray,
    value: FloatArray,
    slope: FloatArray,
) -> None:
    """Values and derivatives of one factor at `count` successive pixels from the point `first` on; zero outside."""
    for k in range(count):
        i = first + k * oversampling
        value[k], slope[k] = 0.0, 0.0
        if 1 <= i <= len(axis) - 3:
            p0, p1, p2, p3 = axis[i - 1], axis[i], axis[i + 1], axis[i + 2]
            value[k] = weights[0] * p0 + weights[1] * p1 + weights[2] * p2 + weights[3] * p3
            slope[k] = oversampling * (weights[4] * p0 + weights[5] * p1 + weights[6] * p2 + weights[7] * p3)


# With sums in the order of the pixels each addition waits for the one before; "reassoc" allows vectorisation, which is
# five times as fast.
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
    """χ² of the model of M stars in N pixels; turns `shares` into the derivatives of the model.

    The derivatives are those with respect to ln(flux), x and y of each star.

    Parameters
    ----------
    shares : (3 M, N)
        Light of each star of flux 1, and its derivatives by dx and dy, see `fill_window`.
    flux : (M,)
    signal, dark : (N,)
        Signal above the background, DN, and its variance in the dark, DN².
    noise : (float, float)
        DN per electron, and relative error of the flat field.
    weigh : bool
        Whether to compute the variances; otherwise those in `rows` are used.
    rows : (3, N)
        Receives weights, residuals and variances.
    """
    weights, residuals, variances = rows[0], rows[1], rows[2]
    for star in range(len(flux)):
        light, by_x, by_y, f = shares[3 * star], shares[3 * star + 1], shares[3 * star + 2], flux[star]
        before = residuals if star else signal
        for n in range(len(signal)):
            # dx and dy are measured from the star to the pixel, hence the opposite sign for the position of the star.
            light[n], by_x[n], by_y[n] = f * light[n], -f * by_x[n], -f * by_y[n]
            residuals[n] = before[n] - light[n]
    inverse_gain, flat_error, chi2 = noise[0], noise[1], 0.0
    for n in range(len(signal)):
        if weigh:
            model = max(signal[n] - residuals[n], 0.0)
            variances[n] = dark[n] + model * inverse_gain + (flat_error * model) ** 2
        weights[n] = 1.0 / variances[n]
        chi2 += weights[n] * residuals[n] * residuals[n]
    return chi2


@kernel_with(fastmath={"reassoc"})
def normal_equations(
    slopes: FloatArray, weights: FloatArray, residuals: FloatArray, normal: FloatArray, right: FloatArray
) -> None:
    """Normal matrix (lower half) and right side of weighted pixels whose model has the derivatives `slopes` (3 K, N).

    The order of summation is free. Three parameters are processed at a time, so that a pixel is read once for nine
    products.
    """
    for a in range(0, len(right), 3):
        f, x, y = slopes[a], slopes[a + 1], slopes[a + 2]
        rf, rx, ry, ff, xf, xx, yf, yx, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for n in range(len(weights)):
            wf, wx, wy = weights[n] * f[n], weights[n] * x[n], weights[n] * y[n]
            rf, rx, ry = rf + wf * residuals[n], rx + wx * residuals[n], ry + wy * residuals[n]
            ff, xf, xx = ff + wf * f[n], xf + wx * f[n], xx + wx * x[n]
            yf, yx, yy = yf + wy * f[n], yx + wy * x[n], yy + wy * y[n]
        right[a], right[a + 1], right[a + 2] = rf, rx, ry
        normal[a, a], normal[a + 1, a], normal[a + 1, a + 1] = ff, xf, xx
        normal[a + 2, a], normal[a + 2, a + 1], normal[a + 2, a + 2] = yf, yx, yy
        for b in range(0, a, 3):
            g, u, v = slopes[b], slopes[b + 1], slopes[b + 2]
            fg, fu, fv, xg, xu, xv, yg, yu, yv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for n in range(len(weights)):
                wf, wx, wy = weights[n] * f[n], weights[n] * x[n], weights[n] * y[n]
                fg, fu, fv = fg + wf * g[n], fu + wf * u[n], fv + wf * v[n]
                xg, xu, xv = xg + wx * g[n], xu + wx * u[n], xv + wx * v[n]
                yg, yu, yv = yg + wy * g[n], yu + wy * u[n], yv + wy * v[n]
            normal[a, b], normal[a, b + 1], normal[a, b + 2] = fg, fu, fv
            normal[a + 1, b], normal[a + 1, b + 1], normal[a + 1, b + 2] = xg, xu, xv
            normal[a + 2, b], normal[a + 2, b + 1], normal[a + 2, b + 2] = yg, yu, yv
