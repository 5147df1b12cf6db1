"""Kernels of the centroiders that use the star image: joint fits of neighbours, and weighted moments."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.centroid.psf_model import Samples
from startracker.centroid.psf_sums import fill_window, interpolate, interpolated, normal_equations, weigh_pixels
from startracker.centroid.window import Pixels, read_pixels
from startracker.core import FloatArray, IntArray
from startracker.geometry.linalg import factorise, substitute

Box: TypeAlias = tuple[int, int, int, int]
Two: TypeAlias = tuple[float, float]
Three: TypeAlias = tuple[float, float, float]
Four: TypeAlias = tuple[float, float, float, float]

FITTED = 9
"""Number of columns of a fit: x, y, flux, var x, var y, cov xy, χ², degrees of freedom, and χ² of a single bright pixel
in place of the star (NaN for stars fitted together)."""
MOST_TOGETHER = 8
"""Largest number of stars that are fitted jointly."""
_ITERATIONS = 25
_LONGEST_STEP_PX = 0.5
_CONVERGED_PX = 2e-4
"""Largest last step, px; each step is a tenth of the one before or less, so that the next would be below 2e-5."""
_CONVERGED_SIGMA = 0.02
"""Largest last step in standard errors if it is also below `_ACCEPTED_PX`; the next would be below 0.002 standard
errors and 1e-4 px."""
_ACCEPTED_PX = 1e-3
_WEIGHINGS = 3
_LARGEST_GROWTH = 2.0


class Starts(NamedTuple):
    """Approximate positions and windows of the stars of a fit.

    Parameters
    ----------
    x, y : (N,)
        Approximate positions.
    half : int (N,)
        Half width of each window.
    ceiling : (N,)
        DN; pixels at or above it are excluded.
    """

    x: FloatArray
    y: FloatArray
    half: IntArray
    ceiling: FloatArray


def group_stars(x: FloatArray, y: FloatArray, reach: IntArray) -> IntArray:
    """Group number (N,) of each star: chains of stars that are nearer than the `reach` of either on both axes.

    A chain of more than `MOST_TOGETHER` stars is cut.
    """
    group = np.arange(len(x))
    _join(x, y, reach, group, np.ones(len(x), np.int64))
    return group


@kernel
def _join(x: FloatArray, y: FloatArray, reach: IntArray, group: IntArray, members: IntArray) -> None:
    """Merge the groups of `group_stars`, each of which initially has one star."""
    for i in range(len(x)):
        for j in range(i):
            near = max(reach[i], reach[j])
            if abs(x[i] - x[j]) <= near and abs(y[i] - y[j]) <= near and group[i] != group[j]:
                keep, drop = group[j], group[i]
                if members[keep] + members[drop] <= MOST_TOGETHER:
                    members[keep] += members[drop]
                    for k in range(len(x)):
                        if group[k] == drop:
                            group[k] = keep


def fit_stars(pixels: Pixels, psf: Samples, starts: Starts, group: IntArray, reweigh: bool) -> FloatArray:
    """Fits (N, 9), see `FITTED`, of stars whose approximate positions are given.

    All columns are NaN if a fit fails, except the last two for a star that is fitted alone.

    Parameters
    ----------
    group : int array, shape (N,)
        Stars with the same number, which is the index of one of them, are fitted together over all their windows.
    reweigh : bool
        True: variances follow the model (Fisher scoring); False: they stay as computed in the third step.
    """
    out = np.full((len(group), FITTED), np.nan)
    _fit_groups(pixels, psf, starts, group, np.argsort(group, kind="stable"), reweigh, _NO_SPACE, out)
    return out


class _Space(NamedTuple):
    """Working space for a fit of M stars in N pixels: (11 + 3 M, N), (3 M, 3 M), (2, 3 M) and (3, M)."""

    pixels: FloatArray
    normal: FloatArray
    sides: FloatArray
    at: FloatArray


_NO_SPACE = _Space(*[np.empty((0, 0))] * 4)


@kernel
def _fit_groups(
    pixels: Pixels, psf: Samples, starts: Starts, group: IntArray, order: IntArray, reweigh: bool, space: _Space,
    out: FloatArray,
) -> None:  # fmt: skip
    """Fill the rows of `fit_stars`; `order` lists the stars group by group. The working space grows as needed."""
    first = 0
    while first < len(order):
        last = first + 1
        while last < len(order) and group[order[last]] == group[order[first]]:
            last += 1
        members, size = order[first:last], 3 * (last - first)
        box = _bounds(starts, members, pixels.image.shape)
        count = max(box[2] * box[3], 8)
        if len(space.normal) < size or space.pixels.shape[1] < count:
            normal, at = np.empty((size, size)), np.empty((3, last - first))
            space = _Space(np.empty((11 + size, count)), normal, np.empty((2, size)), at)
        _fit_group(pixels, psf, starts, members, box, reweigh, space, out)
        first = last


@kernel_part
def _bounds(starts: Starts, members: IntArray, shape: tuple[int, int]) -> Box:
    """First column and row, and numbers of columns and rows, of the rectangle that encloses all windows of a group."""
    height, width = shape
    left, top, right, bottom = width, height, 0, 0
    for k in members:
        x, y, half = round(starts.x[k]), round(starts.y[k]), starts.half[k]
        left, right = min(left, max(x - half, 0)), max(right, min(x + half + 1, width))
        top, bottom = min(top, max(y - half, 0)), max(bottom, min(y + half + 1, height))
    return left, top, right - left, bottom - top


@kernel_part
def _leave_out(
    starts: Starts, members: IntArray, left: int, top: int, wide: int, signal: FloatArray, dark: FloatArray
) -> int:
    """Exclude the pixels of the rectangle that lie in no window; returns the number of pixels left."""
    count = 0
    for n in range(len(signal)):
        inside = False
        for k in members:
            away = max(abs(left + n % wide - round(starts.x[k])), abs(top + n // wide - round(starts.y[k])))
            inside = inside or away <= starts.half[k]
        if not inside:
            signal[n], dark[n] = 0.0, np.inf
        count += int(dark[n] < np.inf)
    return count


@kernel_part
def _amplitude(share: FloatArray, signal: FloatArray, dark: FloatArray) -> float:
    """Flux by unweighted least squares, Σ p d / Σ p², over the pixels with a finite variance."""
    above, below = 0.0, 0.0
    for n in range(len(signal)):
        p = share[n] if dark[n] < np.inf else 0.0
        above += p * signal[n]
        below += p * p
    return above / below if below > 0.0 else np.nan


@kernel
def _fit_group(
    pixels: Pixels,
    psf: Samples,
    starts: Starts,
    members: IntArray,
    box: Box,
    reweigh: bool,
    space: _Space,
    out: FloatArray,
) -> None:
    """Fit the stars of a group together and write their rows of `out`, which stay NaN if the fit fails.

    The parameters of each star are ln(flux), x and y, which makes the normal matrix well scaled.
    """
    m, size, ceiling = len(members), 3 * len(members), np.inf
    for k in members:
        ceiling = min(ceiling, starts.ceiling[k])
    (left, top, wide, high), count, noise = box, box[2] * box[3], (pixels.inverse_gain, pixels.flat_error)
    signal, dark, rows = space.pixels[0, :count], space.pixels[1, :count], space.pixels[2:5]
    weights, residuals, lines, slopes = rows[0, :count], rows[1], space.pixels[5:11], space.pixels[11:]
    normal, right, score = space.normal, space.sides[0, :size], space.sides[1]
    x, y, flux = space.at[0], space.at[1], space.at[2]
    used = read_pixels(pixels, left, top, wide, high, ceiling, signal, dark)
    if m > 1:
        used = _leave_out(starts, members, left, top, wide, signal, dark)
    if used <= size:
        return
    if m == 1:
        out[members[0], 7], out[members[0], 8] = used - size, _pixel_chi2(signal, dark)
    for k in range(m):
        x[k], y[k] = starts.x[members[k]], starts.y[members[k]]
    chi2, step = 0.0, 1.0
    for iteration in range(_ITERATIONS):
        for k in range(m):
            fill_window(psf, left - x[k], top - y[k], wide, high, slopes[3 * k : 3 * k + 3], lines)
            if iteration == 0:
                flux[k] = _amplitude(slopes[3 * k], signal, dark)
                if not flux[k] > 0.0:
                    return
        chi2 = weigh_pixels(slopes, flux[:m], signal, dark, noise, reweigh or iteration < _WEIGHINGS, rows)
        normal_equations(slopes, weights, residuals, normal, right)
        if not factorise(normal, size):
            return
        for a in range(size):
            score[a] = right[a]
        substitute(normal, size, right)
        step = _move(right, x[:m], y, flux)
        gain = 0.0
        for a in range(size):
            gain += score[a] * right[a]
        # A star that leaves its own window has been attracted by something else.
        for k in range(m):
            half = starts.half[members[k]]
            if abs(x[k] - round(starts.x[members[k]])) > half or abs(y[k] - round(starts.y[members[k]])) > half:
                return
        enough = (reweigh or iteration > _WEIGHINGS) and step < _ACCEPTED_PX and gain < _CONVERGED_SIGMA**2
        if step < _CONVERGED_PX or enough:
            # The gain of the last step is known in advance, so its result need not be evaluated again.
            chi2, step = chi2 - gain, 0.0
            break
    if step <= _ACCEPTED_PX:
        _note(members, space, chi2, used - size, out)


@kernel_part
def _pixel_chi2(signal: FloatArray, dark: FloatArray) -> float:
    """χ² of a window under the hypothesis that only one pixel is bright."""
    total, brightest = 0.0, 0.0
    for n in range(len(signal)):
        square = signal[n] * signal[n] / dark[n]  # 0 for a pixel left out
        total += square
        if signal[n] > 0.0:
            brightest = max(brightest, square)
    return total - brightest


@kernel_part
def _note(members: IntArray, space: _Space, chi2: float, freedom: int, out: FloatArray) -> None:
    """Write the rows of a fit, see `FITTED`, from its factorised normal matrix."""
    size, column = 3 * len(members), space.sides[0]
    for k in range(len(members)):
        row = out[members[k]]
        row[0], row[1], row[2], row[6], row[7] = space.at[0, k], space.at[1, k], space.at[2, k], chi2, freedom
        # The columns of the inverse for x and y are the marginal covariances, with flux and neighbours eliminated.
        for axis in range(2):
            for a in range(size):
                column[a] = 1.0 if a == 3 * k + 1 + axis else 0.0
            substitute(space.normal, size, column)
            row[3 + axis], row[5] = column[3 * k + 1 + axis], column[3 * k + 1]


@kernel
def _move(change: FloatArray, x: FloatArray, y: FloatArray, flux: FloatArray) -> float:
    """Apply a step, shortened if it is too long; returns its full length, px, or infinity if it is not finite."""
    longest = 0.0
    for k in range(len(x)):
        for move in (change[3 * k + 1], change[3 * k + 2]):
            longest = max(longest, abs(move)) if math.isfinite(move) else np.inf
    if longest == np.inf:
        x[:] = np.inf
        return longest
    short = min(1.0, _LONGEST_STEP_PX / longest) if longest > 0.0 else 1.0
    for k in range(len(x)):
        flux[k] *= min(max(1.0 + short * change[3 * k], 1.0 / _LARGEST_GROWTH), _LARGEST_GROWTH)
        x[k] += short * change[3 * k + 1]
        y[k] += short * change[3 * k + 2]
    return longest


@kernel
def weighted_moments(
    pixels: Pixels, psf: Samples, starts: Starts, shape: tuple[float, float, float], correct: bool
) -> FloatArray:
    """Gaussian-weighted moments (N, 6): x, y, flux, var x, var y, cov xy; NaN if the iteration fails.

    Parameters
    ----------
    psf : Samples
        Only its table is used.
    shape : (float, float, float)
        Variances along x and y and covariance of the weight, px².
    correct : bool
        Whether to subtract the moment that the star image itself has at the position.

    Notes
    -----
    Solves Σ w (k − c)(d − F p) = 0 by Newton's method, with w centred on c. The noise of the solution is the noise of
    the sum, propagated through the inverse of the sum's derivative with respect to the star's position: exact for fixed
    w.
    """
    out = np.full((len(starts.x), 6), np.nan)
    for index in range(len(out)):
        x, y, half = starts.x[index], starts.y[index], starts.half[index]
        cx, cy, move = round(x), round(y), 1.0
        for _ in range(4 * _ITERATIONS):
            light, moments, slopes, noise = _weighted_sums(pixels, psf, starts, index, (x, y), shape)
            (wd, wp), (dx1, dy1, px1, py1), (jxx, jxy, jyx, jyy), (vxx, vyy, vxy) = light, moments, slopes, noise
            flux = wd / wp
            cross = jxx * jyy - jxy * jyx
            if not (flux > 0.0 and math.isfinite(flux) and cross > 0.0):
                move = np.inf
                break
            sx, sy = (dx1 - flux * px1, dy1 - flux * py1) if correct else (dx1, dy1)
            if move < _CONVERGED_PX:
                break
            step_x, step_y = (jyy * sx - jxy * sy) / (cross * flux), (jxx * sy - jyx * sx) / (cross * flux)
            move = max(abs(step_x), abs(step_y))
            short = min(1.0, _LONGEST_STEP_PX / move) if move > 0.0 else 1.0
            x, y = x + short * step_x, y + short * step_y
            if not (abs(x - cx) <= half and abs(y - cy) <= half):
                move = np.inf
                break
        if not move < _ACCEPTED_PX:
            continue
        scale = 1.0 / (cross * flux) ** 2
        out[index, 0], out[index, 1], out[index, 2] = x, y, flux
        out[index, 3] = scale * (jyy * jyy * vxx - 2.0 * jyy * jxy * vxy + jxy * jxy * vyy)
        out[index, 4] = scale * (jyx * jyx * vxx - 2.0 * jyx * jxx * vxy + jxx * jxx * vyy)
        out[index, 5] = scale * ((jyy * jxx + jxy * jyx) * vxy - jyy * jyx * vxx - jxy * jxx * vyy)
    return out


@kernel
def _weighted_sums(
    pixels: Pixels, psf: Samples, starts: Starts, index: int, at: tuple[float, float], shape: tuple[float, float, float]
) -> tuple[Two, Four, Four, Three]:
    """Sums over a window under the weight centred on a position.

    Four tuples: of the light d and the star image p; of their moments; of the derivatives of p's moments with respect
    to the position; of the noise of the moments.
    """
    determinant = shape[0] * shape[1] - shape[2] ** 2
    ixx, iyy, ixy = shape[1] / determinant, shape[0] / determinant, -shape[2] / determinant
    cx, cy, half = round(starts.x[index]), round(starts.y[index]), starts.half[index]
    height, width = pixels.image.shape
    weights = np.empty((2, 8))
    first_x = interpolate(psf.table.shape[0], psf.oversampling, -at[0], weights, 0)
    first_y = interpolate(psf.table.shape[0], psf.oversampling, -at[1], weights, 1)
    wd, wp, dx1, dy1, px1, py1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    jxx, jxy, jyx, jyy, vxx, vyy, vxy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(max(cy - half, 0), min(cy + half + 1, height)):
        for i in range(max(cx - half, 0), min(cx + half + 1, width)):
            value = np.float64(pixels.image[j, i])
            if not (math.isfinite(value) and value < starts.ceiling[index]):
                continue
            kx, ky = i - at[0], j - at[1]
            # The exponent is the inverse of the covariance matrix of the weight.
            w = math.exp(-0.5 * (ixx * kx * kx + iyy * ky * ky + 2.0 * ixy * kx * ky))
            point_x, point_y = first_x + i * psf.oversampling, first_y + j * psf.oversampling
            p, by_x, by_y = interpolated(psf.table, psf.oversampling, point_x, point_y, weights, 0)
            d = value - float(pixels.level[j, i])
            v = np.float64(pixels.noise[j, i]) ** 2 + max(d, 0.0) * pixels.inverse_gain
            wx, wy, wd, wp = w * kx, w * ky, wd + w * d, wp + w * p
            dx1, dy1, px1, py1 = dx1 + wx * d, dy1 + wy * d, px1 + wx * p, py1 + wy * p
            jxx, jxy, jyx, jyy = jxx - wx * by_x, jxy - wx * by_y, jyx - wy * by_x, jyy - wy * by_y
            vxx, vyy, vxy = vxx + wx * wx * v, vyy + wy * wy * v, vxy + wx * wy * v
    return (wd, wp), (dx1, dy1, px1, py1), (jxx, jxy, jyx, jyy), (vxx, vyy, vxy)
