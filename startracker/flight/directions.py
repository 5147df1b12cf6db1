"""Table of the directions of star images: positions in the tangent plane, in integers.

A table holds the tangent-plane position of a grid of pixels, for whatever projection and distortion `Camera` has;
between them it is interpolated by cubic polynomials through four nodes in each direction. The export chooses the
smallest grid whose directions agree with `Camera.unproject` to `GRID_ERROR_PX` everywhere on the image.

The tangent plane touches the sphere at the camera's axis z: (u, v) = F (X/Z, Y/Z), with F the focal length along the
columns for both axes. To find the error of a table, it is interpolated here with the operations of the C
(`c/tracker_directions.c`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import BoolArray, FloatArray
from startracker.errors import InputError
from startracker.flight.c_table import CTable
from startracker.flight.design import FlightDesign
from startracker.flight.integers import Integers, divide, square_root
from startracker.geometry.camera import Camera

GRID_MODULES = ("integers", "directions")
GRID_ERROR_PX = 0.001
"""Largest error of a direction from the table, pixels, at the quarters of all cells; elsewhere it is below 0.002."""
PLANE_BITS = 16
"""Fraction bits of pixels in the tangent plane, as in the image."""
_NODES = (4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48, 64)
_WEIGHT_BITS = 26
_HALF_PX = 1 << 15
_ONE = 1 << 30
_MOST_PLANE_PX = 32767.0
_MOST_SIDE_PX = 8192
_SAMPLES = 4


class GridTables(NamedTuple):
    """Table and constants of one camera."""

    plane: Integers
    """Tangent-plane positions (rows, columns, 2) of the nodes, which divide the image from edge to edge into equal
    cells; pixels of 16 fraction bits."""
    scale: Integers
    """Cells per pixel along x and y, 30 fraction bits, (2,)."""
    size: Integers
    """Width and height of the image, pixels, (2,)."""
    focal: int
    """F, pixels of 16 fraction bits."""
    half: Integers
    """Largest magnitudes of u and v on the image, pixels of 16 fraction bits, (2,)."""


def grid_tables(design: FlightDesign) -> GridTables:
    """Table of a design's camera.

    Raises
    ------
    InputError
        For a camera whose image reaches beyond 45° from the boresight along either axis, a lens model that ends within
        the image, a focal length above 32,767 px, or a distortion that no table follows.
    """
    camera = design.camera
    _check(camera)
    for nodes in _NODES:
        tables = _with_nodes(camera, nodes)
        if _largest_error_px(tables, camera) <= GRID_ERROR_PX:
            return tables
    raise InputError(
        f"the camera's distortion cannot be followed to {GRID_ERROR_PX} px by a table of {_NODES[-1]} × {_NODES[-1]} "
        "nodes; calibrate it with fewer coefficients"
    )


def grid_constants(t: GridTables) -> dict[str, int]:
    """Macros of the exported tables."""
    rows, columns = t.plane.shape[:2]
    return {
        "GRID_COLUMNS": columns,
        "GRID_ROWS": rows,
        "GRID_SCALE_X": int(t.scale[0]),
        "GRID_SCALE_Y": int(t.scale[1]),
        "GRID_WIDTH": int(t.size[0]),
        "GRID_HEIGHT": int(t.size[1]),
        "GRID_FOCAL": t.focal,
        "GRID_UP": 1 << _up(t.focal),
        "GRID_HALF_U": int(t.half[0]),
        "GRID_HALF_V": int(t.half[1]),
    }


def grid_arrays(t: GridTables) -> list[CTable]:
    """Arrays of the exported tables."""
    return [CTable("int32_t", "grid_plane", "tangent-plane positions of the nodes, px, 16 fraction bits", t.plane)]


# ------------------------------------------------------------------ positions and directions
def plane_of(xy: Integers, t: GridTables) -> tuple[Integers, BoolArray]:
    """Tangent-plane positions (N, 2) of image positions (N, 2), pixels of 16 fraction bits, and which are on the image
    (N,)."""
    inside = (xy >= -_HALF_PX) & (xy < (t.size << 16) - _HALF_PX)
    return _interpolated(xy, t), inside[:, 0] & inside[:, 1]


def slopes_of(xy: Integers, t: GridTables) -> Integers:
    """Derivatives (N, 2, 2) of tangent-plane positions: ∂(u, v)/∂(x, y), 16 fraction bits."""
    half = _HALF_PX * np.eye(2, dtype=np.int64)
    return np.stack([_interpolated(xy + half[k], t) - _interpolated(xy - half[k], t) for k in range(2)], axis=2)


def vectors_of(plane: Integers, t: GridTables) -> Integers:
    """Unit vectors (N, 3) of 2.30 in camera axes of tangent-plane positions (N, 2)."""
    return unit(np.column_stack([plane, np.full(len(plane), t.focal)]) << _up(t.focal))


def _up(focal: int) -> int:
    """Shift of tangent-plane positions before they are normalised, so that the length is known to 30 bits."""
    return max(30 - focal.bit_length(), 0)


def unit(vectors: Integers) -> Integers:
    """Unit vectors (N, 3) of 2.30 of vectors with components below 2³⁶, not zero."""
    v = vectors.copy()
    while (long := np.abs(v).max(axis=1) >= _ONE).any():
        v[long] >>= 1
    return divide(v * _ONE, square_root((v * v).sum(axis=1))[:, None])


def _interpolated(xy: Integers, t: GridTables) -> Integers:
    """Tangent-plane positions (N, 2) from the nearest sixteen nodes."""
    rows, columns = t.plane.shape[:2]
    column, across = _weights(((xy[:, 0] + _HALF_PX) * t.scale[0]) >> 20, columns)
    row, down = _weights(((xy[:, 1] + _HALF_PX) * t.scale[1]) >> 20, rows)
    four = np.arange(4)
    nodes = t.plane[(row[:, None] + four)[:, :, None], (column[:, None] + four)[:, None, :]]
    along = (nodes * across[:, None, :, None]).sum(axis=2) >> _WEIGHT_BITS
    total: Integers = (along * down[:, :, None]).sum(axis=1)
    return (total + (1 << (_WEIGHT_BITS - 1))) >> _WEIGHT_BITS


def _weights(position: Integers, nodes: int) -> tuple[Integers, Integers]:
    """First of four nodes (N,) around positions in cells of 26 fraction bits, and their weights (N, 4), whose sum is
    one: Lagrange's cubic polynomials."""
    one = 1 << _WEIGHT_BITS
    first = np.clip((position >> _WEIGHT_BITS) - 1, 0, nodes - 4)
    a = position - first * one
    b, c, d = a - one, a - 2 * one, a - 3 * one
    before = divide(-(((b * c) >> _WEIGHT_BITS) * d), 6 * one)
    third = divide(-(((a * b) >> _WEIGHT_BITS) * d), 2 * one)
    last = divide(((a * b) >> _WEIGHT_BITS) * c, 6 * one)
    return first, np.stack([before, one - before - third - last, third, last], axis=1)


# ------------------------------------------------------------------ making the table
def _check(camera: Camera) -> None:
    if max(camera.fx, camera.fy) > _MOST_PLANE_PX or max(camera.width, camera.height) > _MOST_SIDE_PX:
        raise InputError(
            f"a flight build takes focal lengths up to {_MOST_PLANE_PX:.0f} px and images up to {_MOST_SIDE_PX} px; "
            f"this camera has {max(camera.fx, camera.fy):.0f} px and {camera.width}×{camera.height}"
        )
    x, y = np.linspace(-0.5, camera.width - 0.5, 65), np.linspace(-0.5, camera.height - 0.5, 65)
    border = [np.column_stack(np.broadcast_arrays(x, edge)) for edge in (y[0], y[-1])]
    border += [np.column_stack(np.broadcast_arrays(edge, y)) for edge in (x[0], x[-1])]
    vectors = camera.unproject(np.concatenate(border))
    if not np.isfinite(vectors).all():
        raise InputError(
            "a flight build needs a direction for every pixel of the image, but the lens model ends within it; "
            "choose a smaller image or another lens model"
        )
    reach = float(np.degrees(np.arctan2(np.abs(vectors[:, :2]).max(axis=1), vectors[:, 2])).max())
    if reach >= 45.0:
        raise InputError(
            f"a flight build takes cameras that see less than 45° from the boresight along rows and columns; this one "
            f"sees {reach:.1f}°: choose a narrower field"
        )


def _with_nodes(camera: Camera, nodes: int) -> GridTables:
    size = np.array([camera.width, camera.height], dtype=np.int64)
    x = np.linspace(-0.5, camera.width - 0.5, nodes)
    y = np.linspace(-0.5, camera.height - 0.5, nodes)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    vectors = camera.unproject(points.reshape(-1, 2))
    plane = camera.fx * vectors[:, :2] / vectors[:, 2:]
    one = 1 << PLANE_BITS
    return GridTables(
        np.rint(plane * one).astype(np.int64).reshape(nodes, nodes, 2),
        np.rint((nodes - 1) * float(_ONE) / size).astype(np.int64),
        size,
        round(camera.fx * one),
        np.ceil(np.abs(plane).max(axis=0) * one).astype(np.int64),
    )


def _largest_error_px(tables: GridTables, camera: Camera) -> float:
    """Largest distance on the image between a pixel and the projection of its direction, sampled in every cell."""
    count = _SAMPLES * (len(tables.plane) - 1) + 1
    x, y = np.linspace(-0.5, camera.width - 0.501, count), np.linspace(-0.5, camera.height - 0.501, count)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return float(np.abs(camera.project(directions(points, tables)) - points).max())


def directions(xy_px: ArrayLike, tables: GridTables) -> FloatArray:
    """Unit vectors (N, 3) of pixels (N, 2) from the table, as floats; NaN outside the image."""
    xy = np.rint(np.asarray(xy_px, dtype=float) * (1 << PLANE_BITS)).astype(np.int64)
    plane, inside = plane_of(xy, tables)
    return np.where(inside[:, None], vectors_of(plane, tables) / float(_ONE), np.nan)
