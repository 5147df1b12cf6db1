"""Vignetting: how much less light reaches the edge of the field than its middle.

A star's light passes the pupil: seen from the angle θ its area is cos θ times that seen from the front, and the share
of it that the rims of the barrel leave open is V(θ). The sky's light in a pixel is that times the solid angle of the
pixel, which for an undistorted pinhole falls as cos³ θ: the two make the cos⁴ law of an extended source.

    star:        cos θ · V(θ) · P(ρ)
    background:  cos θ · V(θ) · P(ρ) · Ω(x, y)/Ω(0)        = cos⁴ θ · V · P for the ideal pinhole

`natural` switches cos θ and Ω/Ω(0); V is the area two circles have in common, the pupil and the shadow of a rim
behind or before it, which drift apart with the image radius ρ; P = 1 + a₁ρ² + a₂ρ⁴ + a₃ρ⁶ is for measured curves.
ρ is the image radius in focal lengths without distortion: tan θ for a pinhole, θ for a fisheye, 2 sin(θ/2) for an
equisolid one. All factors are 1 at the principal point.

Validity: a flat pupil. Fisheyes and many wide lenses turn and widen their pupils towards the edge (Slyusarev 1941)
and beat the law: leave `natural` off there and give P. Source: M. Reiss, "The cos⁴ law of illumination", J. Opt. Soc.
Am. 35 (1945) 283; R. Kingslake, *Optics in Photography* (1992), chapter 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.scenario.schema import VignettingSection
from startracker.camera import Camera

FloatArray = NDArray[np.float64]

_STRIP_ROWS = 256


def is_off(section: VignettingSection) -> bool:
    """Whether a section leaves everything as it is."""
    return not section.natural and section.mechanical_end_deg is None and not any(section.polynomial)


def relative_illumination(camera: Camera, section: VignettingSection, theta_rad: ArrayLike) -> FloatArray:
    """Share of a star's light, against one at the principal point, by its angle from the boresight.

    Parameters
    ----------
    camera : Camera
        For its projection.
    section : VignettingSection
        Which laws hold.
    theta_rad : array
        Angles from the boresight, of any shape; NaN gives 0.

    Returns
    -------
    array of the same shape, 0 or more
    """
    theta = np.asarray(theta_rad, dtype=float)
    factor = np.ones_like(theta)
    if section.natural:
        factor = np.maximum(np.cos(theta), 0.0)
    rho = _image_radius(camera, theta)
    if section.mechanical_end_deg is not None:
        start, end = _image_radius(camera, np.radians([section.mechanical_start_deg, section.mechanical_end_deg]))
        factor = factor * _open_share(rho, float(start), float(end))
    if any(section.polynomial):
        a1, a2, a3 = section.polynomial
        square = rho**2
        factor = factor * np.maximum(1.0 + square * (a1 + square * (a2 + square * a3)), 0.0)
    return np.where(np.isfinite(factor), factor, 0.0)


def star_illumination(camera: Camera, section: VignettingSection, directions: ArrayLike) -> FloatArray:
    """`relative_illumination` (N,) of unit vectors (N, 3) in camera axes."""
    v = np.atleast_2d(np.asarray(directions, dtype=float))
    return relative_illumination(camera, section, np.arctan2(np.hypot(v[:, 0], v[:, 1]), v[:, 2]))


def illumination_map(camera: Camera, section: VignettingSection) -> FloatArray:
    """Light of an even sky in every pixel (height, width), against that at the principal point.

    Where `natural` is on it holds the solid angle of each pixel, distortion and projection included, as the area of
    the quadrilateral its corners span on the sphere. Pixels that see nothing are 0.
    """
    out = np.empty((camera.height, camera.width))
    x = np.arange(camera.width + 1) - 0.5
    for first in range(0, camera.height, _STRIP_ROWS):
        last = min(first + _STRIP_ROWS, camera.height)
        centres = np.stack(np.meshgrid(x[:-1] + 0.5, np.arange(first, last, dtype=float)), axis=-1)
        directions = camera.unproject(centres.reshape(-1, 2))
        strip = star_illumination(camera, section, directions).reshape(last - first, camera.width)
        if section.natural:
            corners = np.stack(np.meshgrid(x, np.arange(first, last + 1) - 0.5), axis=-1)
            rays = camera.unproject(corners.reshape(-1, 2)).reshape(last - first + 1, camera.width + 1, 3)
            down, across = rays[1:, 1:] - rays[:-1, :-1], rays[:-1, 1:] - rays[1:, :-1]
            area = 0.5 * np.linalg.norm(np.cross(down, across), axis=-1)
            strip = strip * area * (camera.fx * camera.fy)
        out[first:last] = np.nan_to_num(strip, nan=0.0)
    return out


def _image_radius(camera: Camera, theta: FloatArray) -> FloatArray:
    """Image radius in focal lengths, without distortion; infinite where a pinhole sees nothing."""
    if camera.projection == "pinhole":
        return np.where(theta < np.pi / 2, np.tan(np.minimum(theta, np.pi / 2)), np.inf)
    return 2.0 * np.sin(theta / 2.0) if camera.projection == "equisolid" else theta


def _open_share(rho: FloatArray, start: float, end: float) -> FloatArray:
    """Share of a circle of radius 1 inside one of radius R whose centre is d away, from 1 at `start` to 0 at `end`.

    d grows in proportion to ρ and leaves the circle whole until d = R − 1 and dark from d = R + 1, whence
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
