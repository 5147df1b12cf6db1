"""Guide stars by direction, and the camera's field, as arrays for kernels.

The cube in which a star lies follows from its unit vector by three multiplications. All stars within a chord of a
direction are in the cubes that intersect a box of that half side. Kernels receive the grid as plain arrays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera
from startracker.geometry.image_map import HEIGHT, WIDTH, ImageMap, to_pixels
from startracker.observer import aberrated
from startracker.sorting import sort

_AZIMUTHS = 720
_STEPS_PER_SIDE = 200


class FieldShape(NamedTuple):
    """Outline of an image on the unit sphere: the least cosine of the angle from the image centre at each azimuth.

    It is valid for outlines that every ray from the centre crosses once, such as that of a whole image.
    """

    axes: FloatArray
    """Rows, (3, 3): two transverse directions and the image centre, in the camera frame."""
    least_cosine: FloatArray
    """Least cosine at azimuths from −π in steps of half a degree, (720,)."""
    widest_cosine: float
    """Minimum of `least_cosine`."""


def field_shape(camera: Camera, margin_px: float = 2.0) -> FieldShape:
    """Outline of a camera's image enlarged by a margin, without pixels where the lens model cannot be inverted."""
    low_x, high_x = -0.5 - margin_px, camera.width - 0.5 + margin_px
    low_y, high_y = -0.5 - margin_px, camera.height - 0.5 + margin_px
    along = np.linspace(0.0, 1.0, _STEPS_PER_SIDE, endpoint=False)
    x = np.concatenate([low_x + along * (high_x - low_x), np.full(len(along), high_x)])
    y = np.concatenate([np.full(len(along), low_y), low_y + along * (high_y - low_y)])
    # The other two sides are the first two, reflected through the image centre.
    rim = np.concatenate([np.stack([x, y], 1), np.stack([low_x + high_x - x, low_y + high_y - y], 1)])
    middle = np.array([[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]])
    centre = camera.unproject(middle)[0]
    if not np.isfinite(centre).all():
        centre = np.array([0.0, 0.0, 1.0])
    # Any transverse axis will do; the y axis is replaced where the centre is nearly parallel to it.
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
    """Directions (N, 3) of the points of the rim, or of the outermost points towards them for which the lens is
    invertible."""
    vectors = camera.unproject(rim)
    # Points are moved towards the centre in steps of 2 % until the lens model can be inverted there.
    for share in np.linspace(0.98, 0.02, 49):
        lost = ~np.isfinite(vectors).all(axis=1)
        if not lost.any():
            break
        vectors[lost] = camera.unproject(middle + share * (rim[lost] - middle))
    return vectors[np.isfinite(vectors).all(axis=1)]


@kernel
def in_shape(x: float, y: float, z: float, shape: FieldShape) -> bool:
    """Whether a unit vector in the camera frame is on the image."""
    axes = shape.axes
    cosine = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
    # Most stars of the sky are rejected here, before the arctangent.
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


_STARS_PER_CUBE = 2.0
_MOST_CUBES_PER_AXIS = 96
DRIFT = 2e-4
"""Largest motion of a star, rad, after the grid was built, for all but a few stars: aberration (26″) and two decades of
proper motion."""
_LARGEST_DRIFT = 2e-3
"""The same for the fastest stars over half a century; it is added to the radius of a cone."""


class VoxelGrid(NamedTuple):
    """Stars sorted into cubes."""

    per_axis: int
    """Number of cubes along each axis of the box from −1 to 1."""
    start: NDArray[np.int32]
    """Index in `members` of the first star of each cube, (per_axis³ + 1,)."""
    members: NDArray[np.int32]
    """Stars sorted by cube, ascending within each, (N,)."""


def voxel_grid(directions: FloatArray) -> VoxelGrid:
    """Grid of unit vectors (N, 3), with about two stars per cube that intersects the sphere."""
    # The sphere's area, 4π, intersects about 4π / side² cubes.
    side = math.sqrt(4.0 * math.pi * _STARS_PER_CUBE / max(len(directions), 1))
    per_axis = min(max(int(2.0 / side), 1), _MOST_CUBES_PER_AXIS)
    cell = np.clip(((directions + 1.0) * (0.5 * per_axis)).astype(np.int64), 0, per_axis - 1)
    number = (cell[:, 0] * per_axis + cell[:, 1]) * per_axis + cell[:, 2]
    members = np.argsort(number, kind="stable")
    start = np.zeros(per_axis**3 + 1, np.int32)
    start[1:] = np.cumsum(np.bincount(number, minlength=per_axis**3))
    return VoxelGrid(per_axis, start, members.astype(np.int32))


@kernel_part
def _cell_range(centre: float, reach: float, per_axis: int) -> tuple[int, int]:
    low = int((centre - reach + 1.0) * (0.5 * per_axis))
    high = int((centre + reach + 1.0) * (0.5 * per_axis))
    return min(max(low, 0), per_axis - 1), min(max(high, 0), per_axis - 1)


@kernel
def star_within(x: float, y: float, z: float, chord2: float, directions: FloatArray, grid: VoxelGrid) -> bool:
    """Whether a star is within √`chord2` of the unit vector (x, y, z)."""
    # The grid contains directions without the aberration and proper motion of those that are compared.
    reach = math.sqrt(chord2) + DRIFT
    x0, x1 = _cell_range(x, reach, grid.per_axis)
    y0, y1 = _cell_range(y, reach, grid.per_axis)
    z0, z1 = _cell_range(z, reach, grid.per_axis)
    for i in range(x0, x1 + 1):
        for j in range(y0, y1 + 1):
            row = (i * grid.per_axis + j) * grid.per_axis
            # Cubes along z are contiguous, so a column of cubes is one range of members.
            for m in range(grid.start[row + z0], grid.start[row + z1 + 1]):
                star = grid.members[m]
                dx, dy, dz = directions[star, 0] - x, directions[star, 1] - y, directions[star, 2] - z
                if dx * dx + dy * dy + dz * dz <= chord2:
                    return True
    return False


@kernel
def stars_in_cone(
    x: float, y: float, z: float, cosine: float, directions: FloatArray, grid: VoxelGrid
) -> NDArray[np.int32]:
    """Stars whose angle to the unit vector (x, y, z) has at least this cosine, (K,), in the order of the grid."""
    reach = math.sqrt(max(2.0 - 2.0 * cosine, 0.0)) + _LARGEST_DRIFT
    x0, x1 = _cell_range(x, reach, grid.per_axis)
    y0, y1 = _cell_range(y, reach, grid.per_axis)
    z0, z1 = _cell_range(z, reach, grid.per_axis)
    out = np.empty(64, np.int32)
    count = 0
    for i in range(x0, x1 + 1):
        for j in range(y0, y1 + 1):
            row = (i * grid.per_axis + j) * grid.per_axis
            for m in range(grid.start[row + z0], grid.start[row + z1 + 1]):
                star = grid.members[m]
                if directions[star, 0] * x + directions[star, 1] * y + directions[star, 2] * z >= cosine:
                    if count == len(out):
                        # Doubling limits the cost of all copies to that of filling the array.
                        longer = np.empty(2 * count, np.int32)
                        for k in range(count):
                            longer[k] = out[k]
                        out = longer
                    out[count] = star
                    count += 1
    return out[:count]


@kernel_part
def stars_around(
    matrix: FloatArray, cosine: float, directions: FloatArray, grid: VoxelGrid
) -> tuple[IntArray, FloatArray]:
    """Stars within a cone around the boresight at the attitude `matrix` (3, 3).

    Returns their indices (K,), ascending, and their vectors (K, 3) in the camera frame. `cosine` is that of the half
    angle of the cone.
    """
    near = stars_in_cone(matrix[2, 0], matrix[2, 1], matrix[2, 2], cosine, directions, grid)
    index, vectors = np.empty(len(near), np.int64), np.empty((len(near), 3))
    for k in range(len(near)):
        index[k] = near[k]
    sort(index)
    for k in range(len(near)):
        star = index[k]
        for axis in range(3):
            vectors[k, axis] = (
                matrix[axis, 0] * directions[star, 0]
                + matrix[axis, 1] * directions[star, 1]
                + matrix[axis, 2] * directions[star, 2]
            )
    return index, vectors


@kernel
def stars_on_image(
    matrix: FloatArray, cosine: float, margin_px: float, directions: FloatArray, grid: VoxelGrid, image: ImageMap
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Stars on an image enlarged by a margin, at the attitude `matrix` (3, 3).

    Returns their indices (K,), ascending, vectors (K, 3) in the camera frame, and pixels (K, 2). `cosine` is that of
    the largest angle from the boresight.
    """
    index, vectors = stars_around(matrix, cosine, directions, grid)
    xy = to_pixels(vectors, image)
    low, right, bottom = -0.5 - margin_px, image[WIDTH] - 0.5 + margin_px, image[HEIGHT] - 0.5 + margin_px
    count = 0
    for k in range(len(index)):
        if low <= xy[k, 0] < right and low <= xy[k, 1] < bottom:
            index[count], xy[count, 0], xy[count, 1] = index[k], xy[k, 0], xy[k, 1]
            for axis in range(3):
                vectors[count, axis] = vectors[k, axis]
            count += 1
    return index[:count], vectors[:count], xy[:count]


class SkyView(NamedTuple):
    """Guide stars and the camera's field in the form that kernels read."""

    directions: FloatArray
    """Unit vectors, brightest first, (G, 3)."""
    v_mag: FloatArray
    """V magnitudes, (G,)."""
    grid: VoxelGrid
    shape: FieldShape
    area: float
    """Solid angle of the image, sr."""


@kernel
def apparent_directions(
    start: FloatArray, motion: FloatArray, parallax: FloatArray, years: float, position_au: FloatArray, beta: FloatArray
) -> FloatArray:
    """Unit vectors (N, 3), ICRS axes, with space motion, annual parallax and aberration of light.

    Equivalent to `StarCatalog.directions` followed by `startracker.observer.aberrate`, which state the equations.

    Parameters
    ----------
    start, motion : (3, N)
        Unit vectors at the catalogue's epoch, and their space motion per Julian year (`StarCatalog.space_motion`). One
        axis per row allows vectorisation over eight stars.
    parallax : (N,)
        Radians.
    years : float
        Time since the catalogue's epoch.
    position_au, beta : (3,)
        The observer's barycentric position (zero: no parallax) and velocity divided by the speed of light (zero: no
        aberration).
    """
    out = np.empty((start.shape[1], 3))
    velocity = (beta[0], beta[1], beta[2])
    for i in range(start.shape[1]):
        p = parallax[i]
        x = start[0, i] + years * motion[0, i] - p * position_au[0]
        y = start[1, i] + years * motion[1, i] - p * position_au[1]
        z = start[2, i] + years * motion[2, i] - p * position_au[2]
        # The length of (x, y, z) is not 1; `aberrated` allows for it.
        out[i, 0], out[i, 1], out[i, 2] = aberrated(x, y, z, velocity)
    return out
