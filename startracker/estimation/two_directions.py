"""Attitude from two directions: TRIAD (Black 1964), and one pair of stars (Greyling 1995, section 5.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray
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


def pitch_error_deg(dx_deg: ArrayLike, dy_deg: ArrayLike, accuracy_deg: ArrayLike) -> FloatArray:
    """Maximum error of the angle of the line through two stars: Greyling 1995, eq. 5.13.

    θ_err = atan((y + 2δ) / (x − 2δ)) − atan((y − 2δ) / (x + 2δ)), with x, y the separation along the two axes and δ the
    accuracy of a star's position on each axis.

    Parameters
    ----------
    dx_deg, dy_deg : array_like
        Separation of the stars along columns and rows, degrees, ≥ 0.
    accuracy_deg : array_like
        Accuracy δ, degrees.

    Returns
    -------
    array
        Degrees. With δ = 0.002°: 0.0458° for stars 10° apart along both axes, 7.628° for 0.06° (three pixels);
        0.286° is met from 1.6027° on.
    """
    x, y, slack = np.asarray(dx_deg, float), np.asarray(dy_deg, float), 2.0 * np.asarray(accuracy_deg, float)
    return np.asarray(np.degrees(np.arctan2(y + slack, x - slack) - np.arctan2(y - slack, x + slack)))


def star_pair(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude from the pair of stars with the most accurate line.

    The pair with the smallest `pitch_error_deg` is used: the widest one for equal errors. Greyling rotates the plane of
    the sky by θ = ρ − ξ, the difference between the angles of the line in the image and in the catalogue (eqs. 5.6 to
    5.8, its pitch), and then shifts it until the stars coincide (eqs. 5.9 to 5.12, its roll and yaw). On the sphere
    this is the rotation that maps the great circle through the two catalogue stars to that through the two observed
    stars, with coincident midpoints: A = M_b M_rᵀ, with the columns of M the midpoint (b₁ + b₂), the difference (b₂ −
    b₁) and their cross product, all normalised. This does not need small angles or a plane, and is independent of the
    error of the separation. Other stars are not used.

    Parameters
    ----------
    observed, reference : array_like, shape (M, 3)
        Directions in the camera and in the catalogue's frame, M ≥ 2.
    sigma_rad : array_like, shape (M,)
        Standard deviation of each observed direction about each cross axis, radians.

    Returns
    -------
    Estimate
        Covariance to first order: about the pair's pole (σ₁² + σ₂²)/4; about the difference (σ₁² + σ₂²)/(4 cos² h);
        about its midpoint (σ₁² + σ₂²)/(4 sin² h), with h half the separation; the last two correlated by (σ₁² − σ₂²)/(2
        sin 2h).

    Raises
    ------
    InputError
        See `startracker.estimation.result.check_directions`.
    """
    b, r, sigma = check_directions(observed, reference, sigma_rad)
    first, second = _best_pair(b, sigma)
    frame_b, frame_r = _pair_frame(b[first], b[second]), _pair_frame(r[first], r[second])
    half = 0.5 * float(np.arctan2(np.linalg.norm(np.cross(b[first], b[second])), b[first] @ b[second]))
    var_1, var_2 = sigma[first] ** 2, sigma[second] ** 2
    cosine, sine = np.cos(half), np.sin(half)
    along = (var_1 - var_2) / (4.0 * cosine * sine)
    total = 0.25 * (var_1 + var_2)
    covariance = np.array([[total / sine**2, along, 0.0], [along, total / cosine**2, 0.0], [0.0, 0.0, total]])
    return Estimate(frame_b @ frame_r.T, frame_b @ covariance @ frame_b.T)


def _best_pair(b: FloatArray, sigma: FloatArray) -> tuple[int, int]:
    """Indices of the pair with the smallest error of the line's angle, with the separation taken along the diagonal."""
    first, second = np.triu_indices(len(b), 1)
    # The sine is used because opposite directions lie along one axis and are as unsuitable as equal ones.
    side = np.sqrt(0.5) * np.linalg.norm(np.cross(b[first], b[second]), axis=1)
    slack = 2.0 * np.sqrt(0.5 * (sigma[first] ** 2 + sigma[second] ** 2))
    best = np.argmin(np.arctan2(side + slack, side - slack) - np.arctan2(side - slack, side + slack))
    return int(first[best]), int(second[best])


def _pair_frame(one: FloatArray, two: FloatArray) -> FloatArray:
    """Matrix (3, 3) with the columns midpoint, difference, and pole, as unit vectors."""
    middle, way = one + two, two - one
    middle, way = middle / np.linalg.norm(middle), way / np.linalg.norm(way)
    # The two are perpendicular for exact unit vectors, but not after rounding.
    way -= middle * (middle @ way)
    way /= np.linalg.norm(way)
    return np.stack([middle, way, np.cross(middle, way)], axis=1)
