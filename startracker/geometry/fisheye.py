"""Fisheye projections: image radius as a function of off-axis angle, and its inverse, to 90° and beyond.

With θ the angle from the boresight and r the radius on the image in focal lengths:

    fisheye      r = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)      OpenCV's ``cv2.fisheye``
    equidistant  r = θ                                           the same with k = 0; FITS calls it ARC
    equisolid    r = 2 sin(θ/2)                                  equal-area; FITS calls it ZEA

Source: J. Kannala & S. S. Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
fish-eye lenses", IEEE Trans. PAMI 28 (2006) 1335; the coefficients are OpenCV's. Ideal projections: K. Miyamoto,
"Fish eye lens", J. Opt. Soc. Am. 54 (1964) 1060.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray

PROJECTIONS = ("pinhole", "fisheye", "equidistant", "equisolid")
"""Values of a camera's `projection`; the last two take no coefficients."""

_BOUND_RAD = math.pi * (1.0 - 1e-9)
"""Largest angle, rad: the direction opposite to the boresight maps to a circle, not to a point."""


@lru_cache(maxsize=64)
def limit_rad(coefficients: tuple[float, float, float, float]) -> float:
    """Angle up to which the image radius increases with θ, where the lens model ends; at most π.

    The first positive root of dr/dθ = 1 + 3 k1 θ² + 5 k2 θ⁴ + 7 k3 θ⁶ + 9 k4 θ⁸.
    """
    # The polynomial is in (θ/π)², so that negligible coefficients can be recognised and dropped.
    slope = [(2 * n + 1) * coefficients[n - 1] * math.pi ** (2 * n) for n in (4, 3, 2, 1)] + [1.0]
    roots = np.roots([c if abs(c) > 1e-17 else 0.0 for c in slope])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots.real))) & (roots.real > 0.0)]
    return min(math.pi * math.sqrt(real.min()), _BOUND_RAD) if len(real) else _BOUND_RAD


@kernel_part
def _radius(theta: float, k: FloatArray, equisolid: bool) -> float:
    if equisolid:
        return 2.0 * math.sin(0.5 * theta)
    t = theta * theta
    return float(theta * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3])))))


@kernel
def _angle(radius: float, k: FloatArray, equisolid: bool, limit: float) -> float:
    """Angle, rad, for a radius on the image in focal lengths; NaN beyond the largest radius.

    Newton's method, safeguarded by bisection if a step leaves the bracket or is not half as long as the previous one:
    between two inflections of the curve Newton's method can oscillate without end.
    """
    if equisolid:
        return 2.0 * math.asin(0.5 * radius) if radius <= 2.0 * math.sin(0.5 * limit) else math.nan
    if not radius <= _radius(limit, k, False):
        return math.nan
    low, high, change = 0.0, limit, limit
    theta = min(radius, limit)
    for _ in range(100):
        excess = _radius(theta, k, False) - radius
        if excess > 0.0:
            high = theta
        else:
            low = theta
        t = theta * theta
        slope = 1.0 + t * (3.0 * k[0] + t * (5.0 * k[1] + t * (7.0 * k[2] + t * 9.0 * k[3])))
        moved = theta - excess / slope
        if not low <= moved <= high or abs(moved - theta) > 0.5 * change:
            moved = 0.5 * (low + high)
        change, theta = abs(moved - theta), float(moved)
        if change <= 2e-16 * (1.0 + theta):
            break
    return theta


@kernel_part
def fisheye_project(vectors: FloatArray, k: FloatArray, equisolid: bool, limit: float) -> FloatArray:
    """Image points (N, 2) in focal lengths of vectors (N, 3) of any length; NaN beyond the angle `limit`."""
    out = np.empty((vectors.shape[0], 2))
    for i in range(vectors.shape[0]):
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        side = np.hypot(x, y)
        theta = np.arctan2(side, z)
        if not theta <= limit or (side == 0.0 and z == 0.0):  # beyond the limit, or a zero vector
            out[i, 0], out[i, 1] = np.nan, np.nan
        else:
            scale = _radius(theta, k, equisolid) / side if side > 0.0 else 0.0
            out[i, 0], out[i, 1] = x * scale, y * scale
    return out


@kernel
def fisheye_unproject(points: FloatArray, k: FloatArray, equisolid: bool, limit: float) -> FloatArray:
    """Unit vectors (N, 3) of image points (N, 2) in focal lengths; NaN outside the image circle."""
    out = np.empty((points.shape[0], 3))
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        radius = np.hypot(x, y)
        theta = _angle(radius, k, equisolid, limit)
        scale = np.sin(theta) / radius if radius > 0.0 else 1.0
        out[i, 0], out[i, 1], out[i, 2] = x * scale, y * scale, np.cos(theta)
    return out
