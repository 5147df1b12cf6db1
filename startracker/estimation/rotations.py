"""Common parts of the estimators: the pair of stars with the most information, the last Newton steps, the covariance.

Sums over nearly parallel stars are computed in a frame whose first axis a is their weighted mean: otherwise their
information on the rotation about a, Σ w sin², would be lost by rounding of Σ w − Σ w cos².
"""

from __future__ import annotations

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.linalg import inverse, rotated

_STEPS = 12
_LARGEST_STEP = 0.3  # rad; limit of Newton's quadratic model of the cost


def normalised(vector: FloatArray) -> FloatArray:
    """Vectors (..., 3) of length one."""
    return np.asarray(vector / np.sqrt((vector**2).sum(axis=-1, keepdims=True)))


def common_frame(b: FloatArray, weight: FloatArray) -> FloatArray:
    """Rows: the weighted mean axis of directions (M, 3), with the sign of the heaviest one, and two perpendicular
    axes."""
    side = np.where(b @ b[np.argmax(weight)] >= 0.0, weight, -weight)
    axis = normalised(side @ b)
    smallest = int(np.argmin(np.abs(axis)))
    across = normalised(np.eye(3)[smallest] - axis[smallest] * axis)
    return np.stack([axis, across, np.cross(axis, across)])


def _curvature(b: FloatArray, p: FloatArray, weight: FloatArray, frame: FloatArray) -> FloatArray:
    """Σ w ((b·p) I − (b pᵀ + p bᵀ)/2) in the axes of `frame`: Wahba's Hessian, and for p = b the information."""
    products = (weight[:, None] * (b @ frame.T)).T @ (p @ frame.T)
    a, u, v = products.diagonal()
    return np.diag([u + v, a + v, a + u]) - 0.5 * (products + products.T) * (1.0 - np.eye(3))


def covariance_of(b: FloatArray, sigma: FloatArray) -> FloatArray:
    """[Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ (3, 3) of unit vectors (M, 3): the covariance of the best attitude's rotation vector."""
    smallest = sigma.min()
    weight = (smallest / sigma) ** 2
    frame = common_frame(b, weight)
    inner, _ = inverse(_curvature(b, b, weight, frame), 3)
    return np.asarray(frame.T @ (inner * smallest**2) @ frame)


def polish(matrix: FloatArray, b: FloatArray, r: FloatArray, weight: FloatArray) -> FloatArray:
    """Rotation (3, 3) near `matrix` that minimises Σ w |b − A r|², by Newton's method to the limit of rounding.

    With p = A r and b ≈ p the gradient Σ w b × p is computed as Σ w (b − p) × p, which preserves precision.
    """
    frame = common_frame(b, weight)
    last = np.inf
    for _ in range(_STEPS):
        p = r @ matrix.T
        gradient = weight @ np.cross(p, b - p)
        turn = frame.T @ (inverse(_curvature(b, p, weight, frame), 3)[0] @ (frame @ gradient))
        size = float(np.sqrt(turn @ turn))
        if not size < min(_LARGEST_STEP, 0.5 * last):  # rounding, or no minimum nearby
            break
        last = size
        matrix = rotated(np.ascontiguousarray(matrix), *turn)
        if size < 1e-9:  # the next step would be 1e-18
            break
    return matrix


def most_telling_pair(b: FloatArray, sigma: FloatArray) -> tuple[int, int]:
    """Pair (i, j) of directions (M, 3) from which `pair_rotation` has the smallest mean square error; i is the first
    star."""
    sine2 = (np.cross(b[:, None], b[None]) ** 2).sum(axis=2)
    one, two = sigma[:, None] ** 2, sigma**2
    with np.errstate(divide="ignore", invalid="ignore"):
        total = 2.0 * one + (two + one * np.maximum(1.0 - sine2, 0.0)) / sine2
    total[(one > two) | np.eye(len(b), dtype=bool)] = np.inf
    first, second = divmod(int(np.argmin(total)), len(b))
    return first, second
