"""Measured position of a star image: the result of a Gaussian fit, averaged over sub-pixel positions."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erf

from simulator.optics.diffraction import Images
from startracker.core import FloatArray

CONTRAST = 50.0
"""Ratio of photon noise to background noise (variances) in the brightest pixel of the star that defines the position,
typical of the stars that dominate calibrations and attitudes."""
_PHASES = 7
"""Number of sub-pixel positions along each axis; odd, so that mirrored images have mirrored positions."""
_LEAST_HALF_PX, _LARGEST_HALF_PX, _WIDTHS = 2, 8, 2.5
"""Half width of the fitted window, pixels and standard deviations of the Gaussian, as in `startracker.centroid`."""
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(8)
# Numbers of fitted parameters: the position only, or position and ellipse.
_POSITION, _ALL = 2, 5
_STEP = 1e-4
_LONGEST_STEP_PX = 0.2
_TOLERANCE_PX = 1e-6
_MOST_STEPS = 60
_MOST_WINDOWS = 12
_LEAST_VARIANCE_PX2 = 0.01
_PIXEL_PX2, _NARROW_PX2 = 1.0 / 12.0, 0.05
"""Variance of a uniform pixel, and the minimum variance at the start of a fit."""


def measured_centroid(images: Images, spectrum: FloatArray, half_px: int) -> tuple[float, float]:
    """Mean position (x, y), pixels, from Gaussian fits of an image whose geometric centroid is at (0, 0).

    A camera is calibrated with many stars at random sub-pixel positions, so that the shift of its centroids from the
    geometric one, averaged over the pixel, is part of its distortion and alignment. The pixel-integrated image at
    `_PHASES`² sub-pixel positions is fitted with a pixel-integrated elliptical Gaussian, and again with the median
    ellipse fixed, as is done for the stars of a frame. The result is the mean of these positions. The fitted window
    starts at the peak, which may be anywhere on the ring of a defocused image, and is moved to the fitted position
    until it no longer changes. Weights are 1/(1 + q p/m) with the model p, its maximum m and q = `CONTRAST`. For much
    brighter and fainter stars the result differs, for coma by up to a third of the distance to the geometric centroid.

    Parameters
    ----------
    images : Images
        Images by wavelength.
    spectrum : (K,) array
        Fraction of the light at each wavelength.
    half_px : int
        Half width of the region around the geometric centroid that is used.
    """
    # The image on a grid of `_PHASES` points per pixel serves all sub-pixel positions: each is a sub-grid of it.
    count = half_px * _PHASES
    at: FloatArray = np.arange(-count, count + 1, dtype=np.float64) / _PHASES
    light = images.shares(spectrum, *images.matrices(at))
    along_x, along_y = light.sum(axis=0) / light.sum(), light.sum(axis=1) / light.sum()
    peak_y, peak_x = np.unravel_index(int(np.argmax(light)), light.shape)
    # First variances, from the second moments about the peak, with distances limited to 3 px because of the wings.
    xx = max(float(along_x @ np.minimum((at - at[peak_x]) ** 2, 9.0)) - _PIXEL_PX2, _NARROW_PX2)
    yy = max(float(along_y @ np.minimum((at - at[peak_y]) ** 2, 9.0)) - _PIXEL_PX2, _NARROW_PX2)
    half = _half_width(xx, yy, 0.0, half_px)
    column, row = int(peak_x), int(peak_y)
    fits = np.tile([at[column], at[row], xx, yy, 0.0], (_PHASES**2, 1))
    for _ in range(_MOST_WINDOWS):
        pixels, stamps = _stamps(light, at, column, row, half)
        fits = _fit(pixels, stamps, fits, _ALL)
        # The ellipse is common to all sub-pixel positions, as it is to the stars of a frame.
        fits[:, 2:] = np.median(fits[:, 2:], axis=0)
        fits = _fit(pixels, stamps, fits, _POSITION)
        x, y = fits[:, :2].mean(axis=0)
        last = column, row, half
        column, row = round(float(x) * _PHASES) + count, round(float(y) * _PHASES) + count
        half = _half_width(float(fits[0, 2]), float(fits[0, 3]), float(fits[0, 4]), half_px)
        if (column, row, half) == last:
            break
    return float(x), float(y)


def _half_width(xx: float, yy: float, xy: float, half_px: int) -> int:
    """Half width of the window of an ellipse of these variances and covariance, pixels."""
    major = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
    return min(max(_LEAST_HALF_PX, math.ceil(_WIDTHS * math.sqrt(major))), _LARGEST_HALF_PX, half_px - 1)


def _stamps(light: FloatArray, at: FloatArray, x: int, y: int, half: int) -> tuple[FloatArray, FloatArray]:
    """Pixel centres (P, 2, W), x and y, and light (P, W, W) of windows around the pixel closest to the peak at column x
    and row y of `light`, for all sub-pixel positions."""
    shifts = np.arange(_PHASES) - _PHASES // 2
    pixels, stamps = [], []
    steps = np.arange(-half, half + 1) * _PHASES
    for down in shifts:
        for across in shifts:
            rows = np.clip(y + down + steps, 0, len(at) - 1)
            columns = np.clip(x + across + steps, 0, len(at) - 1)
            pixels.append((at[columns], at[rows]))
            stamps.append(light[np.ix_(rows, columns)])
    return np.array(pixels), np.array(stamps)


def _fit(pixels: FloatArray, stamps: FloatArray, start: FloatArray, free: int) -> FloatArray:
    """Parameters (P, 5) x, y, variances and covariance of Gaussians, the first `free` of them and the flux fitted by
    the Gauss–Newton method."""
    fits = start.copy()
    data = stamps.reshape(len(stamps), -1)
    for _ in range(_MOST_STEPS):
        shape = _gaussian(pixels, fits)
        slopes = np.empty((free + 1, *shape.shape))
        slopes[0] = shape
        for k in range(free):
            moved = np.zeros(5)
            moved[k] = _STEP
            slopes[k + 1] = (_gaussian(pixels, fits + moved) - _gaussian(pixels, fits - moved)) / (2.0 * _STEP)
        # The flux is linear, so its best value for the current shape needs no iteration.
        flux = (shape * data).sum(axis=1) / (shape**2).sum(axis=1)
        model = flux[:, None] * shape
        weight = 1.0 / (1.0 + CONTRAST * model / model.max(axis=1, keepdims=True))
        slopes[1:] *= flux[:, None]
        normal = np.einsum("apn,pn,bpn->pab", slopes, weight, slopes)
        right = np.einsum("apn,pn,pn->pa", slopes, weight, data - model)
        # A little damping keeps the matrix regular, and the step is limited because the model is far from linear.
        normal[:, range(free + 1), range(free + 1)] *= 1.0 + 1e-9
        step = np.linalg.solve(normal, right[:, :, None])[:, 1:, 0]
        step *= np.minimum(1.0, _LONGEST_STEP_PX / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
        fits[:, :free] += step
        fits[:, 2:4] = np.maximum(fits[:, 2:4], _LEAST_VARIANCE_PX2)
        bound = 0.9 * np.sqrt(fits[:, 2] * fits[:, 3])  # the covariance matrix must remain positive definite
        fits[:, 4] = np.clip(fits[:, 4], -bound, bound)
        if np.abs(step).max() < _TOLERANCE_PX:
            break
    return fits


def _gaussian(pixels: FloatArray, fits: FloatArray) -> FloatArray:
    """Elliptical Gaussians (P, W²) integrated over pixels: exactly along x, by Gauss–Legendre quadrature along y."""
    x, y, xx, yy, xy = fits.T[:, :, None, None]
    rows = (pixels[:, 1, :, None] + 0.5 * _NODES).reshape(len(fits), -1)[:, :, None] - y
    density = np.exp(-0.5 * rows**2 / yy) / np.sqrt(2.0 * math.pi * yy)
    # For a given y, the Gaussian along x has the conditional mean x + (xy/yy) y and the variance xx − xy²/yy.
    columns = pixels[:, 0, None, :] - x - xy / yy * rows
    narrow = np.sqrt(2.0 * (xx - xy**2 / yy))
    shares = 0.5 * density * (erf((columns + 0.5) / narrow) - erf((columns - 0.5) / narrow))
    side = pixels.shape[2]
    integrals = np.einsum("prnc,n->prc", shares.reshape(len(fits), side, -1, side), 0.5 * _NODE_WEIGHTS)
    return np.asarray(integrals.reshape(len(fits), -1))
