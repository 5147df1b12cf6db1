"""Reference attitude and Cramér–Rao bound, computed with the true star identities.

Independent of the tracker's estimators: a benchmark must not share the code that it tests.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def wahba(observed: FloatArray, reference: FloatArray) -> FloatArray:
    """Matrix (3, 3) from reference to observed unit vectors (M, 3), equal weights (Markley 1988, SVD method)."""
    u, _, vt = np.linalg.svd(observed.T @ reference)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt


def rotation_error(truth: FloatArray, estimate: FloatArray) -> FloatArray:
    """Rotation vector (3,), rad, camera axes, from the true attitude to the estimate.

    For rotations close to π the axis is inaccurate, but the angle is correct.
    """
    turn = estimate @ truth.T
    sine = 0.5 * np.array([turn[1, 2] - turn[2, 1], turn[2, 0] - turn[0, 2], turn[0, 1] - turn[1, 0]])
    length = math.sqrt(float(sine @ sine))
    angle = math.atan2(length, 0.5 * (float(np.trace(turn)) - 1.0))
    if length < 1e-12:
        return np.array([0.0, 0.0, angle])
    return np.asarray(sine * (angle / length))


def design(vectors: FloatArray, focal_px: float) -> FloatArray:
    """Derivative (2M, 4) of pixels by the frame's rotation vector (3, rad) and the logarithm of the focal length.

    A frame rotated by ε has the vector v at v − ε × v; pixels are f (x, y) / z.
    """
    x, y = vectors[:, 0] / vectors[:, 2], vectors[:, 1] / vectors[:, 2]
    by_x = np.stack([-x * y, 1.0 + x * x, -y, x], axis=1) * [1.0, -1.0, -1.0, 1.0]
    by_y = np.stack([-(1.0 + y * y), x * y, x, y], axis=1) * [-1.0, -1.0, -1.0, 1.0]
    return focal_px * np.concatenate([by_x, by_y])


def bound(vectors: FloatArray, focal_px: float, sigma_px: float, fit_focal: bool = False) -> tuple[float, float]:
    """Cramér–Rao bound, rad rms: two-axis cross-boresight and about the boresight; infinite where undetermined.

    With `fit_focal` the focal length is an additional unknown.
    """
    columns = design(vectors, focal_px)[:, : 4 if fit_focal else 3]
    normal = columns.T @ columns
    if len(vectors) < 2 or np.linalg.cond(normal) > 1e14:
        return math.inf, math.inf
    variance = sigma_px**2 * np.diag(np.linalg.inv(normal))
    return math.sqrt(variance[0] + variance[1]), math.sqrt(variance[2])
