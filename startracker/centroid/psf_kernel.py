"""Kernels of the centroiders that know the star image: the joint fit of neighbours, weighted moments."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.cholesky import factorise, substitute
from startracker.centroid.psf_alone import (
    ACCEPTED_PX,
    CONVERGED_PX,
    FITTED,
    ITERATIONS,
    LARGEST_GROWTH,
    LONGEST_STEP_PX,
    WEIGHINGS,
    amplitude,
    fit_alone,
    note_star,
)
from startracker.centroid.psf_sums import fill, interpolate, interpolated, sums
from startracker.detection.plane import Plane
from startracker.detection.values import Image
from startracker.kernels import kernel

__all__ = ["FITTED", "MOST_TOGETHER", "fit_stars", "group_stars", "weighted_moments"]

FloatImage = NDArray[np.float32]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_TOGETHER = 8
"""Stars fitted jointly at most."""


@kernel
def group_stars(x: FloatArray, y: FloatArray, reach: FloatArray) -> IntArray:
    """Number of the group of each star: chains of stars nearer than `reach` of either, on both axes.

    A chain of more than `MOST_TOGETHER` is cut.
    """
    n = len(x)
    group = np.arange(n)
    members = np.ones(n, np.int64)
    for i in range(n):
        for j in range(i):
            near = max(reach[i], reach[j])
            if abs(x[i] - x[j]) <= near and abs(y[i] - y[j]) <= near and group[i] != group[j]:
                keep, drop = group[j], group[i]
                if members[keep] + members[drop] <= MOST_TOGETHER:
                    members[keep] += members[drop]
                    for k in range(n):
                        if group[k] == drop:
                            group[k] = keep
    return group


@kernel
def _without(
    px: IntArray,
    py: IntArray,
    signal: FloatArray,
    dark: FloatArray,
    start: int,
    end: int,
    image: Image,
    ceiling: float,
    cx: IntArray,
    cy: IntArray,
    half: IntArray,
    star: int,
) -> int:
    """Leave out of the pixels start … end those at the ceiling and those in an earlier star's window; the new end."""
    kept = start
    for n in range(start, end):
        usable = image[py[n], px[n]] < ceiling
        for other in range(star):
            if abs(px[n] - cx[other]) <= half[other] and abs(py[n] - cy[other]) <= half[other]:
                usable = False
        if usable:
            px[kept], py[kept], signal[kept], dark[kept] = px[n], py[n], signal[n], dark[n]
            kept += 1
    return kept


@kernel
def _fit_group(
    image: Image,
    level: Plane,
    noise: Plane,
    table: FloatArray,
    axes: FloatArray,
    oversampling: int,
    members: IntArray,
    xs: FloatArray,
    ys: FloatArray,
    halves: IntArray,
    ceilings: FloatArray,
    inverse_gain: float,
    flat_error: float,
    reweigh: bool,
    out: FloatArray,
) -> None:
    """Fit of the stars `members` together, written to their rows of `out`; rows stay NaN where it fails."""
    height, width = image.shape
    m = len(members)
    size = 3 * m
    x, y, flux = np.empty(m), np.empty(m), np.empty(m)
    cx, cy, half = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m, np.int64)
    pixels, lowest_ceiling = 0, np.inf
    low_x, high_x, low_y, high_y = image.shape[1], -1, image.shape[0], -1
    for k in range(m):
        x[k], y[k], half[k] = xs[members[k]], ys[members[k]], halves[members[k]]
        cx[k], cy[k] = round(x[k]), round(y[k])
        pixels += (2 * half[k] + 1) ** 2
        low_x, high_x = min(low_x, cx[k] - half[k]), max(high_x, cx[k] + half[k])
        low_y, high_y = min(low_y, cy[k] - half[k]), max(high_y, cy[k] + half[k])
        lowest_ceiling = min(lowest_ceiling, ceilings[members[k]])
    # the pixels' places, signal above the background and its variance; those of overlapping windows once
    px, py, signal, dark = np.empty(pixels, np.int64), np.empty(pixels, np.int64), np.empty(pixels), np.empty(pixels)
    extent = max(high_x - low_x, high_y - low_y) + 1
    shares, weights, lines = np.empty((m, 3, pixels)), np.empty((2, 8)), np.empty((4, extent))
    used = 0
    for k in range(m):
        end = used
        for j in range(max(cy[k] - half[k], 0), min(cy[k] + half[k] + 1, height)):
            for i in range(max(cx[k] - half[k], 0), min(cx[k] + half[k] + 1, width)):
                value = np.float64(image[j, i])
                if math.isfinite(value) and value < ceilings[members[k]]:
                    px[end], py[end] = i, j
                    signal[end], dark[end] = value - level[j, i], np.float64(noise[j, i]) ** 2
                    end += 1
        if end == used:
            return
        fill(table, axes, oversampling, x[k], y[k], px[used:end], py[used:end], low_x, low_y, shares[k], weights, lines)
        flux[k] = amplitude(shares[k, 0], signal[used:end], dark[used:end])
        if not flux[k] > 0.0:
            return
        used = _without(px, py, signal, dark, used, end, image, lowest_ceiling, cx, cy, half, k)
    if used <= size:
        return
    px, py, signal, dark = px[:used], py[:used], signal[:used], dark[:used]
    variances, gradient, score = np.empty(used), np.empty(size), np.empty(size)
    normal, right = np.zeros((size, size)), np.zeros(size)
    chi2, step = 0.0, 1.0
    for iteration in range(ITERATIONS):
        weigh = reweigh or iteration < WEIGHINGS
        for k in range(m):
            fill(table, axes, oversampling, x[k], y[k], px, py, low_x, low_y, shares[k], weights, lines)
        chi2 = sums(shares, flux, signal, dark, variances, inverse_gain, flat_error, weigh, gradient, normal, right)
        if not factorise(normal, size):
            return
        for a in range(size):
            score[a] = right[a]
        substitute(normal, size, right)
        longest, gain = 0.0, 0.0
        for a in range(size):
            gain += score[a] * right[a]
        for star in range(m):
            longest = max(longest, abs(right[3 * star]), abs(right[3 * star + 1]))
        if not math.isfinite(longest):
            return
        short = min(1.0, LONGEST_STEP_PX / longest) if longest > 0.0 else 1.0
        for star in range(m):
            x[star] += short * right[3 * star]
            y[star] += short * right[3 * star + 1]
            growth = 1.0 + short * right[3 * star + 2]
            flux[star] *= min(max(growth, 1.0 / LARGEST_GROWTH), LARGEST_GROWTH)
            if abs(x[star] - cx[star]) > half[star] or abs(y[star] - cy[star]) > half[star]:
                return
        step = longest
        if step < CONVERGED_PX:
            # what the last step gains is known; matrix and χ² are those of its start but for that
            chi2, step = chi2 - gain, 0.0
            break
    if step > ACCEPTED_PX:
        return
    column = np.empty(size)
    for star in range(m):
        note_star(out[members[star]], x[star], y[star], flux[star], chi2, used - size, normal, 3 * star, column)


def fit_stars(
    image: Image,
    level: Plane,
    noise: Plane,
    table: FloatArray,
    axes: FloatArray,
    oversampling: int,
    group: IntArray,
    xs: FloatArray,
    ys: FloatArray,
    halves: IntArray,
    ceilings: FloatArray,
    inverse_gain: float,
    flat_error: float,
    reweigh: bool,
) -> FloatArray:
    """Fits (N, 8), see `FITTED`, of stars whose approximate positions are given; NaN where a fit fails.

    Parameters
    ----------
    table, axes, oversampling
        Of a `startracker.centroid.psf_model.PsfModel`.
    group : int array, shape (N,)
        Stars of equal number, that of one of them, are fitted together over the union of their windows.
    xs, ys : array, shape (N,)
        Start.
    halves : int array, shape (N,)
        Half width of each window.
    ceilings : array, shape (N,)
        DN; pixels of that or more are left out.
    inverse_gain : float
        DN an electron.
    flat_error : float
        Relative standard deviation of the pixels' responses.
    reweigh : bool
        True: variances follow the model (Fisher scoring); False: they stay those of the model in the third step.

    Notes
    -----
    Parameters of a star: x, y and ln(flux), so that the normal matrix is well scaled.
    """
    out = np.full((len(xs), FITTED), np.nan)
    number = np.bincount(group, minlength=len(xs))
    fit_alone(
        image, level, noise, table, axes, oversampling, np.flatnonzero(number[group] == 1), xs, ys, halves, ceilings,
        inverse_gain, flat_error, reweigh, out,
    )  # fmt: skip
    for index in np.flatnonzero(number > 1):
        _fit_group(
            image, level, noise, table, axes, oversampling, np.flatnonzero(group == index), xs, ys, halves,
            ceilings, inverse_gain, flat_error, reweigh, out,
        )  # fmt: skip
    return out


@kernel
def weighted_moments(
    image: Image,
    level: FloatImage,
    noise: FloatImage,
    table: FloatArray,
    oversampling: int,
    shape: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    halves: IntArray,
    ceilings: FloatArray,
    inverse_gain: float,
    correct: bool,
) -> FloatArray:
    """Gaussian-weighted moments (N, 6): x, y, flux, var x, var y, cov xy; NaN where the iteration fails.

    Parameters
    ----------
    shape : array, shape (3,)
        Variances along x and y and covariance of the weight, px².
    correct : bool
        Take off the moment that the star image itself has at the position.

    Notes
    -----
    Solves Σ w (k − c)(d − F p) = 0 by Newton's method, w centred on c. The noise of the solution is that of the sum,
    through the inverse of the sum's derivative by the star's position: exact for fixed w.
    """
    height, width = image.shape
    determinant = shape[0] * shape[1] - shape[2] ** 2
    ixx, iyy, ixy = shape[1] / determinant, shape[0] / determinant, -shape[2] / determinant
    out = np.full((len(xs), 6), np.nan)
    for index in range(len(xs)):
        x, y, half, ceiling = xs[index], ys[index], halves[index], ceilings[index]
        cx, cy = round(x), round(y)
        move = 1.0
        weights = np.empty((2, 8))
        for _ in range(4 * ITERATIONS):
            first_x = interpolate(table.shape[0], oversampling, -x, weights, 0)
            first_y = interpolate(table.shape[0], oversampling, -y, weights, 1)
            wd, wp, dx1, dy1, px1, py1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            jxx, jxy, jyx, jyy = 0.0, 0.0, 0.0, 0.0
            vxx, vyy, vxy = 0.0, 0.0, 0.0
            for j in range(max(cy - half, 0), min(cy + half + 1, height)):
                for i in range(max(cx - half, 0), min(cx + half + 1, width)):
                    value = np.float64(image[j, i])
                    if not (math.isfinite(value) and value < ceiling):
                        continue
                    kx, ky = i - x, j - y
                    w = math.exp(-0.5 * (ixx * kx * kx + iyy * ky * ky + 2.0 * ixy * kx * ky))
                    point_x, point_y = first_x + i * oversampling, first_y + j * oversampling
                    p, by_x, by_y = interpolated(table, oversampling, point_x, point_y, weights, 0)
                    d = value - level[j, i]
                    v = np.float64(noise[j, i]) ** 2 + max(d, 0.0) * inverse_gain
                    wd, wp = wd + w * d, wp + w * p
                    dx1, dy1, px1, py1 = dx1 + w * kx * d, dy1 + w * ky * d, px1 + w * kx * p, py1 + w * ky * p
                    jxx, jxy = jxx - w * kx * by_x, jxy - w * kx * by_y
                    jyx, jyy = jyx - w * ky * by_x, jyy - w * ky * by_y
                    vxx, vyy, vxy = vxx + (w * kx) ** 2 * v, vyy + (w * ky) ** 2 * v, vxy + w * w * kx * ky * v
            flux = wd / wp
            cross = jxx * jyy - jxy * jyx
            if not (flux > 0.0 and math.isfinite(flux) and cross > 0.0):
                move = np.inf
                break
            sx, sy = (dx1 - flux * px1, dy1 - flux * py1) if correct else (dx1, dy1)
            if move < CONVERGED_PX:
                break
            step_x = (jyy * sx - jxy * sy) / (cross * flux)
            step_y = (jxx * sy - jyx * sx) / (cross * flux)
            move = max(abs(step_x), abs(step_y))
            short = min(1.0, LONGEST_STEP_PX / move) if move > 0.0 else 1.0
            x, y = x + short * step_x, y + short * step_y
            if not (abs(x - cx) <= half and abs(y - cy) <= half):
                move = np.inf
                break
        if not move < ACCEPTED_PX:
            continue
        scale = 1.0 / (cross * flux) ** 2
        out[index, 0], out[index, 1], out[index, 2] = x, y, flux
        out[index, 3] = scale * (jyy * jyy * vxx - 2.0 * jyy * jxy * vxy + jxy * jxy * vyy)
        out[index, 4] = scale * (jyx * jyx * vxx - 2.0 * jyx * jxx * vxy + jxx * jxx * vyy)
        out[index, 5] = scale * ((jyy * jxx + jxy * jyx) * vxy - jyy * jyx * vxx - jxy * jxx * vyy)
    return out
