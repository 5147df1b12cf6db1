"""The bias of a first moment over a finite window, and its exact inverse, for Gaussian star images."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["gaussian_share", "invert_moment", "invert_moments", "moment_bias", "window_moments"]

FloatArray = NDArray[np.float64]

_SQRT_HALF = math.sqrt(0.5)
SMALLEST_SIGMA_PX = 0.1
"""Narrower images lie within one pixel wherever they are; their position is not in the moments."""


@njit(cache=True, error_model="numpy")
def gaussian_share(pixel: float, centre: float, sigma: float, integrated: bool) -> float:
    """Share of a unit Gaussian's light in a pixel of width 1 (or its density at the pixel's centre)."""
    d = pixel - centre
    if integrated:
        # erfc keeps the digits of the tails, where the difference of two erf would lose them
        a, b = abs(d) - 0.5, abs(d) + 0.5
        s = _SQRT_HALF / sigma
        return 0.5 * (math.erfc(a * s) - math.erfc(b * s))
    return math.exp(-0.5 * (d / sigma) ** 2) / (sigma * 2.5066282746310002)


@njit(cache=True, error_model="numpy")
def window_moments(centre: float, sigma: float, low: int, high: int, integrated: bool) -> tuple[float, float, float]:
    """Light, mean and variance of a unit Gaussian seen through the pixels low … high of one axis."""
    light, first, second = 0.0, 0.0, 0.0
    for pixel in range(low, high + 1):
        share = gaussian_share(pixel, centre, sigma, integrated)
        light += share
        first += share * pixel
        second += share * pixel * pixel
    if light <= 0.0:
        return 0.0, 0.5 * (low + high), 0.0
    mean = first / light
    return light, mean, second / light - mean * mean


@njit(cache=True, error_model="numpy")
def invert_moment(moment: float, sigma: float, low: int, high: int) -> tuple[float, float]:
    """Centre of the pixel-integrated Gaussian whose moment over the window is `moment`, and d(centre)/d(moment).

    The moment grows steadily with the centre. Newton's method, kept inside a bracket of one and a half windows about
    the window; a moment that no centre in it explains gives its end and an infinite slope.
    """
    reach = 0.75 * (high - low + 1) + 0.5 * sigma
    left, right = 0.5 * (low + high) - reach, 0.5 * (low + high) + reach
    centre = min(max(moment, left), right)
    step = 1e-4
    for _ in range(60):
        value = window_moments(centre, sigma, low, high, True)[1] - moment
        slope = (
            window_moments(centre + step, sigma, low, high, True)[1]
            - window_moments(centre - step, sigma, low, high, True)[1]
        ) / (2.0 * step)
        if value > 0:
            right = centre
        else:
            left = centre
        guess = centre - value / slope if slope > 1e-9 else 0.5 * (left + right)
        if not left < guess < right:
            guess = 0.5 * (left + right)
        change = abs(guess - centre)
        centre = guess
        if change < 1e-12:
            break
    found = window_moments(centre, sigma, low, high, True)[1]
    if slope <= 1e-9 or abs(found - moment) > 1e-6:
        return centre, np.inf
    return centre, 1.0 / slope


@njit(cache=True, error_model="numpy")
def invert_moments(mean: float, variance: float, low: int, high: int) -> tuple[float, float]:
    """Centre and width of the pixel-integrated Gaussian with this mean and variance over the window.

    The width is NaN when the variance is not that of any Gaussian narrower than the window.
    """
    widest = float(high - low + 1)
    s_low, s_high = SMALLEST_SIGMA_PX, widest
    for _ in range(48):
        sigma = 0.5 * (s_low + s_high)
        centre, _slope = invert_moment(mean, sigma, low, high)
        if window_moments(centre, sigma, low, high, True)[2] > variance:
            s_high = sigma
        else:
            s_low = sigma
    sigma = 0.5 * (s_low + s_high)
    if sigma > 0.98 * widest or sigma < 1.02 * SMALLEST_SIGMA_PX:
        return mean, np.nan
    return invert_moment(mean, sigma, low, high)[0], sigma


def moment_bias(
    offset_px: FloatArray | float, sigma_px: float, window_px: int = 5, *, integrated: bool = True
) -> FloatArray:
    """Offset of a star from the centre of its window minus the first moment measured there: thesis Table 4.1.

    b(d) = d − Σ k p_k(d) / Σ p_k(d), k = −n … n, with p_k the light of a Gaussian in pixel k
    (``integrated``: Φ((k + ½ − d)/σ) − Φ((k − ½ − d)/σ); else its value at the pixel's centre, as in the thesis).

    Parameters
    ----------
    offset_px : array_like
        Offset d from the central pixel's centre, pixels.
    sigma_px : float
        Width σ of the star image, pixels.
    window_px : int
        Odd side of the window, 2n + 1.
    integrated : bool
        Whether pixels integrate the light that falls on them.

    Returns
    -------
    array
        Bias in pixels, of the shape of `offset_px`; to be added to the measured moment at that offset.
    """
    n = window_px // 2
    offsets = np.asarray(offset_px, dtype=float)
    bias = [float(d) - window_moments(float(d), sigma_px, -n, n, integrated)[1] for d in offsets.ravel()]
    return np.array(bias).reshape(offsets.shape)
