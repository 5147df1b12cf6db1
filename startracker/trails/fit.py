"""Kernels that measure trails by least squares."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray, IntArray
from startracker.detection.thresholds import RING_SHARE
from startracker.detection.tiles import Plane
from startracker.detection.values import is_value
from startracker.geometry.linalg import factorise, substitute
from startracker.kernels import kernel, kernel_part
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
"""At most, before pixels are tested for outliers and after: far from the minimum all of a bright trail would be."""
_CONVERGED = 1e-2
"""Decrease of χ² that is none: a position within 0.1 of its standard error of the minimum."""
_CLIP = 4.0
"""Noise in a pixel at most counted along a line, so that a hot pixel or a cosmic ray does not decide where it ends."""
_OUTLIER = 5.0
_BESIDE = 2
"""Pixels on either side of a line whose light is counted."""
_BRIGHT_SNR = 30.0
"""Above it a trail has its own direction and length, which are then known better than from the frame's motion."""
_BESIDE_FIRST, _BESIDE_LAST = 2, 7
"""Pixels beside a bright trail between which another one is looked for: two images are one up to about 2 px, and
farther away it is found as any other."""
_SWEEPS = 2
_GOOD_CHI2, _ASIDE_SIGMAS = 2.0, 2.5
"""χ² a degree of freedom above which a fit is begun again so many widths beside its first start."""


class Measured(NamedTuple):
    """Fits of M trails.

    Parameters
    ----------
    table : (M, 7)
        Parameters.
    covariance : (M, 3, 3)
        Of x, y and flux.
    chi2, freedom : (M,)
        χ² a degree of freedom, and these.
    alone : bool (M,)
        Whether direction and length are those of the trail, not of the frame's motion.
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
        A flux that is not positive is estimated.
    size : int
        How many parameters are fitted: `POSITION`, `SHAPE` or `LINE`.
    slack : float
        How far, in pixels, the window reaches beyond the trail.
    inverse_gain : float
        DN an electron, for the photon noise; 0: none.

    Returns
    -------
    parameters (7,), covariance of those fitted (size, size), χ² a degree of freedom (infinite: no fit), degrees of
    freedom
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
        if outliers > 0:  # without one the equations stay the same
            chi2, outliers = linearise(pixels, p, size, inverse_gain, outlier, work, normal, right)
            damping = 1e-3
        done = False
        for _ in range(steps):
            factor[:], step[:] = normal, right
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
    """Running sums (2 reach + 2,) of the light along a trail's line, from `reach` px before its middle to as far after.

    The light of a pixel's length is the residual over the noise, clipped, weighted across the line with a Gaussian a
    little wider than the star image; white noise gives it standard deviation 1.
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
    """For each length (N,), px, of the stretches that contain the middle of a line the largest sum / √length, which
    is its signal-to-noise ratio, and the middle of this stretch, px from that of the line.

    `total` is from `light_along`.
    """
    reach = len(total) // 2 - 1
    best, middle = np.full(len(lengths), -np.inf), np.zeros(len(lengths))
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
    """`fit_trail` of a trail of known length and direction that was searched for; infinite χ²: too little light."""
    first, length = start.copy(), round(2.0 * start[HALF])
    # noise gives the fit of a long trail several minima along it: begin at the deepest within some pixels
    away = min(max(0.05 * length, 3.0), 6.0)
    total = light_along(residual, noise, first, math.ceil(first[HALF] + away))
    _shift(first, best_stretches(total, np.full(1, length))[1][0], 0.0)
    p, covariance, chi2, freedom = fit_trail(residual, noise, first, POSITION, 2.0, inverse_gain)
    for side in (-1.0, 1.0):
        # a search of clipped light finds bright trails to within some widths only
        if chi2 > _GOOD_CHI2:
            aside = first.copy()
            _shift(aside, 0.0, side * _ASIDE_SIGMAS * first[SIGMA])
            other = fit_trail(residual, noise, aside, POSITION, 2.0, inverse_gain)
            if other[2] < chi2:
                p, covariance, chi2, freedom = other
    strong = chi2 < np.inf and p[FLUX] >= threshold * math.sqrt(covariance[FLUX, FLUX])
    near = math.hypot(p[X] - start[X], p[Y] - start[Y]) <= 0.5 * p[HALF]
    return p, covariance, chi2 if strong and near else np.inf, freedom


@kernel_part
def _shift(p: FloatArray, along: float, across: float) -> None:
    """Move a trail along and across itself, px, in place."""
    cos, sin = math.cos(p[ANGLE]), math.sin(p[ANGLE])
    p[X] += along * cos - across * sin
    p[Y] += along * sin + across * cos


@kernel_part
def _strongest_beside(residual: FloatImage, noise: Plane, p: FloatArray) -> tuple[FloatArray, float]:
    """Where beside a bright trail, whose light is subtracted, another one is likeliest, and its signal-to-noise ratio.

    A search in bins sees no two trails within some pixels of each other.
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
    """Fits of trails, each with the light of the others subtracted; the residual is left without them.

    Parameters
    ----------
    starts : (N, 7)
        Brightest first.
    threshold : float
        Least signal-to-noise ratio.
    most : int
        Trails wanted; a bright one that another runs beside adds this one.
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
