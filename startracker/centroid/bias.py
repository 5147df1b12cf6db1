"""Bias of the first moment over a finite window, and its exact inverse, for Gaussian star images."""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray

_SQRT_HALF = math.sqrt(0.5)
_DENSITY = 1.0 / math.sqrt(2.0 * math.pi)
_CONVERGED = 1e-13
_UNGUARDED = 8
_STEEP = 0.05
"""Least slope of the mean against the centre for which Newton's method is tried without a bracket."""
_NEAR = 1e-6
"""Error of the mean, px, after which the next Newton step, which is then the last, is exact to 1e-11 px."""
GUESSES, _STEP_PX = 9, 0.125
_FLAT = 1e-6
"""Slope of the mean against the centre below which the window no longer determines the position."""
_NO_LIGHT = 1e-280
SMALLEST_SIGMA_PX = 0.1
"""Narrower images lie within one pixel at nearly all positions, and their moments do not determine the position."""


@kernel
def window_moments(
    centre: float, sigma: float, low: int, high: int
) -> tuple[float, float, float, float, float, float, float]:
    """Moments of a unit Gaussian, integrated over pixels, in the pixels `low` … `high` of one axis.

    Returns
    -------
    light, mean, variance : float
        Of the light in the window; mean in px, variance in px².
    mean_by_centre, mean_by_sigma, variance_by_centre, variance_by_sigma : float
        Derivatives.
    """
    # Sums of the share (m) and of its derivatives by centre (c) and width (s), times 1, k, k² about the window's
    # middle.
    middle = 0.5 * (low + high)
    m0, m1, m2, c0, c1, c2, s0, s1, s2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    u = (low - 0.5 - centre) / sigma
    tail, density = 0.5 * math.erfc(abs(u) * _SQRT_HALF), math.exp(-0.5 * u * u) * _DENSITY
    for pixel in range(low, high + 1):
        u_next = (pixel + 0.5 - centre) / sigma
        tail_next, density_next = 0.5 * math.erfc(abs(u_next) * _SQRT_HALF), math.exp(-0.5 * u_next * u_next) * _DENSITY
        # Tails beyond both edges, on the side where they are small, keep the digits that a difference of erf would
        # lose.
        if u > 0.0:
            share = tail - tail_next
        elif u_next < 0.0:
            share = tail_next - tail
        else:
            share = 1.0 - tail - tail_next
        by_centre = (density - density_next) / sigma
        by_sigma = (u * density - u_next * density_next) / sigma
        k = pixel - middle
        m0, m1, m2 = m0 + share, m1 + share * k, m2 + share * k * k
        c0, c1, c2 = c0 + by_centre, c1 + by_centre * k, c2 + by_centre * k * k
        s0, s1, s2 = s0 + by_sigma, s1 + by_sigma * k, s2 + by_sigma * k * k
        u, tail, density = u_next, tail_next, density_next
    if m0 <= _NO_LIGHT:
        return 0.0, middle, 0.0, 0.0, 0.0, 0.0, 0.0
    mean, square = m1 / m0, m2 / m0
    mean_c, mean_s = (c1 - mean * c0) / m0, (s1 - mean * s0) / m0
    variance_c = (c2 - square * c0) / m0 - 2.0 * mean * mean_c
    variance_s = (s2 - square * s0) / m0 - 2.0 * mean * mean_s
    return m0, middle + mean, square - mean * mean, mean_c, mean_s, variance_c, variance_s


@kernel_part
def invert_moment(moment: float, sigma: float, low: int, high: int) -> tuple[float, float]:
    """Centre of the pixel-integrated Gaussian whose mean over the window is `moment`, and d(centre)/d(moment).

    The mean increases monotonically with the centre. Newton's method is used, within a bracket of one window about the
    middle if it does not converge without. The slope is infinite if no centre in the bracket has this moment.
    """
    centre, slope, _light = invert_from(moment, moment, sigma, low, high)
    return centre, slope


@kernel
def invert_from(guess: float, moment: float, sigma: float, low: int, high: int) -> tuple[float, float, float]:
    """`invert_moment` from a first guess; also returns the light in the window, for the last centre but one."""
    middle = 0.5 * (low + high)
    reach = float(high - low + 1)
    left, right = middle - reach, middle + reach
    centre = guess
    for _ in range(_UNGUARDED):
        light, mean, _variance, slope, _a, _b, _c = window_moments(centre, sigma, low, high)
        error = mean - moment
        centre -= error / slope if slope > _STEEP else np.inf
        if not left < centre < right:
            break
        if abs(error) < _NEAR:
            return centre, 1.0 / slope, light
    if not window_moments(left, sigma, low, high)[1] < moment < window_moments(right, sigma, low, high)[1]:
        return moment, np.inf, 0.0
    centre, slope, error, light = moment, 0.0, 1.0, 0.0
    for _ in range(50):
        light, mean, _variance, slope, _a, _b, _c = window_moments(centre, sigma, low, high)
        error = mean - moment
        if abs(error) < _CONVERGED:
            break
        if error > 0.0:
            right = centre
        else:
            left = centre
        guess = centre - error / slope if slope > _FLAT else left
        centre = guess if left < guess < right else 0.5 * (left + right)
    if abs(error) > 1e-6 or slope <= _FLAT:
        return centre, np.inf, light
    return centre, 1.0 / slope, light


@kernel_part
def fill_centres(sigma: float, half: int, table: FloatArray) -> None:
    """Table (`GUESSES`, 2) of the mean over a full window, and d(centre)/d(mean), of Gaussians 0, ⅛, ¼, … 1 px off its
    middle."""
    for k in range(GUESSES):
        _light, mean, _variance, slope, _a, _b, _c = window_moments(k * _STEP_PX, sigma, -half, half)
        table[k, 0], table[k, 1] = mean, 1.0 / slope


@kernel_part
def guess_centre(moment: float, table: FloatArray) -> float:
    """Centre by cubic interpolation in a table of `fill_centres`, to about 1e-6 px; beyond the table, the moment
    itself."""
    mean, k = abs(moment), 0
    while k < GUESSES - 1 and not mean < table[k + 1, 0]:
        k += 1
    if k == GUESSES - 1:
        return moment
    span = table[k + 1, 0] - table[k, 0]
    t = (mean - table[k, 0]) / span
    # Hermite interpolation: the deviation from the line through both ends.
    first, last = table[k, 1] * span - _STEP_PX, table[k + 1, 1] * span - _STEP_PX
    centre = (k + t) * _STEP_PX + t * (1.0 - t) * ((1.0 - t) * first - t * last)
    return math.copysign(centre, moment) if math.isfinite(centre) else moment


@kernel
def invert_moments(mean: float, variance: float, low: int, high: int) -> tuple[float, float]:
    """Centre and width of the pixel-integrated Gaussian with this mean and variance over the window, px.

    The width is bracketed between a tenth of a pixel and the window; the centre follows from it. The width is NaN if no
    such Gaussian has this variance.
    """
    narrow, wide = SMALLEST_SIGMA_PX, float(high - low + 1)
    sigma = min(max(math.sqrt(max(variance, 0.01)), narrow), wide)
    # Newton's method for both unknowns at once, which usually converges without a bracket.
    middle, centre, width = 0.5 * (low + high), mean, sigma
    for _ in range(_UNGUARDED):
        _light, here, found, mean_c, mean_s, variance_c, variance_s = window_moments(centre, width, low, high)
        off, over, determinant = here - mean, found - variance, mean_c * variance_s - mean_s * variance_c
        if not (mean_c > _STEEP and variance_s > _STEEP and determinant > _STEEP * variance_s):
            break
        centre -= (off * variance_s - over * mean_s) / determinant
        width -= (over * mean_c - off * variance_c) / determinant
        if not (narrow <= width <= wide and abs(centre - middle) < 0.5 * wide):
            break
        if abs(off) < _NEAR and abs(over) < _NEAR:
            return centre, width
    for _ in range(50):
        centre, slope = invert_moment(mean, sigma, low, high)
        _light, _mean, found, mean_c, mean_s, variance_c, variance_s = window_moments(centre, sigma, low, high)
        error = found - variance
        if abs(error) < _CONVERGED:
            return centre, sigma if slope < np.inf else np.nan
        if error > 0.0:
            wide = sigma
        else:
            narrow = sigma
        # Derivative of the variance by the width along the curve of constant mean.
        rate = variance_s - variance_c * mean_s / mean_c if mean_c > _FLAT else 0.0
        guess = sigma - error / rate if rate > _FLAT else narrow
        sigma = guess if narrow < guess < wide else 0.5 * (narrow + wide)
    return mean, np.nan


def moment_bias(
    offset_px: FloatArray | float, sigma_px: float, window_px: int = 5, *, integrated: bool = True
) -> FloatArray:
    """Offset of a star from the centre of its window minus the first moment measured there (Greyling 1995, Table 4.1).

    b(d) = d − Σ k p_k(d) / Σ p_k(d), k = −n … n, where p_k is the light of a Gaussian in pixel k (``integrated``: Φ((k
    + ½ − d)/σ) − Φ((k − ½ − d)/σ); otherwise its value at the pixel's centre, as in Greyling 1995).

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
        Bias, px, with the shape of `offset_px`; add it to the moment measured at that offset.
    """
    n = window_px // 2
    offsets = np.asarray(offset_px, dtype=float)
    if integrated:
        means = np.array([window_moments(float(d), sigma_px, -n, n)[1] for d in offsets.ravel()])
        return np.asarray(offsets - means.reshape(offsets.shape))
    pixels = np.arange(-n, n + 1)
    density = np.exp(-0.5 * ((pixels - offsets[..., None]) / sigma_px) ** 2)
    return np.asarray(offsets - density @ pixels / density.sum(axis=-1))
