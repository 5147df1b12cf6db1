"""Kernels that all estimators share: checks, frames of two stars, the last Newton steps and the covariance.

Sums over nearly parallel stars are taken in a frame whose first axis a is their weighted mean: what tells the turn
about a, Σ w sin², would drown in the rounding of Σ w − Σ w cos².
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.kernels import kernel, kernel_with

__all__ = [
    "common_frame",
    "covariance_of",
    "cross",
    "most_telling_pair",
    "pair_frame",
    "pair_rotation",
    "polish",
    "triple_product",
    "unit_vectors",
]

FloatArray = NDArray[np.float64]

_STEPS = 12
_LARGEST_STEP = 0.3  # rad; beyond it Newton's quadratic model of the cost is no longer one


@kernel
def unit_vectors(vectors: FloatArray, out: FloatArray) -> float:
    """Normalise `vectors` (M, 3) into `out`; largest sine of an angle from the first, or −1 if one has none."""
    spread = 0.0
    for i in range(len(vectors)):
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        largest = max(abs(x), abs(y), abs(z))
        if not (largest > 0.0 and math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            return -1.0
        x, y, z = x / largest, y / largest, z / largest
        length = math.sqrt(x * x + y * y + z * z)
        out[i, 0], out[i, 1], out[i, 2] = x / length, y / length, z / length
        u, v, w = cross(out[0], out[i])
        spread = max(spread, u * u + v * v + w * w)
    return math.sqrt(spread)


@kernel
def cross(a: FloatArray, b: FloatArray) -> tuple[float, float, float]:
    """Cross product of two vectors (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel_with(inline="always")
def triple_product(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """a · (b × c)."""
    x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    product: float = a[0] * x + a[1] * y + a[2] * z
    return product


@kernel
def common_frame(b: FloatArray, weight: FloatArray) -> FloatArray:
    """Rows: the weighted mean axis of directions (M, 3), taken from the heaviest one's side, and two axes across."""
    heaviest = np.argmax(weight)
    frame = np.zeros((3, 3))
    for i in range(len(b)):
        dot = b[i, 0] * b[heaviest, 0] + b[i, 1] * b[heaviest, 1] + b[i, 2] * b[heaviest, 2]
        side = weight[i] if dot >= 0.0 else -weight[i]
        for k in range(3):
            frame[0, k] += side * b[i, k]
    frame[0] /= math.sqrt((frame[0] ** 2).sum())
    smallest = np.argmin(np.abs(frame[0]))
    frame[1] = -frame[0, smallest] * frame[0]
    frame[1, smallest] += 1.0
    frame[1] /= math.sqrt((frame[1] ** 2).sum())
    frame[2, 0], frame[2, 1], frame[2, 2] = cross(frame[0], frame[1])
    return frame


@kernel
def _curvature(b: FloatArray, p: FloatArray, weight: FloatArray, frame: FloatArray) -> FloatArray:
    """Σ w ((b·p) I − (b pᵀ + p bᵀ)/2) in the axes of `frame`: Wahba's Hessian; with p = b the information."""
    out = np.zeros((3, 3))
    for i in range(len(b)):
        w = weight[i]
        ba = b[i, 0] * frame[0, 0] + b[i, 1] * frame[0, 1] + b[i, 2] * frame[0, 2]
        bu = b[i, 0] * frame[1, 0] + b[i, 1] * frame[1, 1] + b[i, 2] * frame[1, 2]
        bv = b[i, 0] * frame[2, 0] + b[i, 1] * frame[2, 1] + b[i, 2] * frame[2, 2]
        pa = p[i, 0] * frame[0, 0] + p[i, 1] * frame[0, 1] + p[i, 2] * frame[0, 2]
        pu = p[i, 0] * frame[1, 0] + p[i, 1] * frame[1, 1] + p[i, 2] * frame[1, 2]
        pv = p[i, 0] * frame[2, 0] + p[i, 1] * frame[2, 1] + p[i, 2] * frame[2, 2]
        out[0, 0] += w * (bu * pu + bv * pv)
        out[1, 1] += w * (ba * pa + bv * pv)
        out[2, 2] += w * (ba * pa + bu * pu)
        out[0, 1] -= 0.5 * w * (ba * pu + bu * pa)
        out[0, 2] -= 0.5 * w * (ba * pv + bv * pa)
        out[1, 2] -= 0.5 * w * (bu * pv + bv * pu)
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return out


@kernel
def _inverse(m: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix (3, 3) by its first element's Schur complement; NaN for any other."""
    out = np.full((3, 3), np.nan)
    det = m[1, 1] * m[2, 2] - m[1, 2] ** 2
    if not (det > 0.0 and m[1, 1] > 0.0):
        return out
    p, q, r = m[2, 2] / det, -m[1, 2] / det, m[1, 1] / det
    s, t = p * m[0, 1] + q * m[0, 2], q * m[0, 1] + r * m[0, 2]
    rest = m[0, 0] - (m[0, 1] * s + m[0, 2] * t)
    if not rest > 0.0:
        return out
    out[0, 0] = 1.0 / rest
    out[0, 1], out[0, 2] = -s / rest, -t / rest
    out[1, 1], out[1, 2], out[2, 2] = p + s * s / rest, q + s * t / rest, r + t * t / rest
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return out


@kernel
def covariance_of(b: FloatArray, sigma: FloatArray) -> FloatArray:
    """[Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ (3, 3) of unit vectors (M, 3): the covariance of the best attitude's rotation vector."""
    smallest = sigma.min()
    weight = (smallest / sigma) ** 2
    frame = common_frame(b, weight)
    inner = _inverse(_curvature(b, b, weight, frame)) * smallest**2
    covariance: FloatArray = frame.T @ inner @ frame
    return covariance


@kernel
def polish(matrix: FloatArray, b: FloatArray, r: FloatArray, weight: FloatArray) -> FloatArray:
    """Rotation (3, 3) near `matrix` at which Σ w |b − A r|² is least: Newton steps, until rounding stops them.

    With p = A r and b ≈ p the gradient Σ w b × p is taken as Σ w (b − p) × p, which keeps its digits.
    """
    frame = common_frame(b, weight)
    current = matrix.copy()
    p = np.empty_like(b)
    last = np.inf
    for _ in range(_STEPS):
        gx, gy, gz = 0.0, 0.0, 0.0
        for i in range(len(b)):
            for k in range(3):
                p[i, k] = current[k, 0] * r[i, 0] + current[k, 1] * r[i, 1] + current[k, 2] * r[i, 2]
            dx, dy, dz = b[i, 0] - p[i, 0], b[i, 1] - p[i, 1], b[i, 2] - p[i, 2]
            gx += weight[i] * (p[i, 1] * dz - p[i, 2] * dy)
            gy += weight[i] * (p[i, 2] * dx - p[i, 0] * dz)
            gz += weight[i] * (p[i, 0] * dy - p[i, 1] * dx)
        inverse = _inverse(_curvature(b, p, weight, frame))
        if not inverse[0, 0] > 0.0:
            break
        ga = frame[0, 0] * gx + frame[0, 1] * gy + frame[0, 2] * gz
        gu = frame[1, 0] * gx + frame[1, 1] * gy + frame[1, 2] * gz
        gv = frame[2, 0] * gx + frame[2, 1] * gy + frame[2, 2] * gz
        ta = inverse[0, 0] * ga + inverse[0, 1] * gu + inverse[0, 2] * gv
        tu = inverse[1, 0] * ga + inverse[1, 1] * gu + inverse[1, 2] * gv
        tv = inverse[2, 0] * ga + inverse[2, 1] * gu + inverse[2, 2] * gv
        size = math.sqrt(ta * ta + tu * tu + tv * tv)
        if not size < min(_LARGEST_STEP, 0.5 * last):  # rounding, or no minimum near
            break
        last = size
        current = _turn(
            frame[0, 0] * ta + frame[1, 0] * tu + frame[2, 0] * tv,
            frame[0, 1] * ta + frame[1, 1] * tu + frame[2, 1] * tv,
            frame[0, 2] * ta + frame[1, 2] * tu + frame[2, 2] * tv,
            current,
        )
        if size < 1e-9:  # the next one would be 1e-18
            break
    return current


@kernel
def _turn(x: float, y: float, z: float, matrix: FloatArray) -> FloatArray:
    """The rotation by the vector (x, y, z) after `matrix`, re-orthogonalised by its quaternion's length."""
    half = 0.5 * math.sqrt(x * x + y * y + z * z)
    s = 0.5 * (math.sin(half) / half if half > 0.0 else 1.0)
    x, y, z, c = s * x, s * y, s * z, math.cos(half)
    out = np.empty((3, 3))
    for k in range(3):
        p, q, r = matrix[0, k], matrix[1, k], matrix[2, k]
        u, v, w = y * r - z * q, z * p - x * r, x * q - y * p
        out[0, k] = p + 2.0 * (c * u + y * w - z * v)
        out[1, k] = q + 2.0 * (c * v + z * u - x * w)
        out[2, k] = r + 2.0 * (c * w + x * v - y * u)
    return out


@kernel
def most_telling_pair(b: FloatArray, sigma: FloatArray) -> tuple[int, int]:
    """Pair (i, j) of directions (M, 3) from which `pair_rotation` has the smallest mean square error, i first."""
    best, first, second = np.inf, 0, 1
    for i in range(len(b)):
        for j in range(len(b)):
            if i == j or sigma[i] > sigma[j]:
                continue
            x, y, z = cross(b[i], b[j])
            sine2 = x * x + y * y + z * z
            vi, vj = sigma[i] ** 2, sigma[j] ** 2
            total = 2.0 * vi + (vj + vi * max(1.0 - sine2, 0.0)) / sine2
            if total < best:
                best, first, second = total, i, j
    return first, second


@kernel
def pair_frame(one: FloatArray, two: FloatArray) -> FloatArray:
    """Columns: `one`; the pole n of the great circle to `two`; and n × one, towards `two`."""
    out = np.empty((3, 3))
    n = np.empty(3)
    n[0], n[1], n[2] = cross(one, two)
    n /= math.sqrt((n**2).sum())
    # perpendicular to the last digit, also where the two are nearly parallel
    n -= (n * one).sum() * one
    n /= math.sqrt((n**2).sum())
    out[:, 0], out[:, 1] = one, n
    out[0, 2], out[1, 2], out[2, 2] = cross(n, one)
    return out


@kernel
def pair_rotation(b: FloatArray, r: FloatArray, first: int, second: int) -> FloatArray:
    """Rotation (3, 3) that lays reference star `first` on its image, and the great circle to `second` on its image."""
    rotation: FloatArray = pair_frame(b[first], b[second]) @ pair_frame(r[first], r[second]).T
    return rotation
