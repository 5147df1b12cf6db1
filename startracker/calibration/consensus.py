"""Consistency of the images of a calibration: duplicates, and images with a different focal length.

The focal length is estimated from each image alone with the other lens parameters fixed (one unknown in addition to the
attitude), so that its standard error is small. Images that differ from the median of the majority by more than that
error, and by more than refraction explains, were taken at another zoom or focus, or are misidentified; they are
reported and excluded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.calibration.field import StarField
from startracker.core import FloatArray
from startracker.geometry.camera import Camera
from startracker.geometry.lens_fit import Matches, fit_jointly, rescaled

_SIGMAS = 5.0
_TOLERANCE = 6e-4
"""Largest relative difference of focal lengths. Refraction shortens a field by κ sec²z on the mean of both axes, κ =
58.3″ = 2.8e-4, so that images at altitudes of 40° and more differ by up to 4e-4."""
_FIRST_TOLERANCE = 4e-3
"""The same before the lens is known: unmodelled distortion changes an image's focal length depending on its stars."""
_SAME_PX = 1e-3
"""Distance, px, below which centroids are copies: those of two exposures differ by their noise, those of a copied file
do not, even if its header was modified."""
_SAME_SHARE = 0.9


class FocalLengths(NamedTuple):
    """Focal length of each image alone, relative to a camera's."""

    log_factor: FloatArray
    sigma: FloatArray
    """Natural logarithm of the factor, and its standard error from the image's own residuals, (I,); infinite if the fit
    failed."""


def focal_lengths(camera: Camera, matrices: Sequence[FloatArray], matches: Sequence[Matches]) -> FocalLengths:
    """Focal length of each image, with all other parameters of the lens as in `camera`."""
    log_factor, sigma = np.zeros(len(matches)), np.full(len(matches), np.inf)
    for i, (matrix, one) in enumerate(zip(matrices, matches, strict=True)):
        fit = fit_jointly(camera, [matrix], [one], ("f",)) if len(one.xy) > 3 else None
        if fit is not None:
            log_factor[i] = math.log(fit.camera.fx / camera.fx)
            sigma[i] = math.sqrt(rescaled(fit, [one], with_refraction=False)[0, 0])
    return FocalLengths(log_factor, sigma)


def agreeing(found: FocalLengths, among: NDArray[np.bool_], *, lens_known: bool) -> NDArray[np.bool_]:
    """Mask (I,) of the images whose focal length agrees with the median of those in `among`."""
    usable = np.isfinite(found.sigma) & among
    if not usable.any():
        return usable
    off = np.abs(found.log_factor - np.median(found.log_factor[usable]))
    tolerance = _TOLERANCE if lens_known else _FIRST_TOLERANCE
    return np.isfinite(found.sigma) & (off <= np.maximum(_SIGMAS * found.sigma, tolerance))


def repeated(fields: Sequence[StarField]) -> dict[int, int]:
    """Indices of images with the same centroids as an earlier one, and the index of that image."""
    same: dict[int, int] = {}
    for later in range(len(fields)):
        for first in range(later):
            if first not in same and _is_copy(fields[first].xy, fields[later].xy):
                same[later] = first
                break
    return same


def _is_copy(one: FloatArray, other: FloatArray) -> bool:
    if not len(one) or abs(len(one) - len(other)) > (1.0 - _SAME_SHARE) * len(one):
        return False
    from scipy.spatial import KDTree

    nearest, _ = KDTree(one).query(other)
    return bool(np.mean(nearest < _SAME_PX) >= _SAME_SHARE)
