"""Errors of positions that depend on where in its pixel a star lies: of images narrower than a pixel, or of another
shape than the fitted one.

On each axis such an error is a periodic function of the position in the pixel, whose mean a calibrated camera does not
have (Anderson & King 2000, PASP 112, 1360, section 2). Two harmonics are fitted to a frame's residuals. They are
functions of the measured position, not of the predicted one, which an error of the attitude would move along: the model
stays linear, and the covariance true. Their mean over measured positions is zero where that over true ones is, as the
integral of f f' over a period is zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["HARMONIC_SIGMA", "phase_columns", "phase_shift", "shared_shift"]

FloatArray = NDArray[np.float64]

HARMONIC_SIGMA = np.tile([1.4, 1.4, 0.7, 0.7], 2)
"""Standard deviation of the amplitudes beforehand (8,), in units of the systematic error that the frame shows."""
_HARMONICS = 2
_SHARED_PART = 0.1
"""Shift of all stars over the amplitude of the cosines, as measured for coma in and out of focus."""


def phase_columns(xy: FloatArray) -> FloatArray:
    """Displacements (N, 2, 8) by sine and cosine of each harmonic, first of x, then of y, at measured positions."""
    out = np.zeros((len(xy), 2, 4 * _HARMONICS))
    for axis in range(2):
        for k in range(_HARMONICS):
            angle, column = 2.0 * np.pi * (k + 1) * xy[:, axis], 2 * (_HARMONICS * axis + k)
            out[:, axis, column], out[:, axis, column + 1] = np.sin(angle), np.cos(angle)
    return out


def phase_shift(xy: FloatArray, amplitudes: FloatArray) -> FloatArray:
    """Error (N, 2) of measured positions, pixels; no amplitudes: none."""
    return np.asarray(phase_columns(xy) @ amplitudes) if len(amplitudes) else np.zeros_like(xy)


def shared_shift(amplitudes: FloatArray) -> FloatArray:
    """Covariance (2, 2) of the shift of all stars that goes with the cosines, px².

    A symmetric image has sines alone. The skewness that makes the cosines also moves all stars, faint ones otherwise
    than those that a calibration rests upon, and no residual of the positions shows it.
    """
    cosines = amplitudes.reshape(2, _HARMONICS, 2)[:, :, 1] if len(amplitudes) else np.zeros((2, 1))
    return np.diag(_SHARED_PART**2 * (cosines**2).sum(axis=1))
