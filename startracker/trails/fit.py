"""Kernels that measure trails by least squares."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, IntArray
from startracker.detection.thresholds import RING_SHARE
from startracker.detection.tiles import Plane
from startracker.detection.values import is_value
from startracker.geometry.linalg import factorise, substitute
from startracker.trails.model import (
    ANGLE,
    BLOCK,
    FLUX,
    HALF,
    POSITION,
    SHAPE,
    SIGMA,
    SKY,
    WORK_ROWS,
    X,
    Y,
    is_near,
    linearise,
    set_light,
    subtract_trail,
    window_pixels,
)

FloatImage = NDArray[np.float32]

_FIRST_STEPS, _STEPS = 3, 10
"""Largest numbers of steps before and after pixels are tested for outliers: far from the minimum, all pixels of a
bright trail would be outliers."""
_CONVERGED = 1e-2
"""Decrease of χ² at which the fit has converged: the position is within 0.1 standard errors of the minimum."""
_CLIP = 4.0
"""Signal of a pixel, in units of its noise, at which it is clipped in sums along a line, so that a hot pixel or a
cosmic ray does not determine where the line ends."""
_OUTLIER = 5.0
_BESIDE = 2
"""Number of pixels on either side of a line whose light is summed."""
_BRIGHT_SNR = 30.0
"""Signal-to-noise ratio above which direction and length of a trail are fitted, because they are then more accurate
than those from the frame's motion."""
_BESIDE_FIRST, _BESIDE_LAST = 2, 7
"""Range of the distance, px, beside a bright trail in which another one is searched for: two trails nearer than about 2
px merge into one, and farther trails are found by the ordinary search."""
_SWEEPS = 2
_GOOD_CHI2, _ASIDE_SIGMAS = 2.0, 2.5
"""χ² per degree of freedom above which a fit is repeated, and the distance of its new start beside the first, in
widths."""


class Measured(NamedTuple):
    """Fits of M trails.

    Parameters
    ----------
    table : (M, 7)
        Parameters, see `startracker.trails.model`.
    covariance : (M, 3, 3)
        Covariance of x, y and flux.
    chi2, freedom : (M,)
        χ² per degree of freedom, and degrees of freedom.
    alone : bool (M,)
        Whether direction and length were fitted to the trail itself, rather than given by the frame's motion.
    """

    table: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    freedom: IntArray
    alone: NDArray[np.bool_]


@kernel
def fit_trail(
    residual: FloatImage, noise: Plane, start: FloatArray, size: int, slack: float, inverse_gain: float
) -> tuple[FloatArray, FloatArray, float, int]:
    """Least-squares fit of a trail (Levenberg 1944, Marquardt 1963).

    Parameters
    ----------
    residual : (H, W)
        From `residual_of`.
    noise : Plane
        Standard deviation of a pixel, DN.
    start : (7,)
        Initial parameters; a flux that is not positive is estimated.
    size : int
        Number of parameters to fit: `POSITION`, `SHAPE` or `LINE`.
    slack : float
        Distance by which the window extends beyond the trail, px.
    inverse_gain : float
        DN per electron, for the photon noise; 0 for none.

    Returns
    -------
    parameters (7,), covariance (size, size) of the fitted ones, χ² per degree of freedom (infinite if the fit fails),
    and degrees of freedom
    """
    p, trial = start.copy(), start.copy()
    pixels, usable = window_pixels(residual, noise, p, slack)
    work, none = np.empty((WORK_ROWS, BLOCK)), np.zeros((size, size))
    factor, step, normal, right = np.zeros((size, size)), np.zeros(size), np.zeros((size, size)), np.zeros(size)
    new_normal, new_right = np.zeros((size, size)), np.zeros(size)
    if usable <= size:
        return p, none, np.inf, 0
    if not p[FLUX] > 0.0:
        set_light(pixels, p, work, normal, right)
        if not p[FLUX] > 0.0:
            return p, none, np.inf, 0
    chi2, outliers, damping = np.inf, usable, 0.0
    for outlier, steps in ((np.inf, _FIRST_STEPS if size == POSITION else _STEPS), (_OUTLIER, _STEPS)):
        # Without outliers in the first pass the equations of the second are the same.
        if outliers > 0:
            chi2, outliers = linearise(pixels, p, size, inverse_gain, outlier, work, normal, right)
            damping = 1e-3
        done = False
        for _ in range(steps):
            factor[:], step[:] = normal, right
            # Marquardt's damping: each diagonal element is raised in proportion to itself, so that units do not matter.
            for i in range(size):
                factor[i, i] *= 1.0 + damping
            if not factorise(factor, size):
                return p, none, np.inf, 0
            substitute(factor, size, step)
            gain = 0.0
            for i in range(size):
                gain += step[i] * right[i]
            done = not gain > _CONVERGED
            if done:
                break
            trial[:] = p
            trial[:size] += step
            trial[HALF] = max(trial[HALF], 0.5)
            trial[SIGMA] = min(max(trial[SIGMA], 0.3), 4.0 * start[SIGMA])
            new_chi2, new_outliers = linearise(pixels, trial, size, inverse_gain, outlier, work, new_normal, new_right)
            if new_chi2 > chi2:
                damping = max(10.0 * damping, 1.0)  # less would hardly shorten the step
                continue
            done = chi2 - new_chi2 < _CONVERGED
            p[:], normal[:], right[:], damping = trial, new_normal, new_right, 0.1 * damping
            chi2, outliers = new_chi2, new_outliers
            if done:
                break
        if done and outliers == 0:
            break
    factor[:], freedom = normal, usable - outliers - size
    if freedom <= 0 or not factorise(factor, size):
        return p, none, np.inf, 0
    covariance = np.eye(size)
    for i in range(size):
        substitute(factor, size, covariance[i])
    return p, covariance, chi2 / freedom, freedom


@kernel
def light_along(residual: FloatImage, noise: Plane, p: FloatArray, reach: int) -> FloatArray:
    """Cumulative sums (2 reach + 2,) of the light along a trail's line, from −`reach` to `reach` px about its middle.

    The light per pixel of length is the residual over the noise, clipped, and weighted across the line with a Gaussian
    slightly wider than the star image; white noise has a standard deviation of 1 in it.
    """
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    weights, square = np.empty(2 * _BESIDE + 1), 0.0
    for t in range(2 * _BESIDE + 1):
        weights[t] = math.exp(-0.5 * ((t - _BESIDE) / (p[SIGMA] + 0.5)) ** 2)
        square += weights[t] ** 2
    weights /= math.sqrt(square)
    total = np.zeros(2 * reach + 2)
    for k in range(2 * reach + 1):
        s, light = k - reach, 0.0
        for t in range(2 * _BESIDE + 1):
            x = round(p[X] + s * cos - (t - _BESIDE) * sin)
            y = round(p[Y] + s * sin + (t - _BESIDE) * cos)
            if 0 <= x < residual.shape[1] and 0 <= y < residual.shape[0] and is_value(residual[y, x]):
                light += weights[t] * min(max(residual[y, x] / noise[y, x], -_CLIP), 2.0 * _CLIP)
        total[k + 1] = total[k] + light
    return total


@kernel
def best_stretches(total: FloatArray, lengths: IntArray) -> tuple[FloatArray, FloatArray]:
    """Most significant stretch of each length (N,), px, among those that contain the middle of a line.

    Returns its sum / √length, which is its signal-to-noise ratio, and its middle relative to that of the line, px.
    `total` is from `light_along`.
    """
    reach = len(total) // 2 - 1
    best, middle = np.empty(len(lengths)), np.empty(len(lengths))
    for n in range(len(lengths)):
        length, most, where = lengths[n], -np.inf, reach
        for first in range(max(reach - length + 1, 0), min(reach + 1, len(total) - length)):
            light = total[first + length] - total[first]
            better = light > most  # two selections: a branch would often be mispredicted
            most, where = light if better else most, first if better else where
        best[n], middle[n] = most / math.sqrt(length), where + 0.5 * length - reach - 0.5
    return best, middle


@kernel
def _first_fit(
    residual: FloatImage, noise: Plane, start: FloatArray, inverse_gain: float, threshold: float
) -> tuple[FloatArray, FloatArray, float, int]:
    """`fit_trail` for a trail of known length and direction from a search; χ² is infinite if it has too little
    light."""
    first, length = start.copy(), round(2.0 * start[HALF])
    # Noise causes several minima along a long trail; the fit starts at the deepest one within some pixels.
    away = min(max(0.05 * length, 3.0), 6.0)
    total = light_along(residual, noise, first, math.ceil(first[HALF] + away))
    _shift(first, best_stretches(total, np.full(1, length))[1][0], 0.0)
    p, covariance, chi2, freedom = fit_trail(residual, noise, first, POSITION, 2.0, inverse_gain)
    for side in (-1.0, 1.0):
        # A search in clipped light locates bright trails only to within some widths.
        if chi2 > _GOOD_CHI2:
            aside = first.copy()
            _shift(aside, 0.0, side * _ASIDE_SIGMAS * first[SIGMA])
            other = fit_trail(residual, noise, aside, POSITION, 2.0, inverse_gain)
            if other[2] < chi2:
                p, covariance, chi2, freedom = other
    strong = chi2 < np.inf and p[FLUX] >= threshold * math.sqrt(covariance[FLUX, FLUX])
    # A fit that moves by more than a quarter of its length has found another trail.
    near = math.hypot(p[X] - start[X], p[Y] - start[Y]) <= 0.5 * p[HALF]
    return p, covariance, chi2 if strong and near else np.inf, freedom


@kernel_part
def _shift(p: FloatArray, along: float, across: float) -> None:
    """Move a trail along and across its direction, px, in place."""
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    p[X] += along * cos - across * sin
    p[Y] += along * sin + across * cos


@kernel
def _strongest_beside(residual: FloatImage, noise: Plane, p: FloatArray) -> tuple[FloatArray, float]:
    """Most likely trail beside a bright one, whose light has been subtracted, and its signal-to-noise ratio.

    The search in bins cannot separate two trails within some pixels of each other.
    """
    best, most, length = p.copy(), 0.0, max(round(2.0 * p[HALF]), 1)
    for k in range(2 * (_BESIDE_LAST - _BESIDE_FIRST + 1)):
        other, across = p.copy(), float(_BESIDE_FIRST + k // 2)
        _shift(other, 0.0, across if k % 2 else -across)
        total = light_along(residual, noise, other, length)
        score, middle = best_stretches(total, np.full(1, length))
        if score[0] > most:
            most = score[0]
            best[:] = other
            _shift(best, middle[0], 0.0)
    best[FLUX] = best[SKY] = 0.0
    return best, most


@kernel
def measure_trails(
    residual: FloatImage, noise: Plane, starts: FloatArray, inverse_gain: float, threshold: float, most: int
) -> Measured:
    """Fit trails, each with the light of the others subtracted, and subtract all of them from the residual, in place.

    Parameters
    ----------
    starts : (N, 7)
        Initial parameters, brightest first.
    threshold : float
        Least signal-to-noise ratio of a trail.
    most : int
        Number of trails wanted; neighbours found beside bright trails are counted in addition.
    """
    room = 2 * len(starts)
    found, covariances, alone = np.empty((room, 7)), np.empty((room, 3, 3)), np.zeros(room, np.bool_)
    chi2s, freedoms, count = np.empty(room), np.empty(room, np.int64), 0
    for n in range(len(starts)):
        if count == most:
            break
        p, covariance, chi2, freedom = _first_fit(residual, noise, starts[n], inverse_gain, threshold)
        if chi2 < np.inf:
            subtract_trail(residual, p, 1.0)
            found[count], covariances[count], chi2s[count], freedoms[count] = p, covariance[:3, :3], chi2, freedom
            count += 1
    for n in range(count):
        if found[n, FLUX] > _BRIGHT_SNR * math.sqrt(covariances[n, FLUX, FLUX]):
            start, score = _strongest_beside(residual, noise, found[n])
            if score < threshold:
                continue
            p, covariance, chi2, freedom = _first_fit(residual, noise, start, inverse_gain, threshold)
            if chi2 < np.inf and p[FLUX] > RING_SHARE * found[n, FLUX]:
                subtract_trail(residual, p, 1.0)
                found[count], covariances[count], chi2s[count], freedoms[count] = p, covariance[:3, :3], chi2, freedom
                count += 1
    # Overlapping trails are fitted again in turn, each with its own light restored and the others' subtracted.
    for sweep in range(_SWEEPS):
        for n in range(count):
            crowded = False
            for other in range(count):
                crowded |= other != n and is_near(found[n], found[other])
            bright = found[n, FLUX] > _BRIGHT_SNR * math.sqrt(covariances[n, FLUX, FLUX])
            if not (crowded or (bright and sweep == 0)):
                continue
            subtract_trail(residual, found[n], -1.0)
            size = SHAPE if bright else POSITION
            p, covariance, chi2, freedom = fit_trail(residual, noise, found[n], size, 2.0, inverse_gain)
            if chi2 < np.inf:
                found[n], covariances[n], chi2s[n], freedoms[n] = p, covariance[:3, :3], chi2, freedom
                alone[n] = bright
            subtract_trail(residual, found[n], 1.0)
    return Measured(found[:count], covariances[:count], chi2s[:count], freedoms[:count], alone[:count])
