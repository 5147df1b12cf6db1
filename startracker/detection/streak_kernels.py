"""Kernels of the search for streaks: sums along lines, and the fit of a line convolved with a star image."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["best_lines", "bin_residual", "fit_streak", "keep_apart", "line_response", "subtract_streak"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_ROOT_TWO_PI = math.sqrt(2.0 * math.pi)
_ACROSS_SIGMAS = 3.5
_BEYOND_SIGMAS = 5.0
_OUTLIER = 5.0
_FAR = 6.0
X, Y, FLUX, ANGLE, HALF, SIGMA, SKY = range(7)


@njit(cache=True, error_model="numpy")
def bin_residual(image: FloatImage, level: FloatImage, noise: FloatImage, side: int) -> FloatImage:
    """(image − level) / noise summed over squares, divided by `side`: white noise keeps standard deviation 1.

    Pixels that are not finite count as background; rows and columns that fill no square are left out.
    """
    height, width = image.shape[0] // side, image.shape[1] // side
    out = np.zeros((height, width), np.float32)
    scale = np.float32(1.0 / side)
    for y in range(height):
        line = out[y]
        for j in range(side):
            row, sky, sigma = image[y * side + j], level[y * side + j], noise[y * side + j]
            for x in range(width):
                for i in range(side):
                    column = x * side + i
                    if abs(row[column]) < np.inf:
                        line[x] += scale * (row[column] - sky[column]) / sigma[column]
    return out


@njit(cache=True, error_model="numpy")
def best_lines(
    bins: FloatImage, slopes: FloatArray, every: NDArray[np.int64], spans: NDArray[np.int64]
) -> tuple[FloatImage, NDArray[np.int32]]:
    """Largest significance of the lines centred on each bin, and which line it is.

    A line has one bin a column. Sums over it are differences of running sums along the sheared rows (Brady 1998), so
    that all lengths of a slope cost as much as one.

    Parameters
    ----------
    bins : (W, H)
        Noise of standard deviation 1; column by column, so that neighbours in memory share a sum's place in the line.
    slopes : (K,)
        Rows a column.
    every : (M,)
        Length m is tried with every that-many-th slope: short lines need few.
    spans : (K, M)
        Columns of each line.

    Returns
    -------
    best : (W, H)
        Sum over the line / √bins, at least 0; beyond the upper and lower border there is nothing to be summed.
    line : (W, H)
        Slope number × M + length number.
    """
    width, height = bins.shape
    best = np.zeros((width, height), np.float32)
    line = np.zeros((width, height), np.int32)
    offset = np.empty(width, np.int64)
    lengths = spans.shape[1]
    tallest = height + 2 * (int(np.ceil(0.5 * width * np.abs(slopes).max())) + 1)
    running = np.zeros((width + 1, tallest), np.float32)
    for k in range(len(slopes)):
        for x in range(width):
            offset[x] = int(np.floor(slopes[k] * (x - 0.5 * width) + 0.5))
        low, high = offset.min(), offset.max()
        rows = height + high - low
        for x in range(width):
            # rows of the sheared image that this column has
            first = high - offset[x]
            last = first + height
            before, after, column = running[x], running[x + 1], bins[x]
            after[:first] = before[:first]
            after[last:rows] = before[last:rows]
            old, new = before[first:last], after[first:last]
            for y in range(height):
                new[y] = old[y] + column[y]
        for m in range(lengths):
            if k % every[m] != 0:
                continue
            span = spans[k, m]
            scale = np.float32(1.0 / np.sqrt(span))
            code = np.int32(k * lengths + m)
            for x in range(width - span + 1):
                middle = x + span // 2
                first = high - offset[middle]
                end, begin = running[x + span, first : first + height], running[x, first : first + height]
                most, which = best[middle], line[middle]
                for y in range(height):
                    value = (end[y] - begin[y]) * scale
                    better = value > most[y]
                    most[y] = value if better else most[y]
                    which[y] = code if better else which[y]
    return best, line


@njit(cache=True, error_model="numpy")
def keep_apart(bins: FloatImage, lines: FloatArray, width: float, threshold: float, most: int) -> NDArray[np.int64]:
    """Lines, taken in order, that stand out of what those before them leave.

    Parameters
    ----------
    bins : (H, W)
        Noise of standard deviation 1.
    lines : (N, 4)
        Centre x and y, half length along x and y, bins; most significant first.
    width : float
        Bins this near to a line taken belong to it.
    threshold : float
        Least sum over the free bins / √(all bins).
    most : int
        Lines wanted.
    """
    height, columns = bins.shape
    free = np.ones((height, columns), np.bool_)
    kept = np.empty(min(most, len(lines)), np.int64)
    count = 0
    reach = int(np.ceil(width))
    for n in range(len(lines)):
        if count == len(kept):
            break
        x, y, u, v = lines[n]
        steps = int(np.ceil(max(abs(u), abs(v))))
        total = 0.0
        for k in range(-steps, steps + 1):
            i, j = int(np.rint(x + u * k / steps)), int(np.rint(y + v * k / steps))
            if 0 <= i < columns and 0 <= j < height and free[j, i]:
                total += bins[j, i]
        if total < threshold * np.sqrt(2 * steps + 1.0):
            continue
        kept[count] = n
        count += 1
        for k in range(-steps - reach, steps + reach + 1):
            i, j = int(np.rint(x + u * k / steps)), int(np.rint(y + v * k / steps))
            for q in range(max(0, j - reach), min(height, j + reach + 1)):
                for p in range(max(0, i - reach), min(columns, i + reach + 1)):
                    free[q, p] = False
    return kept[:count]


@njit(cache=True, error_model="numpy")
def line_response(bins: FloatImage, motion: FloatArray, scale: float, middle_x: float, middle_y: float) -> FloatImage:
    """Sum / √bins along the streak that a motion draws about each bin; zero where that leaves the image.

    Parameters
    ----------
    bins : (H, W)
        Clipped, smoothed residual.
    motion : (3,)
        (a, b, c) of `startracker.detection.smear`, pixels.
    scale : float
        Pixels a bin.
    middle_x, middle_y : float
        The motion's origin in bins.
    """
    height, width = bins.shape
    out = np.zeros((height, width), np.float32)
    a, b, c = motion[0] / scale, motion[1] / scale, motion[2]
    for y in range(height):
        for x in range(width):
            u, v = 0.5 * (a - c * (y - middle_y)), 0.5 * (b + c * (x - middle_x))
            if not (abs(u) <= x <= width - 1 - abs(u) and abs(v) <= y <= height - 1 - abs(v)):
                continue
            steps = int(np.ceil(max(abs(u), abs(v))))
            total = np.float32(0.0)
            du, dv = np.float32(u / max(steps, 1)), np.float32(v / max(steps, 1))
            i, j = np.float32(x - u + 0.5), np.float32(y - v + 0.5)
            for _ in range(2 * steps + 1):
                total += bins[min(int(j), height - 1), min(int(i), width - 1)]
                i += du
                j += dv
            out[y, x] = total / np.sqrt(np.float32(2 * steps + 1))
    return out


@njit(cache=True, error_model="numpy")
def _edge(z: float) -> float:
    return 0.5 * math.erfc(-z * 0.7071067811865476)


@njit(cache=True, error_model="numpy")
def _model(p: FloatArray, x: int, y: int, slope: FloatArray) -> float:
    """Light in a pixel of a line convolved with a round Gaussian; its derivatives by all parameters into `slope`.

    F / 2h · [Φ((s + h) / σ) − Φ((s − h) / σ)] · exp(−t² / 2σ²) / (σ √2π) + sky, with s along and t across the line.
    """
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    dx, dy = x - p[X], y - p[Y]
    s, t = dx * cos + dy * sin, dy * cos - dx * sin
    half, sigma = p[HALF], p[SIGMA]
    front, back = (s + half) / sigma, (s - half) / sigma
    across = math.exp(-0.5 * (t / sigma) ** 2) / (sigma * _ROOT_TWO_PI)
    unit = across / (2.0 * half)
    along, first, last = 1.0, 0.0, 0.0
    if front < _FAR or back > -_FAR:  # most pixels of a long streak are far from its ends
        along = _edge(front) - _edge(back)
        first, last = math.exp(-0.5 * front**2) / _ROOT_TWO_PI, math.exp(-0.5 * back**2) / _ROOT_TWO_PI
    share = unit * along
    by_s = p[FLUX] * unit * (first - last) / sigma
    by_t = -p[FLUX] * share * t / sigma**2
    slope[X] = -by_s * cos + by_t * sin
    slope[Y] = -by_s * sin - by_t * cos
    slope[FLUX] = share
    slope[ANGLE] = by_s * t - by_t * s
    slope[HALF] = p[FLUX] * (unit * (first + last) / sigma - share / half)
    slope[SIGMA] = p[FLUX] * (unit * (back * last - front * first) / sigma + share * ((t / sigma) ** 2 - 1.0) / sigma)
    slope[SKY] = 1.0
    return float(p[FLUX] * share + p[SKY])


@njit(cache=True, error_model="numpy")
def _window(
    image: FloatImage, saturated: NDArray[np.bool_], start: FloatArray, slack: float
) -> tuple[NDArray[np.int64], int]:
    """Pixels (x, y) of a slanted window about a streak that can be used, and how many they are."""
    height, width = image.shape
    beyond = start[HALF] + _BEYOND_SIGMAS * start[SIGMA] + slack
    beside = _ACROSS_SIGMAS * start[SIGMA] + 1.0 + min(slack, 2.0)
    cos, sin = math.cos(start[ANGLE]), math.sin(start[ANGLE])
    high = beyond * abs(sin) + beside * abs(cos)
    top, bottom = max(0, int(start[Y] - high)), min(height, int(start[Y] + high) + 2)
    places = np.empty((int(4.0 * (beyond + 2.0) * (beside + 2.0)) + 8 * (bottom - top) + 16, 2), np.int64)
    count = 0
    for y in range(top, bottom):
        # where a row crosses the window: |s| and |t| within their limits
        dy = y - start[Y]
        left, right = start[X] - 2.0 * (beyond + beside), start[X] + 2.0 * (beyond + beside)
        if abs(cos) > 1e-6:
            middle, reach = start[X] - dy * sin / cos, beyond / abs(cos)
            left, right = max(left, middle - reach), min(right, middle + reach)
        if abs(sin) > 1e-6:
            middle, reach = start[X] + dy * cos / sin, beside / abs(sin)
            left, right = max(left, middle - reach), min(right, middle + reach)
        for x in range(max(0, math.ceil(left)), min(width - 1, math.floor(right)) + 1):
            if not saturated[y, x] and abs(image[y, x]) < np.inf and count < len(places):
                places[count, 0], places[count, 1] = x, y
                count += 1
    return places, count


@njit(cache=True, error_model="numpy")
def _gather(
    image: FloatImage,
    noise: FloatImage,
    p: FloatArray,
    free: NDArray[np.int64],
    places: NDArray[np.int64],
    pixels: int,
    inverse_gain: float,
    normal: FloatArray,
    right: FloatArray,
) -> tuple[float, int]:
    """Normal equations, χ² and the number of pixels that are not outliers."""
    normal[:], right[:] = 0.0, 0.0
    slope = np.empty(7)
    chi2, count = 0.0, 0
    for k in range(pixels):
        x, y = places[k]
        light = _model(p, x, y, slope)
        variance = noise[y, x] ** 2 + max(light - p[SKY], 0.0) * inverse_gain
        rest = image[y, x] - light
        if rest * rest > _OUTLIER**2 * variance:
            # a hot pixel, a hit: of no use, and dear enough not to be thrown away for a better χ²
            chi2 += _OUTLIER**2
            continue
        weight = 1.0 / variance
        chi2 += rest * rest * weight
        count += 1
        for i in range(len(free)):
            scaled = weight * slope[free[i]]
            right[i] += scaled * rest
            for j in range(i + 1):
                normal[i, j] += scaled * slope[free[j]]
    for i in range(len(free)):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return chi2, count


@njit(cache=True, error_model="numpy")
def _inverse(normal: FloatArray, damping: float) -> FloatArray:
    """Inverse of normal equations with a relative damping; infinite where a parameter has no effect at all."""
    size = len(normal)
    scale = np.empty(size)
    for i in range(size):
        if not 0.0 < normal[i, i] < np.inf:
            return np.full((size, size), np.inf)
        scale[i] = 1.0 / np.sqrt(normal[i, i])
    scaled = normal * scale.reshape(-1, 1) * scale
    for i in range(size):
        # the least that keeps parameters of the same effect from being singular
        scaled[i, i] = 1.0 + damping + 1e-10
    return np.linalg.inv(scaled) * scale.reshape(-1, 1) * scale


@njit(cache=True, error_model="numpy")
def fit_streak(
    image: FloatImage,
    noise: FloatImage,
    saturated: NDArray[np.bool_],
    start: FloatArray,
    free: NDArray[np.int64],
    slack: float,
    inverse_gain: float,
) -> tuple[FloatArray, FloatArray, float, int]:
    """Least-squares fit of a streak (Levenberg 1944, Marquardt 1963).

    Parameters
    ----------
    image, noise : (H, W)
        Residual above the background, DN, and its standard deviation.
    saturated : (H, W)
        Pixels left out.
    start : (7,)
        x, y, flux, angle, half length, σ, sky.
    free : (M,)
        Which of these are fitted.
    slack : float
        How far, in pixels, the window reaches beyond the streak.
    inverse_gain : float
        DN an electron, for the photon noise; 0: none.

    Returns
    -------
    parameters (7,), covariance of the free ones (M, M), χ² a degree of freedom, pixels used (0: no fit)
    """
    p = start.copy()
    size = len(free)
    places, pixels = _window(image, saturated, start, slack)
    normal, right = np.empty((size, size)), np.empty(size)
    new_normal, new_right = np.empty((size, size)), np.empty(size)
    none = np.zeros((size, size))
    chi2, count = _gather(image, noise, p, free, places, pixels, inverse_gain, normal, right)
    damping = 1e-2
    for _ in range(40):
        if count <= size:
            return p, none, np.inf, 0
        inverse = _inverse(normal, damping)
        if not np.isfinite(inverse[0, 0]):
            return p, none, np.inf, 0
        step = inverse @ right
        trial = p.copy()
        for i in range(size):
            trial[free[i]] += step[i]
        trial[HALF] = max(trial[HALF], 0.5)
        trial[SIGMA] = min(max(trial[SIGMA], 0.3), 4.0 * start[SIGMA])
        new_chi2, new_count = _gather(image, noise, trial, free, places, pixels, inverse_gain, new_normal, new_right)
        if new_chi2 <= chi2:
            done = chi2 - new_chi2 < 1e-2
            p, chi2, count = trial, new_chi2, new_count
            normal[:], right[:] = new_normal, new_right
            damping = max(damping * 0.1, 1e-6)
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    if count <= size:
        return p, none, np.inf, 0
    return p, _inverse(normal, 0.0), chi2 / (count - size), count


@njit(cache=True, error_model="numpy")
def subtract_streak(image: FloatImage, p: FloatArray, sign: float) -> None:
    """Take a streak off an image in place (`sign` −1: put it back); its sky is left."""
    slope = np.empty(7)
    sigma = p[SIGMA]
    wide = p[HALF] * abs(math.cos(p[ANGLE])) + 6.0 * sigma
    high = p[HALF] * abs(math.sin(p[ANGLE])) + 6.0 * sigma
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    for y in range(max(0, int(p[Y] - high)), min(image.shape[0], int(p[Y] + high) + 2)):
        for x in range(max(0, int(p[X] - wide)), min(image.shape[1], int(p[X] + wide) + 2)):
            if abs((y - p[Y]) * cos - (x - p[X]) * sin) < 6.0 * sigma:
                image[y, x] -= np.float32(sign * (_model(p, x, y, slope) - p[SKY]))
