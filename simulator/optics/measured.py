"""Where a star image is measured to be: the centroid under the weight that a fit of a Gaussian gives its pixels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import spence

from simulator.optics.diffraction import Images

__all__ = ["measured_centroid"]

FloatArray = NDArray[np.float64]

_STEP_PX = 0.25
CONTRAST = 50.0
"""Photon noise over background noise (variances) in the brightest pixel of the star that defines the position: that of
the stars that calibrations and attitudes rest upon."""

_VARIANCE_SHARE = (1.0 + float(spence(1.0 + CONTRAST)) / CONTRAST) / (1.0 - math.log1p(CONTRAST) / CONTRAST)
"""Variance of a Gaussian along one axis under the weight q g/(1 + q g), over its own: (1 + Li₂(−q)/q) / (1 −
ln(1 + q)/q), from the integrals of q u/(1 + q u) and of that times −ln u over u = exp(−r²/2σ²) from 0 to 1."""
_TOLERANCE_PX = 1e-5
_MOST_STEPS = 200


def measured_centroid(images: Images, spectrum: FloatArray, half_px: int) -> tuple[float, float]:
    """Position (x, y), pixels, that a fit of a Gaussian finds for an image whose geometric centroid is at (0, 0).

    A least-squares fit of p, a symmetric star image, to the light d in pixels of variance b + p solves
    Σ (x − c) p/(b + p) d = 0 for the centre c: a first moment under the weight p/(b + p), which is p itself for a
    faint star and even for a bright one. The weight here is q g/(1 + q g), g = exp(−(x − c_x)²/2σ_x² −
    (y − c_y)²/2σ_y²), q = `CONTRAST`, with the widths for which the variances of the image under the weight are those
    of a Gaussian. Positions by much brighter and fainter stars differ: for coma by up to a third of the distance to the
    geometric centroid.

    Parameters
    ----------
    images : Images
        Images by wavelength.
    spectrum : (K,) array
        Share of the light at each wavelength.
    half_px : int
        How far from the geometric centroid the light is looked at.
    """
    count = round(half_px / _STEP_PX)
    at: FloatArray = np.arange(-count, count + 1, dtype=np.float64) * _STEP_PX
    light = images.shares(spectrum, *images.matrices(at))
    along_x, along_y = light.sum(axis=0), light.sum(axis=1)
    total = light.sum()
    x, y = float(along_x @ at / total), float(along_y @ at / total)
    xx = max(float(along_x @ (at - x) ** 2 / total), 0.1)
    yy = max(float(along_y @ (at - y) ** 2 / total), 0.1)
    for _ in range(_MOST_STEPS):
        core = np.exp(-((at - y) ** 2) / (2.0 * yy))[:, None] * np.exp(-((at - x) ** 2) / (2.0 * xx))
        weighted = light * core / (1.0 + CONTRAST * core)
        total = weighted.sum()
        along_x, along_y = weighted.sum(axis=0) / total, weighted.sum(axis=1) / total
        dx, dy = float(along_x @ (at - x)), float(along_y @ (at - y))
        xx = float(along_x @ (at - x) ** 2) / _VARIANCE_SHARE
        yy = float(along_y @ (at - y) ** 2) / _VARIANCE_SHARE
        # the moment of a Gaussian falls short of its offset
        x, y = x + 1.3 * dx, y + 1.3 * dy
        if max(abs(dx), abs(dy)) < _TOLERANCE_PX:
            break
    return x, y
