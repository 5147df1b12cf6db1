"""Stars in the field at many attitudes.

Stars are given as unit vectors with their grid (`startracker.catalog.sky_view`), the field as its outline
(`startracker.catalog.sky_view`). The nadir and the cosine of the Earth's angular radius at each attitude define the
occultation; a cosine above 1 omits the Earth.
"""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel
from startracker.catalog.sky_view import FieldShape, VoxelGrid, field_shape, in_shape, stars_in_cone
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera


def outline(camera: Camera) -> FieldShape:
    """Outline of a camera's image, distortion included."""
    return field_shape(camera, margin_px=0.0)


def circle(radius_deg: float) -> FieldShape:
    """Outline of a circular field about the boresight."""
    cosine = math.cos(math.radians(radius_deg))
    return FieldShape(np.eye(3), np.full(720, cosine), cosine)


def solid_angle_sr(shape: FieldShape) -> float:
    """Solid angle of an outline, ∫ (1 − cos ρ(φ)) dφ, with cos ρ linear between the nodes, as in the kernels."""
    return 2.0 * math.pi * float(np.mean(1.0 - shape.least_cosine))


@kernel
def stars_in_field(
    matrix: FloatArray,
    directions: FloatArray,
    grid: VoxelGrid,
    shape: FieldShape,
    nadir: FloatArray,
    limb_cosine: float,
) -> IntArray:
    """Kernel: stars on the image at the attitude `matrix` (ICRS → camera), in any order."""
    centre = shape.axes[2]
    cx = matrix[0, 0] * centre[0] + matrix[1, 0] * centre[1] + matrix[2, 0] * centre[2]
    cy = matrix[0, 1] * centre[0] + matrix[1, 1] * centre[1] + matrix[2, 1] * centre[2]
    cz = matrix[0, 2] * centre[0] + matrix[1, 2] * centre[1] + matrix[2, 2] * centre[2]
    near = stars_in_cone(cx, cy, cz, max(shape.widest_cosine - 1e-12, -1.0), directions, grid)
    out = np.empty(len(near), np.int64)
    count = 0
    for star in near:
        u, v, w = directions[star, 0], directions[star, 1], directions[star, 2]
        if nadir[0] * u + nadir[1] * v + nadir[2] * w > limb_cosine:
            continue
        x = matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2] * w
        y = matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2] * w
        z = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2] * w
        if in_shape(x, y, z, shape):
            out[count] = star
            count += 1
    return out[:count]


def count_by_level(
    matrices: FloatArray,
    directions: FloatArray,
    grid: VoxelGrid,
    shape: FieldShape,
    level: IntArray,
    levels: int,
    nadir: FloatArray,
    limb_cosine: FloatArray,
) -> IntArray:
    """Stars in the field by level (such as magnitude), shape (N, levels).

    Parameters
    ----------
    matrices : (N, 3, 3)
        ICRS → camera.
    directions : (S, 3)
        Unit vectors of the stars.
    grid, shape
        Grid of these stars; outline of the field.
    level : (S,) int
        Level of each star, 0 … `levels` − 1.
    nadir, limb_cosine : (N, 3), (N,)
        Direction of the Earth's centre, cosine of its angular radius.
    """
    out = np.empty((len(matrices), levels), np.int64)
    for n, matrix in enumerate(matrices):
        stars = stars_in_field(matrix, directions, grid, shape, nadir[n], limb_cosine[n])
        out[n] = np.bincount(level[stars], minlength=levels)
    return out


def accumulate_information(
    matrices: FloatArray,
    directions: FloatArray,
    grid: VoxelGrid,
    shape: FieldShape,
    weight: FloatArray,
    most: int,
    nadir: FloatArray,
    limb_cosine: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """Stars in the field, and their information on the attitude: F = Σ wᵢ (I − bᵢ bᵢᵀ) in camera axes, rad⁻².

    Shuster & Oh 1981 (J. Guidance and Control 4, 70), eq. 94: the inverse of F is the covariance of the optimal
    attitude for wᵢ = 1/σᵢ², with σᵢ the standard error of a direction on each of its two axes.

    Parameters
    ----------
    weight : (S,)
        1/σ², rad⁻², of each star; brightest stars first.
    most : int
        Maximum number of stars that are used and counted, the brightest.
    matrices, directions, grid, shape, nadir, limb_cosine
        As in `count_by_level`.

    Returns
    -------
    counts : (N,) int
    information : (N, 3, 3)
    """
    counts = np.empty(len(matrices), np.int64)
    information = np.empty((len(matrices), 3, 3))
    for n, matrix in enumerate(matrices):
        stars = np.sort(stars_in_field(matrix, directions, grid, shape, nadir[n], limb_cosine[n]))[:most]
        b, w = directions[stars] @ matrix.T, weight[stars]
        counts[n] = len(stars)
        information[n] = w.sum() * np.eye(3) - (b.T * w) @ b
    return counts, information
