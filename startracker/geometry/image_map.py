"""Mapping between pixels and directions of a camera, for kernels and for every projection.

The parameters are one array, which is passed to a kernel faster than ten arguments.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.core import FloatArray
from startracker.geometry.distortion import project_pinhole, unproject_pinhole
from startracker.geometry.fisheye import fisheye_project, fisheye_unproject

ImageMap = NDArray[np.float64]

FX, FY, CX, CY, WIDTH, HEIGHT, PINHOLE, EQUISOLID, LIMIT_RAD, LENS = range(10)
"""Indices into an image map: focal lengths (the first is negative for a mirrored image), principal point and size, px;
1 for a pinhole, otherwise 0; 1 for an equisolid fisheye, otherwise 0; limiting angle, rad; from `LENS` on, the
coefficients of the lens."""
_STEP_RAD = 1e-5
"""Step, rad, of the central differences of `pixel_slopes`."""


def image_map(
    focal_px: tuple[float, float],
    centre_px: tuple[float, float],
    size_px: tuple[int, int],
    projection: str,
    limit_rad: float,
    lens: FloatArray,
) -> ImageMap:
    """Image map of a camera; `lens` holds the distortion of a pinhole or the coefficients of a fisheye."""
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
    """Unit vectors (N, 3) in camera axes of pixels (N, 2), the inverse of `to_pixels`; NaN if there is none."""
    fx, fy, cx, cy = image[FX], image[FY], image[CX], image[CY]
    if image[PINHOLE] == 1.0:
        ahead: FloatArray = unproject_pinhole(xy, image[LENS:], fx, fy, cx, cy)
        return ahead
    points = np.empty((len(xy), 2))
    for i in range(len(xy)):
        points[i, 0], points[i, 1] = (xy[i, 0] - cx) / fx, (xy[i, 1] - cy) / fy
    around: FloatArray = fisheye_unproject(points, image[LENS:], image[EQUISOLID] == 1.0, image[LIMIT_RAD])
    return around


@kernel
def pixel_slopes(vectors: FloatArray, image: ImageMap) -> FloatArray:
    """∂(x, y)/∂θ (M, 2, 3), px per rad, for stars along unit vectors (M, 3) when the camera rotates by θ."""
    moved, out = np.empty((6 * len(vectors), 3)), np.empty((len(vectors), 2, 3))
    for n in range(len(vectors)):
        x, y, z = vectors[n, 0], vectors[n, 1], vectors[n, 2]
        for k in range(2):
            # When the camera rotates by θ, the coordinates of a fixed direction become v − θ × v.
            a, i = _STEP_RAD * (1 - 2 * k), 6 * n + 3 * k
            moved[i, 0], moved[i, 1], moved[i, 2] = x, y + a * z, z - a * y
            moved[i + 1, 0], moved[i + 1, 1], moved[i + 1, 2] = x - a * z, y, z + a * x
            moved[i + 2, 0], moved[i + 2, 1], moved[i + 2, 2] = x + a * y, y - a * x, z
    pixels = to_pixels(moved, image)
    for n in range(len(vectors)):
        for k in range(3):
            for axis in range(2):
                out[n, axis, k] = (pixels[6 * n + k, axis] - pixels[6 * n + 3 + k, axis]) / (2.0 * _STEP_RAD)
    return out
