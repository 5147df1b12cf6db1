"""The weighted fit of the whole field as an estimator, and the protocol by which an estimator receives it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeAlias, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray
from startracker.estimation.directions import fit_pairs
from startracker.estimation.result import Estimate, check_directions
from startracker.estimation.rotations import covariance_of, polish
from startracker.estimation.wahba import fit_rotation, weights_of

Estimator: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], Estimate]
"""Signature of an estimator: observed (M, 3), reference (M, 3), sigma_rad (M,)."""


class FieldFit(NamedTuple):
    """Fit of a field in pixels (`startracker.estimation.pose`), with which all stars were matched."""

    matrix: FloatArray
    """ICRS to camera, (3, 3)."""
    covariance: FloatArray
    """Covariance of the rotation vector of the error in camera axes, rad², (3, 3), with the part of the unknown errors
    of the camera."""


class FieldEstimator(Protocol):
    """An estimator with a fourth parameter, `field`."""

    def __call__(
        self, observed: FloatArray, reference: FloatArray, sigma_rad: FloatArray, *, field: FieldFit
    ) -> Estimate:
        """Attitude with its full covariance: nothing is added for the camera."""


def takes_field(estimator: Estimator) -> TypeGuard[FieldEstimator]:
    """Whether an estimator has a parameter `field`, for the `FieldFit` of the stars."""
    try:
        return "field" in inspect.signature(estimator).parameters
    except (TypeError, ValueError):  # a compiled function that does not state its parameters
        return False


def field_fit(
    observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike, *, field: FieldFit | None = None
) -> Estimate:
    """Attitude by the weighted least-squares fit of the field, the default of `StarTracker`.

    In a tracker it is the fit with which the stars were matched (`startracker.estimation.pose`): residuals in pixels,
    weighted with the full covariance of each centroid, together with deviations of the camera from its calibration. It
    differs from a solution of Wahba's problem where the two axes of a centroid have different errors (trails), where a
    pixel does not subtend the same angle in all directions (wide fields), and where focal length or shear deviate.

    Parameters
    ----------
    observed, reference : array_like, shape (M, 3)
        Directions in the camera and in the catalogue's frame, M ≥ 2; normalised here.
    sigma_rad : array_like, shape (M,)
        Standard deviation of each observed direction about each cross axis, radians.
    field : FieldFit, optional
        The fit of these stars in pixels. Without it the directions alone are fitted by Gauss–Newton steps, which
        minimises Σ σᵢ⁻² |bᵢ − A rᵢ|² as `wahba_svd` does.

    Returns
    -------
    Estimate
        The fit `field`; from directions alone, with the covariance P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹, rad².

    Raises
    ------
    InputError
        Without `field`: see `startracker.estimation.result.check_directions`.
    """
    if field is not None:
        return Estimate(field.matrix, field.covariance)
    b, r, sigma = check_directions(observed, reference, sigma_rad)
    rows, weight = np.arange(len(b)), weights_of(sigma)
    matrix, _ = fit_pairs(np.stack([rows, rows], axis=1), b, r, sigma, np.zeros((3, 3)))
    # The patterns may differ too much for small corrections, so the closed solution is used.
    if not np.isfinite(matrix).all():
        matrix = fit_rotation(b, r, weight)
    return Estimate(polish(matrix, b, r, weight), covariance_of(b, sigma))
