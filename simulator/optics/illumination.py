"""Illumination by field position: vignetting of stars and of a uniform sky.

At the angle θ the projected area of the pupil is cos θ times that on axis, and the fraction of it that is not
obstructed by the barrel is V(θ). The sky's light in a pixel is also proportional to the solid angle Ω of the pixel, for
every lens. For an undistorted pinhole, whose pixel (x, y) has the direction (x/f, y/f, 1), Ω = cos³ θ/f² is the
Jacobian of the projection; with the cos θ of the pupil this is the cos⁴ law of an extended source.

    star:        cos θ · V(θ) · P(ρ)
    background:  cos θ · V(θ) · P(ρ) · Ω(x, y)/Ω(0)        = cos⁴ θ · V · P for the ideal pinhole

`natural` enables the factor cos θ. V is the common area of two circles, the pupil and the shadow of a rim behind or in
front of it, whose distance is proportional to the image radius ρ. P = 1 + a₁ρ² + a₂ρ⁴ + a₃ρ⁶ is a measured curve. ρ is
the undistorted image radius in focal lengths: tan θ for a pinhole, θ for a fisheye, 2 sin(θ/2) for an equisolid one.
All factors are 1 at the principal point.

Validity: a flat pupil. In fisheyes and many wide-angle lenses the pupil tilts and grows towards the edge (Slyusarev
1941), so that they are brighter than this law; for such lenses leave `natural` off and give P. Source: M. Reiss, "The
cos⁴ law of illumination", J. Opt. Soc. Am. 35 (1945) 283; R. Kingslake, *Optics in Photography* (1992), chapter 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from startracker.core import FloatArray
from startracker.geometry.camera import Camera


@dataclass(frozen=True)
class Vignetting:
    """Vignetting; off by default."""

    natural: bool = False
    """Projected area of the pupil for stars; with the solid angle of pixels the cos⁴ law for the background."""
    mechanical_start_deg: float = 0.0
    """Off-axis angle at which the barrel begins to obstruct the pupil."""
    mechanical_end_deg: float | None = None
    """Off-axis angle at which it obstructs the pupil completely; null: no mechanical vignetting."""
    polynomial: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Measured factor 1 + a1 ρ² + a2 ρ⁴ + a3 ρ⁶ of the undistorted image radius ρ in focal lengths."""

    @property
    def is_off(self) -> bool:
        """Whether there is no vignetting."""
        return not self.natural and self.mechanical_end_deg is None and not any(self.polynomial)


_STRIP_ROWS = 256
_CHEBYSHEV: FloatArray = chebyshev.chebpts1(33)


def relative_illumination(camera: Camera, vignetting: Vignetting, theta_rad: ArrayLike) -> FloatArray:
    """Relative illumination of a star by its angle from the boresight, 1 at the principal point.

    Parameters
    ----------
    camera : Camera
        For its projection.
    vignetting : Vignetting
        Vignetting model.
    theta_rad : array
        Angles from the boresight, of any shape; NaN gives 0.

    Returns
    -------
    array of the same shape, 0 or more
    """
    # Factors that are off are skipped; NaN, from directions without an image, becomes 0 at the end.
    theta = np.asarray(theta_rad, dtype=float)
    factor = np.ones_like(theta)
    if vignetting.natural:
        factor = np.maximum(np.cos(theta), 0.0)
    rho = _image_radius(camera, theta)
    if vignetting.mechanical_end_deg is not None:
        start, end = _image_radius(camera, np.radians([vignetting.mechanical_start_deg, vignetting.mechanical_end_deg]))
        factor = factor * _open_share(rho, float(start), float(end))
    if any(vignetting.polynomial):
        a1, a2, a3 = vignetting.polynomial
        square = rho**2
        factor = factor * np.maximum(1.0 + square * (a1 + square * (a2 + square * a3)), 0.0)
    return np.where(np.isfinite(factor), factor, 0.0)


def star_illumination(camera: Camera, vignetting: Vignetting, directions: ArrayLike) -> FloatArray:
    """`relative_illumination` (N,) of unit vectors (N, 3) in camera axes."""
    v = np.atleast_2d(np.asarray(directions, dtype=float))
    return relative_illumination(camera, vignetting, np.arctan2(np.hypot(v[:, 0], v[:, 1]), v[:, 2]))


def illumination_map(camera: Camera, vignetting: Vignetting) -> FloatArray:
    """Illumination of every pixel (height, width) by a uniform sky: solid angle times vignetting.

    It is relative to the principal point of a lens without distortion, and 0 for pixels without a direction.
    """
    share = solid_angle_map(camera) * (camera.fx * camera.fy)
    if vignetting.is_off:
        return share
    x = np.arange(camera.width, dtype=float)
    for first in range(0, camera.height, _STRIP_ROWS):  # strips limit the memory for the directions
        rows = np.arange(first, min(first + _STRIP_ROWS, camera.height), dtype=float)
        directions = camera.unproject(np.stack(np.meshgrid(x, rows), axis=-1).reshape(-1, 2))
        share[first : first + len(rows)] *= star_illumination(camera, vignetting, directions).reshape(len(rows), -1)
    return share


def solid_angle_map(camera: Camera) -> FloatArray:
    """Solid angle of every pixel (height, width), sr, with distortion and projection; 0 for pixels without a direction.

    The solid angle is the area of the quadrilateral of the pixel's corners on the sphere, accurate to 1e-6 for pixels
    of 0.1°. It is smooth over the image and is interpolated by a polynomial through Chebyshev points, accurate to 1e-8
    for a pinhole of 120°. If part of the image has no direction, every pixel is computed.
    """
    x, y = ((side * (_CHEBYSHEV + 1.0) - 1.0) / 2.0 for side in (camera.width, camera.height))
    nodes = _solid_angles(camera, np.stack(np.meshgrid(x, y), axis=-1))
    if np.isfinite(nodes).all():
        terms = chebyshev.chebvander(_CHEBYSHEV, len(_CHEBYSHEV) - 1)
        # The interpolation separates: the same matrix is inverted along rows and along columns.
        coefficients = np.linalg.solve(terms, np.linalg.solve(terms, nodes).T).T
        along_x, along_y = (
            chebyshev.chebvander((2.0 * np.arange(side) + 1.0) / side - 1.0, len(_CHEBYSHEV) - 1)
            for side in (camera.width, camera.height)
        )
        return np.asarray(along_y @ coefficients @ along_x.T)
    out = np.empty((camera.height, camera.width))
    for first in range(0, camera.height, _STRIP_ROWS):
        rows = np.arange(first, min(first + _STRIP_ROWS, camera.height), dtype=float)
        grid = np.stack(np.meshgrid(np.arange(camera.width, dtype=float), rows), axis=-1)
        out[first : first + len(rows)] = np.nan_to_num(_solid_angles(camera, grid), nan=0.0)
    return out


def _solid_angles(camera: Camera, xy: FloatArray) -> FloatArray:
    """Solid angles (...) of pixels about the points (..., 2); NaN where a corner has no direction."""
    corners = np.stack([xy + corner for corner in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))])
    rays = camera.unproject(corners.reshape(-1, 2)).reshape(*corners.shape[:-1], 3)
    # The area of a quadrilateral is half the cross product of its diagonals.
    return np.asarray(0.5 * np.linalg.norm(np.cross(rays[2] - rays[0], rays[3] - rays[1]), axis=-1))


def _image_radius(camera: Camera, theta: FloatArray) -> FloatArray:
    """Undistorted image radius in focal lengths; infinite outside the range of a pinhole."""
    if camera.projection == "pinhole":
        return np.where(theta < np.pi / 2, np.tan(np.minimum(theta, np.pi / 2)), np.inf)
    return 2.0 * np.sin(theta / 2.0) if camera.projection == "equisolid" else theta


def _open_share(rho: FloatArray, start: float, end: float) -> FloatArray:
    """Fraction of a circle of radius 1 inside one of radius R at distance d, from 1 at `start` to 0 at `end`.

    d is proportional to ρ; the circle is unobstructed until d = R − 1 and dark from d = R + 1, hence
    R = (end + start)/(end − start), d = 2ρ/(end − start). The area is that of two circular segments.
    """
    big = (end + start) / (end - start)
    d = np.clip(2.0 * rho / (end - start), max(big - 1.0, 1e-12), big + 1.0)
    one = (d**2 + 1.0 - big**2) / (2.0 * d)  # distance from the small circle's centre to the common chord
    other = d - one
    area = np.arccos(np.clip(one, -1.0, 1.0)) - one * np.sqrt(np.maximum(1.0 - one**2, 0.0))
    area += big**2 * np.arccos(np.clip(other / big, -1.0, 1.0)) - other * np.sqrt(np.maximum(big**2 - other**2, 0.0))
    inside = np.where(rho > start, np.clip(area / np.pi, 0.0, 1.0), 1.0)
    return np.where(rho < end, inside, 0.0)
