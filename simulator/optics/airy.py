"""The Airy pattern of a clear or annular aperture, integrated over pixels: tables for `simulator.optics.psf`."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import j0, j1

from simulator.optics.pixel_response import transfer
from startracker.core import FloatArray

FIRST_RING = 1.2196698912665045
"""Radius of the first dark ring in units of λN: the first zero of J₁, 3.8317, over π."""


@functools.lru_cache(maxsize=64)
def first_ring(obscuration: float = 0.0) -> float:
    """Radius of the first dark ring in units of λN, for a central obscuration ε of the diameter.

    The first zero of J₁(v) − ε J₁(εv), over π: 1.2197 for a clear aperture, 1.0005 for ε = ½ (Born & Wolf, § 8.6.2).
    """
    if obscuration == 0.0:
        return FIRST_RING
    low, high = 2.2, 3.9  # positive to the left of the zero, negative to its right
    while low < (middle := 0.5 * (low + high)) < high:
        if j1(middle) > obscuration * j1(obscuration * middle):
            low = middle
        else:
            high = middle
    return middle / math.pi


def intensity(x: ArrayLike, obscuration: float = 0.0) -> FloatArray:
    """Airy pattern at x = r/(λN), normalised to 1 over the plane of x.

    I = π/(4(1−ε²)) [2J₁(v)/v − ε² 2J₁(εv)/(εv)]², v = πx; Born & Wolf, § 8.6.2 (there relative to the central value,
    which is π(1−ε²)/4).
    """
    v = np.maximum(np.pi * np.abs(np.asarray(x, dtype=float)), 1e-9)  # 2J₁(v)/v is 1 at v = 0
    amplitude = 2.0 * j1(v) / v
    if obscuration > 0.0:
        amplitude = amplitude - 2.0 * obscuration * j1(obscuration * v) / v
    return np.asarray(math.pi / (4.0 * (1.0 - obscuration**2)) * amplitude**2)


def encircled_energy(x: FloatArray | float, obscuration: float = 0.0) -> FloatArray:
    """Fraction of the light within x = r/(λN) of the centre.

    1 − J₀²(v) − J₁²(v), v = πx, for a clear aperture (Born & Wolf, § 8.5.2); with a central obscuration ε
    [1 − J₀²(v) − J₁²(v) + ε²(1 − J₀²(εv) − J₁²(εv)) − 4ε ∫₀ᵛ J₁(t) J₁(εt)/t dt]/(1 − ε²), the integral of the
    pattern's three terms (Mahajan 1986).
    """
    v = np.pi * np.asarray(x, dtype=float)
    clear = 1.0 - j0(v) ** 2 - j1(v) ** 2
    if obscuration == 0.0:
        return np.asarray(clear)
    hole = obscuration**2 * (1.0 - j0(obscuration * v) ** 2 - j1(obscuration * v) ** 2)
    return np.asarray((clear + hole - 4.0 * obscuration * _cross_term(v, obscuration)) / (1.0 - obscuration**2))


def _cross_term(v: FloatArray, obscuration: float) -> FloatArray:
    """∫₀ᵛ J₁(t) J₁(εt)/t dt by Gauss–Legendre quadrature in panels no wider than 2."""
    # The wanted arguments are edges of panels, so the interpolation at the end only looks up the cumulative sums.
    last = float(np.max(v, initial=1.0))
    edges = np.union1d(np.arange(0.0, last, 2.0), np.ravel(v))
    nodes, weights = np.polynomial.legendre.leggauss(10)
    width = np.diff(edges)
    t = edges[:-1, None] + width[:, None] * (nodes + 1.0) / 2.0
    panels = (j1(t) * j1(obscuration * t) / np.maximum(t, 1e-300)) @ weights * width / 2.0
    return np.asarray(np.interp(v, edges, np.concatenate([[0.0], np.cumsum(panels)])))


def transfer_function(s: FloatArray, obscuration: float = 0.0) -> FloatArray:
    """Optical transfer function of a circular pupil at s = λN × spatial frequency; zero from s = 1 on.

    The common area of the pupil and its shifted copy over the area of the pupil: disk on disk, minus twice disk on
    obscuration, plus obscuration on obscuration (O'Neill 1956, JOSA 46, 285).
    """
    s = np.abs(s)
    clipped = np.minimum(s, 1.0)
    clear = np.asarray(2.0 / np.pi * (np.arccos(clipped) - clipped * np.sqrt(1.0 - clipped * clipped)))
    if obscuration == 0.0:
        return clear
    e = obscuration
    scaled = np.minimum(s / e, 1.0)
    hole = e * e * 2.0 / np.pi * (np.arccos(scaled) - scaled * np.sqrt(1.0 - scaled * scaled))
    # Distance of the centres of pupil (radius 1) and shifted obscuration (radius e). Below 1 − e the obscuration is
    # entirely inside the pupil, above 1 + e outside. The common area is that of two circular segments.
    d = np.clip(2.0 * s, 1.0 - e, 1.0 + e)
    big = np.arccos(np.clip((d * d + 1.0 - e * e) / (2.0 * d), -1.0, 1.0))
    small = np.arccos(np.clip((d * d + e * e - 1.0) / (2.0 * d * e), -1.0, 1.0))
    product = (1.0 + e - d) * (d + e - 1.0) * (d + 1.0 - e) * (d + 1.0 + e)
    lens = big + e * e * small - 0.5 * np.sqrt(np.maximum(product, 0.0))
    return np.asarray((clear - 2.0 * lens / np.pi + hole) / (1.0 - e * e))


def pixel_integrals(
    u: FloatArray,
    v: FloatArray,
    lambda_n_px: float,
    aspect: float,
    obscuration: float = 0.0,
    diffusion_px: float = 0.0,
    contrast: float = 0.0,
) -> FloatArray:
    """Fraction of the light in a pixel whose centre is (u, v) pixels from the star.

    The Airy pattern convolved with the pixel is evaluated as a Fourier series. Its spectrum ends at 1/(λN), so that
    this is an exact sum over a finite set of frequencies. The period is so large that the periodic copies add less than
    1e-6 of the light to any pixel.

    Parameters
    ----------
    u, v : (U,), (V,) arrays
        Offsets along columns and rows, pixels.
    lambda_n_px : float
        λN in pixels along columns.
    aspect : float
        Pitch along columns over pitch along rows: λN along rows is `lambda_n_px` × `aspect` pixels.
    obscuration : float
        Central obscuration, fraction of the diameter.
    diffusion_px : float
        Standard deviation of a Gaussian blur, pixels along columns.
    contrast : float
        Contrast of the response across a pixel (`simulator.optics.pixel_response`).

    Returns
    -------
    (V, U) array
    """
    lambda_x, lambda_y = lambda_n_px, lambda_n_px * aspect
    reach_x, reach_y = float(np.abs(u).max()), float(np.abs(v).max())
    period_x, period_y = 4.0 * reach_x + 40.0 * lambda_x + 32.0, 4.0 * reach_y + 40.0 * lambda_y + 32.0
    fx, fy = _frequencies(period_x, lambda_x), _frequencies(period_y, lambda_y)
    s = np.hypot(fx[None, :] * lambda_x, fy[:, None] * lambda_y)
    pixel = transfer(fx, contrast)[None, :] * transfer(fy, contrast)[:, None]
    spectrum = transfer_function(s, obscuration) * pixel / (period_x * period_y)
    if diffusion_px > 0.0:
        across = (fx[None, :] * diffusion_px) ** 2 + (fy[:, None] * diffusion_px * aspect) ** 2
        spectrum = spectrum * np.exp(-2.0 * np.pi**2 * across)
    # The pattern is even in both axes, so the series has cosines only, and separates into two products of matrices.
    return np.asarray(_cosines(v, fy) @ spectrum @ _cosines(u, fx).T)


def annulus_share(r_px: FloatArray, lambda_n_px: float, aspect: float, obscuration: float = 0.0) -> FloatArray:
    """Fraction of the light in a pixel at distance r (pixels along columns), far out in the wings.

    This is the mean of the pattern over a ring as wide as the side of a square pixel of the same area, so that the
    pixels beyond a radius sum to the light beyond it. If dark rings are closer than two pixels, the width of the ring
    is an integer multiple of λN, because otherwise the sum over pixels would depend on the sub-pixel position of the
    star. The error is below λN/(31 (1−ε) r³), about the pattern itself: less than 8e-5 of the light for a clear
    aperture and r ≥ 4 λN + 3.
    """
    side = 1.0 / math.sqrt(aspect)  # the pixel's area in units of columns squared is 1/aspect
    width = lambda_n_px * math.ceil(side / lambda_n_px) if lambda_n_px < 2.0 * side else side
    outer, inner = r_px + width / 2.0, np.maximum(r_px - width / 2.0, 0.0)
    ring = encircled_energy(outer / lambda_n_px, obscuration) - encircled_energy(inner / lambda_n_px, obscuration)
    return np.asarray(ring * side * side / (np.pi * (outer**2 - inner**2)))


def _frequencies(period: float, lambda_n: float) -> FloatArray:
    """Harmonics of the period, cycles per pixel, from 0 to the cut-off 1/(λN)."""
    return np.arange(math.floor(period / lambda_n) + 1) / period


def _cosines(x: FloatArray, frequency: FloatArray) -> FloatArray:
    # The factor 2 stands for the pair of frequencies ±f; the mean, f = 0, occurs once.
    table = 2.0 * np.cos(2.0 * np.pi * np.outer(x, frequency))
    table[:, 0] = 1.0
    return np.asarray(table)
