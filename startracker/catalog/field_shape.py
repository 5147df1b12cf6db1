"""Outline of a camera's image on the sky, for kernels that test whether a direction is in the field."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.camera import Camera
from startracker.kernels import kernel_part

_AZIMUTHS = 720
_STEPS_PER_SIDE = 200


class FieldShape(NamedTuple):
    """Outline of an image on the unit sphere: the minimum cosine of the angle from the image centre at each azimuth.

    Valid for outlines that every ray from the centre crosses once, as that of a whole image does.
    """

    axes: FloatArray
    """Rows, (3, 3): two transverse directions and the image centre, in the camera frame."""
    least_cosine: FloatArray
    """At azimuths from −π, in steps of half a degree, (720,)."""
    widest_cosine: float
    """Minimum of `least_cosine`."""


def field_shape(camera: Camera, margin_px: float = 2.0) -> FieldShape:
    """Outline of a camera's image enlarged by a margin, without pixels where the lens model cannot be inverted."""
    low_x, high_x = -0.5 - margin_px, camera.width - 0.5 + margin_px
    low_y, high_y = -0.5 - margin_px, camera.height - 0.5 + margin_px
    along = np.linspace(0.0, 1.0, _STEPS_PER_SIDE, endpoint=False)
    x = np.concatenate([low_x + along * (high_x - low_x), np.full(len(along), high_x)])
    y = np.concatenate([np.full(len(along), low_y), low_y + along * (high_y - low_y)])
    rim = np.concatenate([np.stack([x, y], 1), np.stack([low_x + high_x - x, low_y + high_y - y], 1)])
    middle = np.array([[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]])
    centre = camera.unproject(middle)[0]
    if not np.isfinite(centre).all():
        centre = np.array([0.0, 0.0, 1.0])
    across = np.cross([0.0, 1.0, 0.0] if abs(centre[1]) < 0.9 else [1.0, 0.0, 0.0], centre)
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(centre, across), centre])
    seen = _outermost(camera, middle[0], rim) @ axes.T
    azimuth = np.arctan2(seen[:, 1], seen[:, 0])
    order = np.argsort(azimuth)
    table = -math.pi + 2.0 * math.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    least = np.interp(table, azimuth[order], seen[order, 2], period=2.0 * math.pi)
    return FieldShape(axes, least, float(least.min()))


def _outermost(camera: Camera, middle: FloatArray, rim: FloatArray) -> FloatArray:
    """Directions (N, 3) of the rim's points, or of the outermost points towards them that have a direction."""
    vectors = camera.unproject(rim)
    for share in np.linspace(0.98, 0.02, 49):
        lost = ~np.isfinite(vectors).all(axis=1)
        if not lost.any():
            break
        vectors[lost] = camera.unproject(middle + share * (rim[lost] - middle))
    return vectors[np.isfinite(vectors).all(axis=1)]


@kernel_part
def in_shape(x: float, y: float, z: float, shape: FieldShape) -> bool:
    """Whether a unit vector in the camera frame is on the image."""
    axes = shape.axes
    cosine = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
    if cosine < shape.widest_cosine:
        return False
    across = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
    down = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
    step = (math.atan2(down, across) + math.pi) * (len(shape.least_cosine) / (2.0 * math.pi))
    low = int(step)
    share = step - low
    size = len(shape.least_cosine)
    least = (1.0 - share) * shape.least_cosine[low % size] + share * shape.least_cosine[(low + 1) % size]
    inside: bool = cosine >= least
    return inside
