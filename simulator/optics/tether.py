"""A tether before the camera: a thin, straight, matt cylinder lit by Sun or Moon, out of focus where it is near.

An element ds of a Lambert cylinder of diameter D and albedo A at the distance d, its axis at the angles β_s to the
source and β_o to the camera, sends towards the camera the share

    dE / E_source = A / π · sin β_s sin β_o · D / 4 · [(π − φ) cos φ + sin φ] · ds / d²

of its light, φ being the angle between source and camera as seen along the axis: the integral of cos i cos e over what
is both lit and seen (φ = 0: lit from behind the camera; φ = π: from ahead, dark). A lens of aperture a focused on
infinity spreads a point at the depth z into an even disk of the angular diameter a / z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.camera import Camera

__all__ = ["Tether", "TetherPoints", "cylinder_share", "tether_points"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Tether:
    """A straight, matt tether that is fixed to the camera, in the light of Sun and Moon."""

    diameter_mm: float = 0.0
    """Diameter; 0: none."""
    near_m: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Its near end in camera axes: along columns, along rows, ahead."""
    far_m: tuple[float, float, float] = (0.0, 0.0, 1000.0)
    """Its far end."""
    albedo: float = 0.5
    """Share of the light that it scatters, in all directions alike (Lambert)."""


_STEP_PX = 0.5
"""Distance of the points by which the tether is drawn."""


@dataclass(frozen=True, eq=False)
class TetherPoints:
    """A tether cut into short pieces; columns of equal length N."""

    direction: FloatArray
    """(N, 3): Unit vectors in camera axes."""
    share: FloatArray
    """(N,): Irradiance at the lens over that of the source."""
    blur_rad: FloatArray
    """(N,): Angular radius of the disk out of focus."""


def tether_points(tether: Tether, camera: Camera, aperture_mm: float, source: FloatArray) -> TetherPoints:
    """Pieces of a tether, half a pixel long in the middle of the image.

    Parameters
    ----------
    tether : Tether
        With a diameter; both ends before the lens, and not in one line with it, which scenarios are checked for.
    camera : Camera
        Gives the size of a pixel.
    aperture_mm : float
        Diameter of the lens.
    source : array, shape (3,)
        Unit vector to Sun or Moon, camera axes.
    """
    near, far = np.array(tether.near_m), np.array(tether.far_m)
    length = float(np.linalg.norm(far - near))
    axis = (far - near) / length
    foot = near - (near @ axis) * axis  # nearest point of its line to the lens
    distance = float(np.linalg.norm(foot))
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
    """dE / E_source · d² / ds (N,), m: what a metre of a Lambert cylinder sends of the source's light, at one metre.

    Parameters
    ----------
    axis, source : array, shape (3,)
        Unit vectors along the cylinder and to the source.
    direction : array, shape (N, 3)
        Unit vectors from the lens to the elements.
    """
    across_source = source - (source @ axis) * axis
    across_camera = -direction + (direction @ axis)[:, None] * axis
    sine_source, sine_camera = float(np.linalg.norm(across_source)), np.linalg.norm(across_camera, axis=1)
    product = sine_source * sine_camera  # sin β_s sin β_o, which cos φ is to be multiplied with
    cosine = np.divide(across_camera @ across_source, product, out=np.zeros_like(product), where=product > 0.0)
    phase = np.arccos(np.clip(cosine, -1.0, 1.0))
    form = (math.pi - phase) * np.cos(phase) + np.sin(phase)
    return np.asarray(albedo / math.pi * product * diameter_m / 4.0 * form)
