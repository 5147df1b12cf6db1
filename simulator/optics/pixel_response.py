"""Intra-pixel sensitivity: the response of a pixel across its area.

The response to light at (u, v) pixels from the pixel's centre is r(u) r(v) with the raised cosine

    r(u) = 1 + c cos 2πu,   |u| ≤ ½,

that is 1 + c in the middle of a pixel and 1 − c at its edges; its mean is 1, so that the quantum efficiency of the
whole pixel is unchanged. An image integrated over pixels is its convolution with r(u) r(v), whose transfer function on
one axis is

    R(f) = sinc f + ½ c (sinc(f − 1) + sinc(f + 1)),   sinc f = sin πf / (πf).

At the sampling frequencies R(0) = 1, R(±1) = c/2 and R(k) = 0, so that the sum over the pixels of a star at x with the
optical transfer function G is 1 + c G(1) cos 2πx: its brightness and its position vary with the sub-pixel position.
Images that are wider than a pixel hide the response: G(1) is 1e-7 for a Gaussian of σ = 0.9 px, 0.7 % for 0.5 px.
Source of the effect: Lauer 1999, PASP 111, 1434; Anderson & King 2000, PASP 112, 1360.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss

from startracker.core import FloatArray
from startracker.display import changed_fields

_NODES, _WEIGHTS = leggauss(24)
_WIDE_STEP = 0.5
"""Widest panel of the quadrature over a pixel, in standard deviations of the Gaussian, for which 24 nodes are exact to
1e-15."""


@dataclass(frozen=True)
class IntraPixel:
    """Errors of the position within a pixel."""

    contrast: float = 0.0
    """Sensitivity in the middle of a pixel minus that at its edges, over their sum, on each axis; 0: uniform pixels."""
    centroid_curve_px: float = 0.0
    """Amplitude of a measured periodic error of the position within a pixel, A sin 2πx on each axis, in addition to
    what `contrast` causes; 0: none."""

    __repr__ = changed_fields


def transfer(frequency: FloatArray, contrast: float) -> FloatArray:
    """R(f) of a pixel on one axis; `frequency` in cycles per pixel."""
    even = np.sinc(frequency)
    if contrast == 0.0:
        return np.asarray(even)
    return np.asarray(even + 0.5 * contrast * (np.sinc(frequency - 1.0) + np.sinc(frequency + 1.0)))


def gaussian_shares(offsets_px: FloatArray, sigma_px: float, contrast: float) -> FloatArray:
    """Response (N,) of pixels whose centres are at offsets (N,) from a Gaussian line of unit light."""
    # Gauss–Legendre quadrature over the pixel, divided into panels that are narrow compared with the Gaussian.
    panels = max(1, math.ceil(1.0 / (_WIDE_STEP * sigma_px)))
    middles = (np.arange(panels) + 0.5) / panels - 0.5
    u = (middles[:, None] + 0.5 * _NODES / panels).ravel()
    weight = np.tile(0.5 * _WEIGHTS / panels, panels) * (1.0 + contrast * np.cos(2.0 * np.pi * u))
    density = np.exp(-0.5 * ((offsets_px[:, None] + u) / sigma_px) ** 2) / (math.sqrt(2.0 * math.pi) * sigma_px)
    return np.asarray(density @ weight)
