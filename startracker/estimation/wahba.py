"""Wahba's problem, the best rotation for weighted directions: four methods with the same result.

All minimise Σ σᵢ⁻² |bᵢ − A rᵢ|², which is optimal for isotropic errors of the directions, from B = Σ wᵢ bᵢ rᵢᵀ with
Σ w = 1. They differ in speed and in numerical precision: for stars within θ of each other the two largest eigenvalues
of K differ by about 2θ², so that rounding errors are amplified by 1/θ⁴ in the characteristic polynomial and by 1/θ² in
the decompositions. A Newton step on the rotation itself (`polish`) reduces each to rounding over θ; if θ is so small
that B does not contain the rotation about the stars, it starts from the most informative pair.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray
from startracker.estimation.directions import pair_rotation
from startracker.estimation.result import Estimate, check_directions
from startracker.estimation.rotations import common_frame, covariance_of, most_telling_pair, polish

_LOST_RAD2 = 1e-10
"""Mean square angle from the common axis, rad², below which B does not determine the rotation about it."""
_NEWTON_STEPS = 40
_SMALLEST = 1e-12  # of a quaternion's squared length before it is normalised


def wahba_svd(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude by singular value decomposition (Markley 1988, J. Astronaut. Sci. 36, 245).

    With B = U S Vᵀ, A = U diag(1, 1, det U det V) Vᵀ. The result is always a proper rotation; 180° is not a special
    case.

    Parameters
    ----------
    observed, reference : array_like, shape (M, 3)
        Directions in the camera and in the catalogue's frame, M ≥ 2; normalised here.
    sigma_rad : array_like, shape (M,)
        Standard deviation of each observed direction about each cross axis, radians.

    Returns
    -------
    Estimate
        With the covariance P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ of the rotation vector, rad² (Shuster & Oh 1981; that of all
        methods that minimise this cost, Markley & Mortari 2000). It equals Markley's U diag(1/(s₂ + s₃), 1/(s₃ + s₁),
        1/(s₁ + s₂)) Uᵀ of B with the weights σᵢ⁻² except for the squares of the residuals. Nearly parallel directions
        have a large variance about their axis (1/θ² of their separation).

    Raises
    ------
    InputError
        See `startracker.estimation.result.check_directions`.
    """
    return _optimal(observed, reference, sigma_rad, _svd_rotation)


def davenport(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude by Davenport's q method (Keat 1977; Wertz 1978, section 12.2.3).

    The quaternion is the eigenvector of the largest eigenvalue of K = [[B + Bᵀ − tr B · I, z], [zᵀ, tr B]] with
    z = Σ w b × r. Parameters, result and errors as for `wahba_svd`.
    """
    return _optimal(observed, reference, sigma_rad, _davenport_rotation)


def quest(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude by QUEST (Shuster & Oh 1981, J. Guidance & Control 4, 70).

    λ by Newton's method on the characteristic quartic of K from λ = 1, which is above the largest root, so that it
    converges monotonically; then q ∝ [(αI + βS + S²) z; γ]. This vanishes at 180°: of the reference frame and the three
    rotated by 180° about an axis, the one with the largest tr B is used (method of sequential rotations), for which the
    angle is at most 120°. If Newton's method does not converge or q is short, as for two equal eigenvalues, Davenport's
    method is used. Parameters, result and errors as for `wahba_svd`.
    """
    return _optimal(observed, reference, sigma_rad, _quest_rotation)


def esoq2(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude by ESOQ2 (Mortari 1997, AAS 97-167; Markley & Mortari 2000, J. Astronaut. Sci. 48, 359).

    The Euler axis e spans the null space of (λ − tr B)((λ + tr B) I − B − Bᵀ) − z zᵀ: the longest cross product of two
    of its rows; q ∝ [(λ − tr B) e; z·e]. It is ill-conditioned for small angles, so that of the four frames of `quest`
    the one with the smallest tr B is used. λ, fallback, parameters, result and errors as there.
    """
    return _optimal(observed, reference, sigma_rad, _esoq2_rotation)


def attitude_covariance(observed: FloatArray, sigma_rad: FloatArray) -> FloatArray:
    """Covariance (3, 3), rad², of the rotation vector: P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ (Markley & Crassidis 2014, ch. 5).

    The information on the rotation about the common axis of the directions is Σ σᵢ⁻² sin², which would be lost by
    rounding in the difference I − bbᵀ; it is computed from the components perpendicular to that axis.
    """
    return np.asarray(covariance_of(np.ascontiguousarray(observed), np.ascontiguousarray(sigma_rad)))


def _optimal(
    observed: ArrayLike,
    reference: ArrayLike,
    sigma_rad: ArrayLike,
    rotation: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
) -> Estimate:
    b, r, sigma = check_directions(observed, reference, sigma_rad)
    return Estimate(rotation(b, r, sigma), covariance_of(b, sigma))


def weights_of(sigma: FloatArray) -> FloatArray:
    """Weights σ⁻² (M,), normalised to a sum of one."""
    weight: FloatArray = (sigma.min() / sigma) ** 2
    weight /= weight.sum()
    return weight


def profile_of(b: FloatArray, r: FloatArray, weight: FloatArray) -> FloatArray:
    """Attitude profile matrix B = Σ w b rᵀ (3, 3)."""
    return np.asarray((weight[:, None] * b).T @ r)


def _finish(matrix: FloatArray, b: FloatArray, r: FloatArray, sigma: FloatArray, weight: FloatArray) -> FloatArray:
    axis = common_frame(b, weight)[0]
    spread = float(weight @ (np.cross(axis, b) ** 2).sum(axis=1))
    if spread < _LOST_RAD2:
        first, second = most_telling_pair(b, sigma)
        matrix = pair_rotation(b, r, first, second)
    return polish(matrix, b, r, weight)


def fit_rotation(b: FloatArray, r: FloatArray, weight: FloatArray) -> FloatArray:
    """Proper rotation (3, 3) that minimises the weighted squares of b − R · r (Markley 1988)."""
    # Markley's diag(1, 1, det U det V): the axis of the smallest singular value changes sign.
    u, _, vt = np.linalg.svd(profile_of(b, r, weight))
    rotation: FloatArray = u @ vt
    if np.linalg.det(rotation) < 0.0:  # a reflection
        u[:, 2] *= -1.0
        rotation = u @ vt
    return rotation


def _svd_rotation(b: FloatArray, r: FloatArray, sigma: FloatArray) -> FloatArray:
    weight = weights_of(sigma)
    return _finish(fit_rotation(b, r, weight), b, r, sigma, weight)


def matrix_of(q: FloatArray) -> FloatArray:
    """Matrix (3, 3), reference to observed, of an unnormalised quaternion (4,), scalar last."""
    x, y, z, w = q / math.sqrt((q**2).sum())
    return np.array(
        [
            [x * x - y * y - z * z + w * w, 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
            [2.0 * (x * y - z * w), y * y - x * x - z * z + w * w, 2.0 * (y * z + x * w)],
            [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), z * z - x * x - y * y + w * w],
        ]
    )


def eigenvector_rotation(profile: FloatArray) -> FloatArray:
    """Davenport's rotation (3, 3) of a profile matrix B."""
    k = np.empty((4, 4))
    k[:3, :3] = profile + profile.T - np.trace(profile) * np.eye(3)
    k[3, :3] = k[:3, 3] = _axial(profile)
    k[3, 3] = np.trace(profile)
    return matrix_of(np.linalg.eigh(k)[1][:, 3])


def _axial(profile: FloatArray) -> FloatArray:
    """z = Σ w b × r (3,), from the profile matrix."""
    difference = profile - profile.T
    return np.array([difference[1, 2], difference[2, 0], difference[0, 1]])


def _davenport_rotation(b: FloatArray, r: FloatArray, sigma: FloatArray) -> FloatArray:
    weight = weights_of(sigma)
    return _finish(eigenvector_rotation(profile_of(b, r, weight)), b, r, sigma, weight)


def _turned_reference(matrix: FloatArray, axis: int) -> FloatArray:
    """The reference frame rotated by 180° about an axis (−1: none): two columns change sign."""
    return matrix if axis < 0 else matrix * np.where(np.arange(3) == axis, 1.0, -1.0)


def largest_eigenvalue(profile: FloatArray) -> tuple[float, bool]:
    """Largest root of the characteristic quartic of K, and whether Newton's method converged.

    λ⁴ − (a + b) λ² − c λ + (ab + cσ − d) = 0 with Shuster & Oh's a, b, c, d.
    """
    s, z = profile + profile.T, _axial(profile)
    sigma, kappa, delta, t = float(np.trace(profile)), _kappa(s), float(np.linalg.det(s)), s @ z
    a = sigma**2 - kappa
    b, c, d = sigma**2 + float(z @ z), delta + float(z @ t), float(t @ t)
    constant = a * b + c * sigma - d
    value = 1.0
    for _ in range(_NEWTON_STEPS):
        slope = (4.0 * value**2 - 2.0 * (a + b)) * value - c
        if not slope > 0.0:
            return value, False
        step = ((value**2 - (a + b)) * value**2 - c * value + constant) / slope
        value -= step
        if abs(step) < 1e-15 or step < 0.0:  # from above every step is negative, except for rounding
            return value, abs(step) < 1e-6
    return value, False


def _kappa(s: FloatArray) -> float:
    """Trace of the adjugate of a symmetric matrix (3, 3)."""
    return 0.5 * float(np.trace(s) ** 2 - (s**2).sum())


def _quest_rotation(b: FloatArray, r: FloatArray, sigma: FloatArray) -> FloatArray:
    weight = weights_of(sigma)
    profile = profile_of(b, r, weight)
    # Of the reference frame and the three rotated by 180°, the one with the largest trace, for the smallest rotation.
    axis = int(np.argmax([np.trace(profile), *profile.diagonal()])) - 1
    profile = _turned_reference(profile, axis)
    value, settled = largest_eigenvalue(profile)
    s, z, trace = profile + profile.T, _axial(profile), float(np.trace(profile))
    alpha, beta = value**2 - trace**2 + _kappa(s), value - trace
    sz = s @ z
    q = np.append(alpha * z + beta * sz + s @ sz, (value + trace) * alpha - np.linalg.det(s))
    matrix = matrix_of(q) if settled and q @ q > _SMALLEST else eigenvector_rotation(profile)
    return _finish(_turned_reference(matrix, axis), b, r, sigma, weight)


def _esoq2_rotation(b: FloatArray, r: FloatArray, sigma: FloatArray) -> FloatArray:
    weight = weights_of(sigma)
    profile = profile_of(b, r, weight)
    # The opposite choice to QUEST: the largest rotation, for which ESOQ2 is well conditioned.
    axis = int(np.argmin([np.trace(profile), *profile.diagonal()])) - 1
    profile = _turned_reference(profile, axis)
    value, settled = largest_eigenvalue(profile)
    z, trace = _axial(profile), float(np.trace(profile))
    m = (value**2 - trace**2) * np.eye(3) - (value - trace) * (profile + profile.T) - np.outer(z, z)
    products = np.cross(m[[1, 2, 0]], m[[2, 0, 1]])
    e = products[np.argmax((products**2).sum(axis=1))]
    if settled and e @ e > _SMALLEST:
        e = e / math.sqrt(e @ e)
        matrix = matrix_of(np.append((value - trace) * e, z @ e))
    else:
        matrix = eigenvector_rotation(profile)
    return _finish(_turned_reference(matrix, axis), b, r, sigma, weight)
