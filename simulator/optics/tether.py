"""A tether in front of the camera: a thin, straight, diffusely reflecting cylinder illuminated by Sun or Moon, and
defocused at short range.

An element ds of a Lambertian cylinder of diameter D and albedo A at the distance d, with its axis at the angles β_s to
the source and β_o to the camera, scatters towards the camera the fraction

    dE / E_source = A / π · sin β_s sin β_o · D / 4 · [(π − φ) cos φ + sin φ] · ds / d²

of its light, where φ is the angle between source and camera as seen along the axis. This is the integral of cos i cos e
over the part that is both lit and visible (φ = 0: lit from behind the camera; φ = π: from ahead, dark). A lens of
aperture a focused at infinity images a point at the depth z as a uniform disk with the angular diameter a / z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.camera import Camera


@dataclass(frozen=True)
class Tether:
    """A straight, matt tether that is fixed to the camera, illuminated by Sun and Moon."""

    diameter_mm: float = 0.0
    """Diameter; 0: none."""
    near_m: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Near end in camera axes: along columns, along rows, along the boresight."""
    far_m: tuple[float, float, float] = (0.0, 0.0, 1000.0)
    """Far end in camera axes."""
    albedo: float = 0.5
    """Lambert albedo."""


_STEP_PX = 0.5
"""Spacing of the points with which the tether is rendered."""


@dataclass(frozen=True, eq=False)
class TetherPoints:
    """A tether divided into short elements; columns of equal length N."""

    direction: FloatArray
    """(N, 3): Unit vectors in camera axes."""
    share: FloatArray
    """(N,): Irradiance at the lens relative to that of the source."""
    blur_rad: FloatArray
    """(N,): Angular radius of the defocused disk."""


def tether_points(tether: Tether, camera: Camera, aperture_mm: float, source: FloatArray) -> TetherPoints:
    """Elements of a tether, half a pixel long at the image centre.

    Parameters
    ----------
    tether : Tether
        Its diameter is above 0, both ends are in front of the lens, and their line does not pass through the lens; the
        rules of a scenario check this.
    camera : Camera
        For the size of a pixel.
    aperture_mm : float
        Diameter of the lens.
    source : array, shape (3,)
        Unit vector to Sun or Moon, camera axes.
    """
    near, far = np.array(tether.near_m), np.array(tether.far_m)
    length = float(np.linalg.norm(far - near))
    axis = (far - near) / length
    foot = near - (near @ axis) * axis  # point of its line closest to the lens
    distance = float(np.linalg.norm(foot))
    # Elements of equal angle as seen from the lens, so that they are equally spaced on the image at its centre.
    first, last = (math.atan2(float(end @ axis), distance) for end in (near, far))
    count = max(1, math.ceil((last - first) / (_STEP_PX * camera.pixel_rad)))
    edges = np.linspace(first, last, count + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    direction = np.cos(middle)[:, None] * (foot / distance) + np.sin(middle)[:, None] * axis
    range_m = distance / np.cos(middle)
    piece_m = distance * np.diff(np.tan(edges))
    share = cylinder_share(axis, source, direction, tether.diameter_mm * 1e-3, tether.albedo) * piece_m / range_m**2
    return TetherPoints(direction, share, 0.5e-3 * aperture_mm / (range_m * direction[:, 2]))


def cylinder_share(
    axis: FloatArray, source: FloatArray, direction: FloatArray, diameter_m: float, albedo: float
) -> FloatArray:
    """dE / E_source · d² / ds (N,), metres: irradiance relative to that of the source, from a Lambertian cylinder one
    metre long at a distance of one metre.

    Parameters
    ----------
    axis, source : array, shape (3,)
        Unit vectors along the cylinder and to the source.
    direction : array, shape (N, 3)
        Unit vectors from the lens to the elements.
    """
    # The components across the axis have the lengths sin β, and the angle between them is the phase φ.
    across_source = source - (source @ axis) * axis
    across_camera = -direction + (direction @ axis)[:, None] * axis
    sine_source, sine_camera = float(np.linalg.norm(across_source)), np.linalg.norm(across_camera, axis=1)
    product = sine_source * sine_camera  # sin β_s sin β_o, the factor of cos φ
    cosine = np.divide(across_camera @ across_source, product, out=np.zeros_like(product), where=product > 0.0)
    phase = np.arccos(np.clip(cosine, -1.0, 1.0))
    form = (math.pi - phase) * np.cos(phase) + np.sin(phase)
    return np.asarray(albedo / math.pi * product * diameter_m / 4.0 * form)
