"""Brown–Conrady lens distortion in OpenCV's form, and its inverse.

With normalised coordinates (x, y) = (X/Z, Y/Z) and r² = x² + y²:

    radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    x_d = x · radial + 2 p1 x y + p2 (r² + 2 x²)
    y_d = y · radial + p1 (r² + 2 y²) + 2 p2 x y

Source: D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855; the rational form
and the order of the coefficients are as in OpenCV's ``calib3d`` module.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.arguments import real_number
from startracker.core import FloatArray
from startracker.display import changed_fields


@dataclass(frozen=True)
class Distortion:
    """Coefficients on normalised coordinates with OpenCV's names and order; all zero for a perfect pinhole.

    Parameters
    ----------
    k1, k2, k3 : float
        Radial, of r², r⁴, r⁶ in the numerator.
    k4, k5, k6 : float
        Radial, of r², r⁴, r⁶ in the denominator.
    p1, p2 : float
        Tangential.
    """

    __pydantic_config__ = {"extra": "forbid"}  # noqa: RUF012 - read by pydantic, which this package does not import

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            real_number(name, value, finite=False)

    def __repr__(self) -> str:
        return changed_fields(self)

    @property
    def is_zero(self) -> bool:
        """True when the lens is a perfect pinhole."""
        return not any(self._coefficients)

    def as_array(self) -> FloatArray:
        """Coefficients (8,) in OpenCV's order k1, k2, p1, p2, k3, k4, k5, k6."""
        return np.array(self._coefficients, dtype=float)

    @property
    def _coefficients(self) -> tuple[float, ...]:
        return self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6


@kernel_part
def _distort_point(x: float, y: float, k: FloatArray) -> tuple[float, float]:
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@kernel_part
def project_pinhole(vectors: FloatArray, k: FloatArray, fx: float, fy: float, cx: float, cy: float) -> FloatArray:
    """Pixels (N, 2) of vectors (N, 3) in camera axes for a pinhole with distortion `k`; NaN where z ≤ 1e-9."""
    out = np.empty((len(vectors), 2))
    for i in range(len(vectors)):
        z = vectors[i, 2]
        if not z > 1e-9:
            out[i, 0], out[i, 1] = np.nan, np.nan
            continue
        x, y = _distort_point(vectors[i, 0] / z, vectors[i, 1] / z, k)
        out[i, 0], out[i, 1] = fx * x + cx, fy * y + cy
    return out


@kernel
def _undistort_point(xd: float, yd: float, x: float, y: float, k: FloatArray) -> tuple[float, float, bool]:
    """Undistorted point by Newton's method from (x, y), and whether it converged before the fold of the lens model."""
    for _ in range(50):
        r2 = x * x + y * y
        top = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        bottom = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        radial = top / bottom
        slope_top = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4])
        slope_bottom = k[5] + r2 * (2.0 * k[6] + r2 * 3.0 * k[7])
        slope = (slope_top - radial * slope_bottom) / bottom  # d radial / d r²
        fx = x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x) - xd
        fy = y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y - yd
        jxx = radial + 2.0 * x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x
        jxy = 2.0 * x * y * slope + 2.0 * k[2] * x + 2.0 * k[3] * y
        jyy = radial + 2.0 * y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x
        det = jxx * jyy - jxy * jxy
        if not det > 0.0:  # beyond the fold of the lens model, or NaN
            return x, y, False
        dx = (jyy * fx - jxy * fy) / det
        dy = (jxx * fy - jxy * fx) / det
        x -= dx
        y -= dy
        if abs(dx) + abs(dy) < 1e-14 * (1.0 + abs(x) + abs(y)):
            return x, y, True
    return x, y, False


@kernel_part
def _fold_radius2(k: FloatArray) -> float:
    """Square of the radius, up to 8 (83°), at which r · radial(r²) first stops increasing, where the model ends."""
    for step in range(1, 513):
        r2 = (step / 64.0) ** 2
        top = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        bottom = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        slope_top = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4])
        slope_bottom = k[5] + r2 * (2.0 * k[6] + r2 * 3.0 * k[7])
        # The condition is on d(r · top/bottom)/dr, multiplied by bottom².
        if bottom <= 0.0 or top * bottom + 2.0 * r2 * (slope_top * bottom - top * slope_bottom) <= 0.0:
            return r2
    return np.inf


@kernel
def undistort(xy: FloatArray, k: FloatArray) -> FloatArray:
    """Undistorted from distorted normalised coordinates, shape (N, 2); NaN where the lens model cannot be inverted.

    Newton's method with the analytic Jacobian, started at the distorted point; forward and inverse agree to rounding
    (1e-13) wherever the distortion is one to one. If the start lies beyond the fold of a strong lens, the solution is
    continued from the centre in small steps; a root beyond the fold is rejected.
    """
    steps = 32
    fold2 = _fold_radius2(k)
    out = np.empty_like(xy)
    for i in range(xy.shape[0]):
        x, y, inside = xy[i, 0], xy[i, 1], False
        # The first attempt starts at the distorted point; the others continue the solution from the centre outwards.
        for step in range(steps + 1):
            share = step / steps if step > 0 else 1.0
            x, y, converged = _undistort_point(xy[i, 0] * share, xy[i, 1] * share, x, y, k)
            inside = converged and x * x + y * y <= fold2
            if step == 0 and not inside:
                x, y = 0.0, 0.0
            elif step == 0 or not converged:
                break
        out[i, 0], out[i, 1] = (x, y) if inside else (np.nan, np.nan)
    return out


@kernel
def unproject_pinhole(xy: FloatArray, k: FloatArray, fx: float, fy: float, cx: float, cy: float) -> FloatArray:
    """Unit vectors (N, 3) in camera axes of pixels (N, 2): inverse of `project_pinhole`; NaN as in `undistort`."""
    normalised = np.empty((len(xy), 2))
    for i in range(len(xy)):
        normalised[i, 0], normalised[i, 1] = (xy[i, 0] - cx) / fx, (xy[i, 1] - cy) / fy
    for value in k:
        if value != 0.0:
            normalised = undistort(normalised, k)
            break
    out = np.empty((len(xy), 3))
    for i in range(len(xy)):
        x, y = normalised[i, 0], normalised[i, 1]
        length = math.sqrt(x * x + y * y + 1.0)
        out[i, 0], out[i, 1], out[i, 2] = x / length, y / length, 1.0 / length
    return out
