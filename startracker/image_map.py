"""A camera's mapping between pixels and directions for compiled kernels, for every projection.

The parameters are one array, which is passed to a kernel faster than ten arguments.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.distortion import project_pinhole, unproject_pinhole
from startracker.fisheye import fisheye_project, fisheye_unproject
from startracker.kernels import kernel

__all__ = ["HEIGHT", "LENS", "LIMIT_RAD", "WIDTH", "ImageMap", "image_map", "to_directions", "to_pixels"]

FloatArray = NDArray[np.float64]
ImageMap = NDArray[np.float64]

FX, FY, CX, CY, WIDTH, HEIGHT, PINHOLE, EQUISOLID, LIMIT_RAD, LENS = range(10)
"""Indices: focal lengths (the first negative for a mirrored image), principal point and size, pixels; 1 for a pinhole,
else 0; 1 for an equisolid fisheye, else 0; limiting angle; from `LENS` on the lens coefficients."""


def image_map(
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    size_px: tuple[int, int],
    projection: str,
    limit_rad: float,
    lens: FloatArray,
) -> ImageMap:
    """Image map of a camera; `lens`: distortion of a pinhole, or coefficients of a fisheye."""
    kind = (projection == "pinhole", projection == "equisolid")
    return np.array([*focal_px, *centre_px, *size_px, *kind, limit_rad, *lens])


@kernel
def to_pixels(vectors: FloatArray, image: ImageMap) -> FloatArray:
    """Pixels (N, 2) of vectors (N, 3) in camera axes; NaN outside the camera's limit."""
    fx, fy, cx, cy = image[FX], image[FY], image[CX], image[CY]
    if image[PINHOLE] == 1.0:
        out: FloatArray = project_pinhole(vectors, image[LENS:], fx, fy, cx, cy)
        return out
    out = fisheye_project(vectors, image[LENS:], image[EQUISOLID] == 1.0, image[LIMIT_RAD])
    for i in range(len(out)):
        out[i, 0], out[i, 1] = fx * out[i, 0] + cx, fy * out[i, 1] + cy
    return out


@kernel
def to_directions(xy: FloatArray, image: ImageMap) -> FloatArray:
    """Unit vectors (N, 3) in camera axes of pixels (N, 2): inverse of `to_pixels`; NaN where there is none."""
    fx, fy, cx, cy = image[FX], image[FY], image[CX], image[CY]
    if image[PINHOLE] == 1.0:
        ahead: FloatArray = unproject_pinhole(xy, image[LENS:], fx, fy, cx, cy)
        return ahead
    points = np.empty((len(xy), 2))
    for i in range(len(xy)):
        points[i, 0], points[i, 1] = (xy[i, 0] - cx) / fx, (xy[i, 1] - cy) / fy
    around: FloatArray = fisheye_unproject(points, image[LENS:], image[EQUISOLID] == 1.0, image[LIMIT_RAD])
    return around
