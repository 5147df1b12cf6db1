"""The Airy pattern integrated over pixels: tables for `simulator.optics.psf`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, j1

FloatArray = NDArray[np.float64]

FIRST_RING = 1.2196698912665045
"""Radius of the first dark ring in units of λN: the first zero of J₁, 3.8317, over π."""


def encircled_energy(x: FloatArray | float) -> FloatArray:
    """Share of the light within x = r/(λN) of the centre: 1 − J₀²(πx) − J₁²(πx); Born & Wolf, § 8.5.2."""
    v = np.pi * np.asarray(x, dtype=float)
    return np.asarray(1.0 - j0(v) ** 2 - j1(v) ** 2)


def transfer_function(s: FloatArray) -> FloatArray:
    """Optical transfer function of a clear circular pupil at s = λN × spatial frequency; zero from s = 1 on."""
    s = np.minimum(np.abs(s), 1.0)
    return np.asarray(2.0 / np.pi * (np.arccos(s) - s * np.sqrt(1.0 - s * s)))


def pixel_integrals(u: FloatArray, v: FloatArray, lambda_n_px: float, aspect: float) -> FloatArray:
    """Share of the light in a pixel whose centre lies (u, v) pixels from the star.

    The Fourier series of the Airy pattern convolved with the pixel, whose spectrum ends at 1/(λN): an exact sum over a
    finite set of frequencies. The period of the series lies so far out that the neighbours it implies add less than
    1e-6 of the light to any pixel.

    Parameters
    ----------
    u, v : (U,), (V,) arrays
        Offsets along columns and rows, pixels.
    lambda_n_px : float
        λN in pixels along columns.
    aspect : float
        Pitch along columns over pitch along rows: λN along rows is `lambda_n_px` × `aspect` pixels.

    Returns
    -------
    (V, U) array
    """
    lambda_x, lambda_y = lambda_n_px, lambda_n_px * aspect
    reach_x, reach_y = float(np.abs(u).max()), float(np.abs(v).max())
    period_x, period_y = 4.0 * reach_x + 40.0 * lambda_x + 32.0, 4.0 * reach_y + 40.0 * lambda_y + 32.0
    fx, fy = _frequencies(period_x, lambda_x), _frequencies(period_y, lambda_y)
    s = np.hypot(fx[None, :] * lambda_x, fy[:, None] * lambda_y)
    spectrum = transfer_function(s) * np.sinc(fx)[None, :] * np.sinc(fy)[:, None] / (period_x * period_y)
    return np.asarray(_cosines(v, fy) @ spectrum @ _cosines(u, fx).T)


def annulus_share(r_px: FloatArray, lambda_n_px: float, aspect: float) -> FloatArray:
    """Share of the light in a pixel at distance r (pixels along columns) far out in the wings.

    The mean of the pattern over a ring as wide as the side of a square pixel of the same area, so that the pixels
    beyond any radius add up to the light beyond it. It is within λN/(31 r³) of the truth (the pattern itself is about
    that): for r ≥ 4 λN + 3 less than 8e-5 of the light.
    """
    side = 1.0 / math.sqrt(aspect)  # the pixel's area in units of columns squared is 1/aspect
    outer, inner = r_px + side / 2.0, np.maximum(r_px - side / 2.0, 0.0)
    ring = encircled_energy(outer / lambda_n_px) - encircled_energy(inner / lambda_n_px)
    return np.asarray(ring * side * side / (np.pi * (outer**2 - inner**2)))


def _frequencies(period: float, lambda_n: float) -> FloatArray:
    return np.arange(math.floor(period / lambda_n) + 1) / period


def _cosines(x: FloatArray, frequency: FloatArray) -> FloatArray:
    table = 2.0 * np.cos(2.0 * np.pi * np.outer(x, frequency))
    table[:, 0] = 1.0
    return np.asarray(table)
