"""Kernels that solve small normal equations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.kernels import kernel

__all__ = ["factorise", "substitute"]

FloatArray = NDArray[np.float64]


@kernel
def factorise(matrix: FloatArray, size: int) -> bool:
    """Cholesky's factor in place; False when the matrix is not positive definite."""
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-14 * matrix[i, i]:
                    return False
                matrix[i, i] = math.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    return True


@kernel
def substitute(factor: FloatArray, size: int, right: FloatArray) -> None:
    """Solution of L Lᵀ z = right, in place."""
    for i in range(size):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]
