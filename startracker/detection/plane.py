"""A map over the image, kept as a few lines that are interpolated where a value is asked for."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]

_ROWS_AT_ONCE = 64


class Plane(NamedTuple):
    """A map (H, W) that is linear along y between lines; kernels index it like an array: ``plane[y, x]``.

    Parameters
    ----------
    lines : float32 array, shape (L, W)
        Values along lines of the image.
    cell : int array, shape (H,)
        The line above each row.
    share : float32 array, shape (H,)
        How far each row is from there to the next line; beyond 0 to 1 the map goes on linearly.
    """

    lines: FloatImage
    cell: NDArray[np.int64]
    share: FloatImage

    def __getitem__(self, pixel: Any) -> Any:
        """Values at pixels (y, x): integers, arrays of them, or an open grid (`numpy.ix_`)."""
        y, x = pixel
        cell = self.cell[y]
        upper = self.lines[cell, x]
        return upper + self.share[y] * (self.lines[np.minimum(cell + 1, len(self.lines) - 1), x] - upper)


def as_plane(values: FloatImage) -> Plane:
    """A map that is given whole."""
    return Plane(values, np.arange(len(values)), np.zeros(len(values), np.float32))


@overload(operator.getitem)
def _plane_getitem(plane: Any, pixel: Any) -> Callable[..., Any] | None:
    """``plane[y, x]`` in kernels."""
    if isinstance(plane, types.BaseNamedTuple) and plane.instance_class is Plane and isinstance(pixel, types.UniTuple):

        def value_at(plane: Any, pixel: Any) -> Any:
            y, x = pixel
            cell = plane.cell[y]
            upper = plane.lines[cell, x]
            return upper + plane.share[y] * (plane.lines[min(cell + 1, plane.lines.shape[0] - 1), x] - upper)

        return value_at
    return None


def sample_plane(plane: Plane, step_y: int, step_x: int) -> FloatImage:
    """Values of every `step_y`-th row and `step_x`-th column, flat."""
    lines, cell, share = plane.lines[:, ::step_x], plane.cell[::step_y], plane.share[::step_y, None]
    upper, lower = lines.take(cell, axis=0), lines.take(np.minimum(cell + 1, len(lines) - 1), axis=0)
    values: FloatImage = (upper + share * (lower - upper)).ravel()
    return values


def fill_plane(plane: Plane) -> FloatImage:
    """The whole map, shape (H, W)."""
    height, width = len(plane.cell), plane.lines.shape[1]
    out = np.empty((height, width), np.float32)
    for first in range(0, height, _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        out[rows] = sample_plane(Plane(plane.lines, plane.cell[rows], plane.share[rows]), 1, 1).reshape(-1, width)
    return out
