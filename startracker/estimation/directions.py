"""The pose from matched directions: rotation and, optionally, focal length, by Gauss–Newton.

With b the observed and p = R g the predicted unit vectors, δ the rotation vector that corrects R and ε = Δ ln f,
b − p = δ × p − ε ∂b/∂ln f. For a pinhole ∂b/∂ln f = b_z (e_z − b_z b), of length sin θ cos θ. Lost in space, prior,
tracking and the filter use the same normal equations; prior information is added to them.
"""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, IntArray
from startracker.geometry.linalg import cross, inverse, rotated, transform

_STEPS, _SETTLED_RAD = 12, 1e-9
_LARGEST_TURN_RAD = 0.1
"""Largest rotation, rad, of a fit from the attitude of two stars; beyond it, the stars do not match."""


@kernel_part
def focal_slopes(vectors: FloatArray) -> FloatArray:
    """∂b/∂ln f (N, 3) of unit vectors (N, 3) in the frame of a pinhole camera."""
    out = np.empty_like(vectors)
    for i in range(len(vectors)):
        z = vectors[i, 2]
        out[i, 0], out[i, 1], out[i, 2] = -z * z * vectors[i, 0], -z * z * vectors[i, 1], z * (1.0 - z * z)
    return out


@kernel
def normal_equations(
    observed: FloatArray, slopes: FloatArray, predicted: FloatArray, index: IntArray, sigma: FloatArray, unknowns: int
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (unknowns, unknowns) and right-hand side of one Gauss–Newton step over matched stars.

    Parameters
    ----------
    observed, sigma : (N, 3), (N,)
        Directions and their standard errors on one axis, rad.
    slopes : (N, 3)
        `focal_slopes`; not used if the focal length is known.
    predicted : (K, 3)
        Directions of guide stars.
    index : int (N,)
        Guide star of each observed star, or −1.
    unknowns : int
        3: rotation vector; 4: also ln of the focal length.
    """
    normal = np.zeros((unknowns, unknowns))
    right = np.zeros(unknowns)
    for i in range(len(observed)):
        if index[i] < 0:
            continue
        w = 1.0 / sigma[i] ** 2
        px, py, pz = predicted[index[i], 0], predicted[index[i], 1], predicted[index[i], 2]
        ex, ey, ez = observed[i, 0] - px, observed[i, 1] - py, observed[i, 2] - pz
        # The information on a rotation is I − p pᵀ for each star: none about its own direction.
        normal[0, 0] += w * (1.0 - px * px)
        normal[1, 1] += w * (1.0 - py * py)
        normal[2, 2] += w * (1.0 - pz * pz)
        normal[1, 0] -= w * px * py
        normal[2, 0] -= w * px * pz
        normal[2, 1] -= w * py * pz
        right[0] += w * (py * ez - pz * ey)
        right[1] += w * (pz * ex - px * ez)
        right[2] += w * (px * ey - py * ex)
        if unknowns == 4:
            dx, dy, dz = slopes[i, 0], slopes[i, 1], slopes[i, 2]
            normal[3, 0] -= w * (py * dz - pz * dy)
            normal[3, 1] -= w * (pz * dx - px * dz)
            normal[3, 2] -= w * (px * dy - py * dx)
            normal[3, 3] += w * (dx * dx + dy * dy + dz * dz)
            right[3] -= w * (dx * ex + dy * ey + dz * ez)
    for i in range(unknowns):
        for j in range(i):
            normal[j, i] = normal[i, j]
    return normal, right


@kernel
def fit_turn(
    observed: FloatArray,
    sigma: FloatArray,
    reference: FloatArray,
    index: IntArray,
    precision: FloatArray,
    start: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Most probable rotation vector (3,) from reference directions (K, 3) to observed ones, and its covariance (3, 3).

    The prior is 0 with the inverse covariance `precision` (3, 3), and `start` (3,) is the initial value; for other
    parameters see `normal_equations`. The information of the stars (3, 3) is returned too. The covariance is NaN if
    stars and prior do not determine the rotation.
    """
    turn, predicted, change = np.empty(3), np.empty_like(reference), np.empty(3)
    matrix, total, covariance, information = np.zeros((3, 3)), np.empty((3, 3)), precision, precision
    for i in range(3):
        turn[i], matrix[i, i] = start[i], 1.0
    for _ in range(_STEPS):
        transform(rotated(matrix, turn[0], turn[1], turn[2]), reference, predicted)
        information, right = normal_equations(observed, observed, predicted, index, sigma, len(turn))
        for i in range(3):
            for j in range(3):
                total[i, j] = information[i, j] + precision[i, j]
                right[i] -= precision[i, j] * turn[j]
        covariance, _ = inverse(total, len(total))
        largest = 0.0
        for i in range(3):
            change[i] = covariance[i, 0] * right[0] + covariance[i, 1] * right[1] + covariance[i, 2] * right[2]
            turn[i] += change[i]
            largest = max(largest, abs(change[i]))
        if not largest >= _SETTLED_RAD:
            break
    return turn, covariance, information


@kernel
def pair_frame(one: FloatArray, two: FloatArray) -> FloatArray:
    """Columns: `one`; the pole n of the great circle to `two`; and n × one, towards `two`."""
    out, pole = np.empty((3, 3)), np.empty(3)
    pole[0], pole[1], pole[2] = cross(one, two)
    # Orthogonalised twice, so that the pole is perpendicular to the last digit even for nearly parallel directions.
    for _ in range(2):
        length, along = 0.0, 0.0
        for k in range(3):
            length += pole[k] * pole[k]
        for k in range(3):
            pole[k] /= math.sqrt(length)
            along += pole[k] * one[k]
        for k in range(3):
            pole[k] -= along * one[k]
    for k in range(3):
        out[k, 0], out[k, 1] = one[k], pole[k]
    out[0, 2], out[1, 2], out[2, 2] = cross(pole, one)
    return out


@kernel_part
def pair_rotation(b: FloatArray, r: FloatArray, first: int, second: int) -> FloatArray:
    """Rotation (3, 3) that maps reference star `first` to its image, and the great circle to `second` to that of its
    image."""
    seen, known, out = pair_frame(b[first], b[second]), pair_frame(r[first], r[second]), np.empty((3, 3))
    transform(seen, known, out)
    # `transform` multiplies the rows of `known`, so that the product comes out transposed.
    for i in range(3):
        for j in range(i):
            out[i, j], out[j, i] = out[j, i], out[i, j]
    return out


@kernel
def fit_pairs(
    pairs: IntArray, directions: FloatArray, guides: FloatArray, sigma: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Best-fit attitude (3, 3) for pairs (M, 2) of centroids and guide stars, and the directions (M, 3) of the latter.

    NaN if the iteration does not converge, because the patterns do not match.

    Parameters
    ----------
    directions, guides : (N, 3), (G, 3)
        Directions of the centroids in the camera frame, and of the guide stars.
    sigma : (N,)
        Relative standard errors of the centroids.
    start : (3, 3)
        Approximate attitude; zeros: that of the first star and the one farthest from it.
    """
    count, farthest, least = len(pairs), 0, 2.0
    seen, known, moved = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3))
    index, error = np.empty(count, np.int64), np.empty(count)
    for n in range(count):
        index[n], error[n], cosine = n, sigma[pairs[n, 0]], 0.0
        for k in range(3):
            seen[n, k], known[n, k] = directions[pairs[n, 0], k], guides[pairs[n, 1], k]
            cosine += seen[n, k] * seen[0, k]
        if cosine < least:
            least, farthest = cosine, n
    matrix = start if start[0, 0] != 0.0 or start[0, 1] != 0.0 else pair_rotation(seen, known, 0, farthest)
    transform(matrix, known, moved)
    turn, covariance, _ = fit_turn(seen, error, moved, index, np.zeros((3, 3)), np.zeros(3))
    size = max(abs(turn[0]), abs(turn[1]), abs(turn[2]))
    matrix = rotated(matrix, turn[0], turn[1], turn[2])
    if not (size < _LARGEST_TURN_RAD and math.isfinite(covariance[0, 0])):
        matrix[0, 0] = math.nan
    return matrix, known
