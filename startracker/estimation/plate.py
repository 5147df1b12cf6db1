"""Plate constants (Yee 1999, section 2.4): a linear map from image to standard coordinates, and the image's centre.

Standard coordinates are the gnomonic projection of the sky onto the plane tangent to it at the centre, ξ east and η
north. For a plane image they are linear in its coordinates, for any scale, rotation, parity and shear; the centre is
the point for which the origin maps to (0, 0), found by iteration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.estimation.result import Estimate, check_directions
from startracker.estimation.rotations import normalised

_TOO_WIDE = "plate constants need directions within 78° of their mean; use another estimator"
_NO_PLATE = "the reference directions do not match the observed ones: check the identification"
_ROUNDS = 50
_SETTLED_RAD = 1e-13
_LINE = 1e-6
"""Ratio of the second moments across and along below which stars are collinear and plate constants undetermined."""
_SLENDER = 1e-3
"""The same ratio below which the attitude is taken from scale and rotation alone: the shear would be noise."""


@dataclass(frozen=True, eq=False)
class Plate:
    """A photograph's plate constants."""

    center_deg: FloatArray
    """Right ascension and declination of the image's origin, (2,)."""
    tangent_deg: FloatArray
    """Tangent point of the standard coordinates, (2,): the centre before the last iteration."""
    matrix: FloatArray
    offset: FloatArray
    """(ξ, η) = matrix @ (x, y) + offset, in radians, (2, 2), (2,); negative determinant for an image as seen on the sky
    with y up."""
    residual_deg: FloatArray
    """Computed minus catalogue right ascension and declination of each star, (M, 2)."""
    iterations: int

    __repr__ = fields_repr

    @property
    def constants(self) -> FloatArray:
        """Yee's a, b, c, d, e, f (6,): ξ − x = ax + by + c, η − y = dx + ey + f (eqs. 2.8, 2.9)."""
        (a, b), (d, e) = self.matrix - np.eye(2)
        return np.array([a, b, self.offset[0], d, e, self.offset[1]])

    def sky_deg(self, xy: ArrayLike) -> FloatArray:
        """Right ascension in [0, 360) and declination (..., 2) of points (..., 2) of the image, degrees."""
        standard = np.asarray(xy, dtype=float) @ self.matrix.T + self.offset
        return _from_standard(standard, self.tangent_deg)

    def image_xy(self, sky_deg: ArrayLike) -> FloatArray:
        """Points (M, 2) of the image for right ascension and declination (M, 2), degrees: the inverse of `sky_deg`.

        Raises
        ------
        InputError
            For directions 90° or more from the centre.
        """
        standard = _to_standard(np.asarray(sky_deg, dtype=float), self.tangent_deg) - self.offset
        return np.asarray(np.linalg.solve(self.matrix, standard.T).T)


def solve_plate(xy: ArrayLike, sky_deg: ArrayLike, tolerance_deg: float = 1.0 / 3600.0) -> Plate:
    """Centre and plate constants of a photograph from identified stars (Yee 1999, section 2.4.3).

    Parameters
    ----------
    xy : array_like, shape (M, 2)
        Centroids, the origin at the centre of the image; any unit, any orientation, M ≥ 3 not collinear.
    sky_deg : array_like, shape (M, 2)
        Right ascension and declination of each, degrees.
    tolerance_deg : float
        The iteration ends if neither coordinate of the centre changes by more.

    Raises
    ------
    InputError
        For inconsistent shapes, values that are not finite, fewer than three stars, stars that are collinear or 90°
        from the centre, or an iteration that does not converge.
    """
    image, sky = np.array(xy, dtype=float), np.array(sky_deg, dtype=float)
    if image.ndim != 2 or image.shape[1] != 2 or image.shape != sky.shape:
        raise InputError(f"image and sky coordinates must both be (M, 2); got {image.shape} and {sky.shape}")
    if len(image) < 3:
        raise InputError(f"plate constants need three stars; got {len(image)}")
    if not (np.isfinite(image).all() and np.isfinite(sky).all()):
        raise InputError("image and sky coordinates must be finite")
    design = np.column_stack([image, np.ones(len(image))])
    moments = np.linalg.eigvalsh(np.cov(image.T))
    if not moments[0] > _LINE * moments[1]:
        raise InputError("plate constants need three stars that are not collinear")
    center = first_center_deg(image, sky)
    iterations = 0
    for _ in range(_ROUNDS):
        iterations += 1
        tangent = center
        standard = _to_standard(sky, tangent)
        solution = np.linalg.lstsq(design, standard, rcond=None)[0]
        center = _from_standard(solution[2], tangent)
        moved = np.abs(center - tangent)
        # The difference in right ascension is taken along the shorter arc.
        moved[0] = min(moved[0], 360.0 - moved[0])
        if moved.max() <= tolerance_deg:
            break
    else:
        raise InputError(
            f"the centre does not converge (last change {moved.max():.3g}° after {_ROUNDS} iterations): check the stars"
        )
    computed = _from_standard(design @ solution, tangent)
    residual = computed - sky
    residual[:, 0] = (residual[:, 0] + 180.0) % 360.0 - 180.0
    return Plate(center, tangent, solution[:2].T.copy(), solution[2].copy(), residual, iterations)


def first_center_deg(xy: FloatArray, sky_deg: FloatArray) -> FloatArray:
    """Initial centre (2,), degrees: the mean of linear fits of each coordinate to x and to y.

    Right ascensions are unwrapped about their circular mean. Near the poles, where linear fits are poor, the mean
    direction of the stars is used instead.
    """
    ra, dec = np.radians(sky_deg[:, 0]), np.radians(sky_deg[:, 1])
    vectors = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    mean = vectors.mean(axis=0)
    middle = math.degrees(math.atan2(mean[1], mean[0]))
    unwrapped = middle + (sky_deg[:, 0] - middle + 180.0) % 360.0 - 180.0
    at_zero = [
        np.mean([np.polynomial.Polynomial.fit(axis, values, 1)(0.0) for axis in xy.T if np.ptp(axis) > 0])
        for values in (unwrapped, sky_deg[:, 1])
    ]
    guess = np.array([at_zero[0] % 360.0, at_zero[1]])
    east = np.radians(guess)
    towards = np.array(
        [math.cos(east[1]) * math.cos(east[0]), math.cos(east[1]) * math.sin(east[0]), math.sin(east[1])]
    )
    if abs(guess[1]) > 85.0 or (vectors @ towards).min() < 0.2:
        return np.array([middle % 360.0, math.degrees(math.atan2(mean[2], math.hypot(mean[0], mean[1])))])
    return guess


def _to_standard(sky_deg: FloatArray, tangent_deg: FloatArray) -> FloatArray:
    """Standard coordinates of right ascension and declination, eqs. 2.16 and 2.17."""
    turn, dec = np.radians(sky_deg[:, 0] - tangent_deg[0]), np.radians(sky_deg[:, 1])
    sine, cosine = math.sin(math.radians(tangent_deg[1])), math.cos(math.radians(tangent_deg[1]))
    depth = sine * np.sin(dec) + cosine * np.cos(dec) * np.cos(turn)
    if not (depth > 0.0).all():
        raise InputError("plate constants need stars less than 90° from the centre of the image")
    return np.column_stack(
        [np.cos(dec) * np.sin(turn) / depth, (cosine * np.sin(dec) - sine * np.cos(dec) * np.cos(turn)) / depth]
    )


def _from_standard(standard: FloatArray, tangent_deg: FloatArray) -> FloatArray:
    """Right ascension and declination of standard coordinates, eqs. 2.18 and 2.19, valid in every quadrant."""
    xi, eta = standard[..., 0], standard[..., 1]
    sine, cosine = math.sin(math.radians(tangent_deg[1])), math.cos(math.radians(tangent_deg[1]))
    inward = cosine - eta * sine
    ra = tangent_deg[0] + np.degrees(np.arctan2(xi, inward))
    dec = np.degrees(np.arctan2(sine + eta * cosine, np.hypot(xi, inward)))
    return np.stack([ra % 360.0, dec], axis=-1)


def plate_constants(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Estimate:
    """Attitude by plate constants (Yee 1999, section 2.4), on the sphere.

    The image plane is tangent at the weighted mean of the observed directions; the fit is weighted by 1/σ². The centre
    is iterated to convergence. The attitude is the rotation closest to the plate's 2 × 2 matrix; scale and shear, which
    are free, are discarded: the result is independent of the focal length, with some loss of accuracy. For two stars,
    or nearly collinear ones, only a scale and a rotation are fitted (four constants).

    Parameters
    ----------
    observed, reference : array_like, shape (M, 3)
        Directions in the camera and in the catalogue's frame, M ≥ 2; normalised here.
    sigma_rad : array_like, shape (M,)
        Standard deviation of each observed direction about each cross axis, radians.

    Returns
    -------
    Estimate
        With the covariance of these linear fits, rad², which is never smaller than `wahba_svd` states.

    Raises
    ------
    InputError
        See `startracker.estimation.result.check_directions`; also for stars 78° or more from their mean direction, and
        for stars that do not match.
    """
    b, r, sigma = check_directions(observed, reference, sigma_rad)
    weight = (sigma.min() / sigma) ** 2
    weight /= weight.sum()
    mean_b, mean_r = weight @ b, weight @ r
    if not (mean_b @ mean_b > 1e-6 and mean_r @ mean_r > 1e-6):
        raise InputError(_TOO_WIDE)
    axes_b, axes_r = _tangent_axes(mean_b), _tangent_axes(mean_r)
    x = _project(axes_b, b)
    if x is None:
        raise InputError(_TOO_WIDE)
    middle, along, full = _lever_arms(x, weight)
    matrix, last = np.eye(2), np.inf
    for _ in range(_ROUNDS):
        sky = _project(axes_r, r)
        if sky is None:
            raise InputError(_NO_PLATE)
        centre = weight @ sky
        matrix = (sky - centre).T @ along
        if not full:
            same, other = matrix[0, 0] + matrix[1, 1], matrix[1, 0] - matrix[0, 1]
            # The part of the matrix that is a similarity: one scale and one rotation.
            matrix = np.array([[same, -other], [other, same]])
        offset = centre - matrix @ middle
        size = float(np.hypot(*offset))
        # A step that is not half as long as the one before shows that only rounding is left.
        if size < _SETTLED_RAD or (size < 1e-9 and size >= 0.5 * last):
            break
        last = size
        axes_r = _tangent_axes(axes_r[2] + offset @ axes_r[:2])
    swing, reach = matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1]
    length = math.hypot(swing, reach)
    # A mirror image, or stars that do not match, cannot be mapped by a rotation.
    if not (size < 1e-7 and length > 0.1 and np.linalg.det(matrix) > 0.0):
        raise InputError(_NO_PLATE)
    c, s = reach / length, swing / length
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ axes_b
    inner = _plate_covariance(x, sigma, weight, along, middle, full)
    return Estimate(turned.T @ axes_r, axes_b.T @ inner @ axes_b)


def _tangent_axes(mean: FloatArray) -> FloatArray:
    """Rows: two axes perpendicular to a direction (3,), and the direction, right-handed."""
    axis = normalised(mean)
    smallest = int(np.argmin(np.abs(mean)))
    across = normalised(np.eye(3)[smallest] - axis[smallest] * axis)
    return np.stack([across, np.cross(axis, across), axis])


def _project(axes: FloatArray, v: FloatArray) -> FloatArray | None:
    """Gnomonic coordinates (M, 2) of directions (M, 3); None unless all are well in front of the plane."""
    x, y, depth = axes @ v.T
    return None if (depth < 0.2).any() else np.stack([x / depth, y / depth], axis=1)


def _lever_arms(x: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Weighted mean (2,) of points (M, 2), and rows (M, 2) that give the columns of a map from the stars' shifts: for
    all four elements, or for scale and rotation only if the points are nearly collinear (False)."""
    middle = weight @ x
    off = x - middle
    moments = (weight[:, None] * off).T @ off
    total, det = float(np.trace(moments)), float(np.linalg.det(moments))
    full = det > _SLENDER * total**2
    return middle, weight[:, None] * (off @ np.linalg.inv(moments) if full else off / total), full


def _plate_covariance(
    x: FloatArray, sigma: FloatArray, weight: FloatArray, along: FloatArray, middle: FloatArray, full: bool
) -> FloatArray:
    """Covariance (3, 3) of the rotation vector in the plane's axes.

    The fit gives shift and rotation as linear functions F of the stars' shifts m in the plane. A rotation δ shifts a
    star by G δ, G = [[−xy, 1 + x², −y], [−(1 + y²), xy, x]]; so δ̂ = (F G)⁻¹ F m. Isotropic errors σ of a direction
    become σ² (1 + x² + y²) (I + p pᵀ), p = (x, y), in the plane.
    """
    level, (a, b), (p, q) = weight - along @ middle, along.T, x.T
    zero, one = np.zeros(len(x)), np.ones(len(x))
    half, skew = (0.5, zero) if full else (1.0, a * middle[1] - b * middle[0])
    f = np.array([[skew, -level], [level, skew], [-half * b, half * a]])
    g = np.array([[-p * q, one + p * p, -q], [-(one + q * q), p * q, p]])
    widen = sigma**2 * (1.0 + p * p + q * q)
    spread = widen * np.array([[one + p * p, p * q], [p * q, one + q * q]])
    inverse = np.linalg.inv(np.einsum("ikm,kjm->ij", f, g))
    return np.asarray(inverse @ np.einsum("ikm,klm,jlm->ij", f, spread, f) @ inverse.T)
