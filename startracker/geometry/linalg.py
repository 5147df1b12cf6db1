"""Linear algebra for a few unknowns in kernels: Cholesky factors, inverses, 3-vectors, rotations.

NumPy's functions take a second each to compile, and half a microsecond per call.
"""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray

_LEAST_PIVOT = 1e-14
"""Relative limit of a diagonal element after elimination, below which it is rounding error."""


@kernel
def factorise(matrix: FloatArray, size: int) -> bool:
    """Cholesky's factor L of the leading block, in place (lower half); False if it is not positive definite."""
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                # Negated, so that NaN is rejected, too.
                if not total > _LEAST_PIVOT * matrix[i, i]:
                    return False
                matrix[i, i] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@kernel
def substitute(factor: FloatArray, size: int, right: FloatArray) -> None:
    """Solution of L Lᵀ z = right, in place."""
    # Forward substitution, L y = right, then back substitution, Lᵀ z = y.
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@kernel
def solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution (n,) of a positive definite system; NaN if it is not."""
    size = len(right)
    factor, out = np.empty((size, size)), np.empty(size)
    for i in range(size):
        out[i] = right[i]
        for j in range(i + 1):
            factor[i, j] = matrix[i, j]
    if factorise(factor, size):
        substitute(factor, size, out)
    else:
        for i in range(size):
            out[i] = math.nan
    return out


@kernel_part
def log_determinant(matrix: FloatArray) -> float:
    """ln of the determinant of a positive definite matrix; −inf for any other."""
    size, total = len(matrix), 0.0
    factor = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            factor[i, j] = matrix[i, j]
    if not factorise(factor, size):
        return -math.inf
    for i in range(size):
        total += 2.0 * math.log(factor[i, i])
    return total


@kernel
def inverse(matrix: FloatArray, size: int) -> tuple[FloatArray, float]:
    """Inverse of the leading block (size, size) of a positive definite matrix, and ln of its determinant.

    NaN for a matrix that is not positive definite.
    """
    factor, out, log_determinant = np.empty((size, size)), np.zeros((size, size)), 0.0
    for i in range(size):
        for j in range(i + 1):
            factor[i, j] = matrix[i, j]
    positive = factorise(factor, size)
    for i in range(size):  # as `substitute`, for all columns at a time
        out[i, i] = 1.0 if positive else math.nan
        log_determinant += 2.0 * math.log(factor[i, i]) if positive else math.nan
        for j in range(i):
            for k in range(j + 1):
                out[i, k] -= factor[i, j] * out[j, k]
        for k in range(i + 1):
            out[i, k] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for j in range(i + 1, size):
            for k in range(size):
                out[i, k] -= factor[j, i] * out[j, k]
        for k in range(size):
            out[i, k] /= factor[i, i]
    for i in range(size):
        for j in range(i):  # symmetric to the last digit
            out[i, j] = out[j, i]
    return out, log_determinant


@kernel_part
def chord(u: FloatArray, v: FloatArray) -> float:
    """Distance of two unit vectors."""
    x, y, z = u[0] - v[0], u[1] - v[1], u[2] - v[2]
    return math.sqrt(x * x + y * y + z * z)


@kernel_part
def cross(a: FloatArray, b: FloatArray) -> tuple[float, float, float]:
    """Cross product of two vectors (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel_part
def triple_product(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """a · (b × c)."""
    x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    product: float = a[0] * x + a[1] * y + a[2] * z
    return product


@kernel
def transform(matrix: FloatArray, vectors: FloatArray, out: FloatArray) -> None:
    """matrix · v of vectors (N, 3), written to `out`."""
    for n in range(len(vectors)):
        x, y, z = vectors[n, 0], vectors[n, 1], vectors[n, 2]
        for i in range(3):
            out[n, i] = matrix[i, 0] * x + matrix[i, 1] * y + matrix[i, 2] * z


@kernel_part
def rotate_back(matrix: FloatArray, vector: FloatArray) -> tuple[float, float, float]:
    """matrixᵀ · v of one vector (3,)."""
    x, y, z = vector[0], vector[1], vector[2]
    return (
        matrix[0, 0] * x + matrix[1, 0] * y + matrix[2, 0] * z,
        matrix[0, 1] * x + matrix[1, 1] * y + matrix[2, 1] * z,
        matrix[0, 2] * x + matrix[1, 2] * y + matrix[2, 2] * z,
    )


@kernel
def rotated(matrix: FloatArray, x: float, y: float, z: float) -> FloatArray:
    """exp([v]×) · matrix for a rotation vector v = (x, y, z), Rodrigues."""
    angle = math.sqrt(x * x + y * y + z * z)
    # At angle 0 both factors are multiplied by zero vectors.
    s, c = 1.0, 0.0
    if angle > 0.0:
        s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    out = np.empty((3, 3))
    for k in range(3):
        p, q, r = matrix[0, k], matrix[1, k], matrix[2, k]
        u, v, w = y * r - z * q, z * p - x * r, x * q - y * p
        out[0, k] = p + s * u + c * (y * w - z * v)
        out[1, k] = q + s * v + c * (z * u - x * w)
        out[2, k] = r + s * w + c * (x * v - y * u)
    return out
