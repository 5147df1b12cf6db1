"""Position errors common to the whole field, for star images that differ from the fitted ones: as a function of the
sub-pixel position, and along the field radius.

The first are errors of images narrower than a pixel, or with another shape than the fitted one. On each axis such an
error is a periodic function of the sub-pixel position, with zero mean for a calibrated camera (Anderson & King 2000,
PASP 112, 1360, section 2). Two harmonics are fitted to the residuals. They are functions of the measured position, not
of the predicted one, which depends on the attitude error: the model remains linear and the covariance correct. Their
mean over measured positions is zero if that over true positions is, as the integral of f f' over a period is zero.

The second is due to aberrations that increase with the distance from the axis: they displace images along the radius,
differently for bright stars than for those of the calibration. Together with the focal length, which is always fitted,
r³ gives its lowest terms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.camera import Camera
from startracker.geometry.image_map import pixel_slopes

AS_ASSUMED = 0.5
"""Prior probability that star images are as assumed, without systematic error."""
_WRONG_MISFIT = 20.0
"""Mean misfit (`startracker.centroid.result.misfit_of_brightest`) of star images of another shape than the fitted."""
_HARMONICS = 2
AMPLITUDE_SIGMA = np.array([*np.tile([1.4, 1.4, 0.7, 0.7], 2), 3.0])
"""Prior standard deviations (9,) of the amplitudes, in units of the systematic error of the frame; the last is that at
the corners."""
_SHARED_PART = 0.1
"""Ratio of the common shift of all stars to the amplitude of the cosines, measured for coma in and out of focus."""
_UNCERTAIN = 0.4
"""Part of that shift that remains uncertain where star images show it, as in `startracker.centroid.asymmetry`."""


class ImageErrors(NamedTuple):
    """Amplitudes (9,) of the columns of `error_columns`, pixels, and their variances (9,); both empty if not fitted."""

    amplitudes: FloatArray
    variance: FloatArray


NO_IMAGE_ERRORS = ImageErrors(np.zeros(0), np.zeros(0))


def error_columns(xy: FloatArray, field: FloatArray) -> FloatArray:
    """Displacements (N, 2, 9): sine and cosine of each harmonic of x, of y, and the radial one, 1 at the corners.

    Parameters
    ----------
    xy : (N, 2)
        Measured positions, pixels.
    field : (N, 2)
        The same from the principal point, in units of half the diagonal of the image.
    """
    out = np.zeros((len(xy), 2, 4 * _HARMONICS + 1))
    for axis in range(2):
        for k in range(_HARMONICS):
            angle, column = 2.0 * np.pi * (k + 1) * xy[:, axis], 2 * (_HARMONICS * axis + k)
            out[:, axis, column], out[:, axis, column + 1] = np.sin(angle), np.cos(angle)
    out[:, :, -1] = field * np.sum(field**2, axis=1)[:, None]
    return out


def shared_shift(errors: ImageErrors, measured: bool) -> FloatArray:
    """Covariance (2, 2) of the common shift of all stars associated with the cosines, px².

    A symmetric image only has sines. The skewness that causes the cosines also displaces all stars, faint ones
    differently than those of a calibration, without residuals. The variances are subtracted from the squares of the
    amplitudes, as noise and skewness that varies over the field cause no common displacement.

    Parameters
    ----------
    errors : ImageErrors
    measured : bool
        Whether star images have shown the displacement, so that it was subtracted, or is in the covariance
        (`startracker.centroid.asymmetry`, `startracker.centroid.skewness`).
    """
    if not len(errors.amplitudes):
        return np.zeros((2, 2))
    squares = (errors.amplitudes**2 - errors.variance)[: 4 * _HARMONICS].reshape(2, _HARMONICS, 2)[:, :, 1]
    part = _UNCERTAIN * _SHARED_PART if measured else _SHARED_PART
    return np.diag(part**2 * np.maximum(squares.sum(axis=1), 0.0))


def probability_as_assumed(misfit: float | None) -> float:
    """Probability that star images are as assumed, so that there is no τ (`pose`), from the misfit of the brightest.

    If they are, the misfit is a Gaussian deviate; otherwise it is exponentially distributed, plus the same noise.

    Parameters
    ----------
    misfit : float or None
        `startracker.centroid.result.misfit_of_brightest`; None if unknown.
    """
    if misfit is None:
        return AS_ASSUMED
    misfit = max(misfit, -5.0)  # the stated noise may be too large
    clean = math.exp(-0.5 * misfit**2) / math.sqrt(2.0 * math.pi)
    # Convolution of an exponential distribution of mean `_WRONG_MISFIT` with a unit Gaussian.
    beyond = 0.5 * math.erfc((1.0 / _WRONG_MISFIT - misfit) / math.sqrt(2.0))
    wrong = math.exp(0.5 / _WRONG_MISFIT**2 - misfit / _WRONG_MISFIT) * beyond / _WRONG_MISFIT
    part = AS_ASSUMED * clean
    return min(max(part / max(part + (1.0 - AS_ASSUMED) * wrong, 1e-300), 1e-6), 1.0 - 1e-6)


def rotation_of_shift(covariance_px2: FloatArray, camera: Camera) -> FloatArray:
    """Covariance (3, 3) of the rotation vector, rad², of an error of the position common to all stars, (2, 2) px²."""
    # The pseudo-inverse selects the smallest rotation for a shift; the roll stays undetermined, and is zero.
    turn_per_px = np.linalg.pinv(pixel_slopes(np.array([[0.0, 0.0, 1.0]]), camera.image_map)[0])
    covariance: FloatArray = turn_per_px @ covariance_px2 @ turn_per_px.T
    return covariance
