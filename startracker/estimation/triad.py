"""Attitude from two directions (Black 1964)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from startracker.estimation.directions import pair_frame, pair_rotation
from startracker.estimation.result import Estimate, check_directions
from startracker.estimation.rotations import most_telling_pair


def triad(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude by TRIAD (Black 1964, AIAA J. 2, 1350), from the two stars with the most information.

    The first star is mapped exactly to its image, the second only to the great circle: A = M_b M_rᵀ with the columns of
    M the first direction, the pole of both, and their cross product. Of all ordered pairs (with the more accurate star
    first) the one with the smallest trace of the covariance is used; other stars are not used. (The symmetric variant
    with coincident midpoints is `star_pair`.)

    Parameters
    ----------
    observed, reference : array_like, shape (M, 3)
        Directions in the camera and in the catalogue's frame, M ≥ 2; normalised here.
    sigma_rad : array_like, shape (M,)
        Standard deviation of each observed direction about each cross axis, radians.

    Returns
    -------
    Estimate
        Covariance to first order, with θ the separation (Shuster & Oh 1981): σ₁² about both axes perpendicular to the
        first star; (σ₂² + σ₁² cos²θ)/sin²θ about it; correlated with the axis from it towards the second by σ₁² cot θ.

    Raises
    ------
    InputError
        See `startracker.estimation.result.check_directions`.
    """
    b, r, sigma = check_directions(observed, reference, sigma_rad)
    first, second = most_telling_pair(b, sigma)
    sine, cosine = float(np.linalg.norm(np.cross(b[first], b[second]))), float(b[first] @ b[second])
    one, two = sigma[first] ** 2, sigma[second] ** 2
    along = one * cosine / sine
    inner = np.array([[(two + one * cosine**2) / sine**2, 0.0, along], [0.0, one, 0.0], [along, 0.0, one]])
    frame = pair_frame(b[first], b[second])
    return Estimate(pair_rotation(b, r, first, second), frame @ inner @ frame.T)
