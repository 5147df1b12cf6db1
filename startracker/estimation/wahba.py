"""Wahba's problem: the rotation that fits weighted directions best."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.estimation.result import Estimate, check_directions

__all__ = ["attitude_covariance", "wahba_svd"]

FloatArray = NDArray[np.float64]


def wahba_svd(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude by singular value decomposition (Markley 1988, J. Astronaut. Sci. 36, 245).

    Minimises Σ σᵢ⁻² |bᵢ − A rᵢ|²: with B = Σ σᵢ⁻² bᵢ rᵢᵀ = U S Vᵀ, A = U diag(1, 1, det U det V) Vᵀ. The result is
    always a proper rotation; 180° is no special case. Optimal for isotropic errors of the directions.

    Parameters
    ----------
    observed, reference : array_like, shape (M, 3)
        Directions in the camera and in the catalogue's frame, M ≥ 2; normalised here.
    sigma_rad : array_like, shape (M,)
        Standard deviation of each observed direction about each cross axis, radians.

    Returns
    -------
    Estimate
        With the covariance P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ of the rotation vector, rad². Nearly parallel directions give
        it a large entry about their axis (1/θ² of their separation).

    Raises
    ------
    InputError
        See `startracker.estimation.result.check_directions`.
    """
    b, r, sigma = check_directions(observed, reference, sigma_rad)
    weight = (sigma.min() / sigma) ** 2
    u, _, vt = np.linalg.svd((weight[:, None] * b).T @ r)
    sign = 1.0 if np.linalg.det(u) * np.linalg.det(vt) > 0 else -1.0
    matrix = (u * np.array([1.0, 1.0, sign])) @ vt
    return Estimate(matrix, attitude_covariance(b, sigma))


def attitude_covariance(observed: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """Covariance (3, 3), rad², of the rotation vector: P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ (Markley & Crassidis 2014, ch. 5).

    The information about the turn along the directions' common axis is Σ σᵢ⁻² sin², which the difference I − bbᵀ would
    lose to rounding; in the principal axes of Σ σᵢ⁻² bᵢ bᵢᵀ it is summed from the components across that axis.
    """
    root = observed / sigma_rad[:, None]
    axes = np.linalg.svd(root, full_matrices=True)[2]
    squares = ((root @ axes.T) ** 2).sum(axis=0)
    information = np.array([squares[1] + squares[2], squares[0] + squares[2], squares[0] + squares[1]])
    return np.asarray((axes.T / information) @ axes)
