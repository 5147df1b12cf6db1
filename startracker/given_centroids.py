"""Checks of centroids that are given by the caller."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker._compiled import kernel
from startracker.arguments import real_array
from startracker.arrays import FloatArray, IntArray
from startracker.errors import InputError
from startracker.geometry.camera import Camera
from startracker.sorting import order_of_columns
from startracker.survey import plain

SAME_STAR_PX = 0.75
"""Two centroids closer than this are taken as the same star, detected twice."""
_NO_FLUX = np.empty(0)


def clean_centroids(xy: ArrayLike, flux: ArrayLike | None, camera: Camera) -> tuple[FloatArray, FloatArray | None]:
    """Usable centroids (N, 2), brightest first, and their flux, as `usable_centroids`."""
    points, signal, _ = usable_centroids(xy, flux, camera)
    return points, signal


def usable_centroids(
    xy: ArrayLike, flux: ArrayLike | None, camera: Camera
) -> tuple[FloatArray, FloatArray | None, IntArray]:
    """Usable centroids (M, 2), brightest first, their flux and rows: finite, on the image, without duplicates.

    A star whose flux is not a positive number is taken as the faintest.
    """
    try:
        points = np.array(real_array("centroids", plain(xy), finite=False), order="C")
        signal = _NO_FLUX if flux is None else real_array("fluxes", plain(flux), finite=False).reshape(-1)
    except (TypeError, ValueError):  # an InputError is one, and says less
        raise InputError("centroids and fluxes must be numbers: xy with the shape (N, 2), flux with (N,)") from None
    if points.size == 0:
        points = points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"centroids must have the shape (N, 2), columns x and y; got {points.shape}")
    if flux is not None and len(signal) != len(points):
        raise InputError(f"there are {len(points)} centroids, but {len(signal)} fluxes")
    usable, brightness, rows = _usable(points, signal, camera.width, camera.height)
    known = flux is not None and len(brightness) == len(rows)
    return usable, brightness if known else None, rows


def stated_variance(sigma_px: ArrayLike | None, given: int, rows: IntArray) -> FloatArray | None:
    """Variance (M,), pixels², of the usable ones, by `rows` (M,), of all given centroids, from the stated standard
    errors (one per centroid, or one for all); None if none are stated.

    Raises
    ------
    InputError
        For a shape that does not fit, or an error that is not positive and finite.
    """
    if sigma_px is None:
        return None
    sigma = real_array("sigma_px, the standard error of each centroid on one axis,", sigma_px, finite=False)
    if sigma.shape not in ((), (given,)):
        raise InputError(f"there are {given} centroids, but sigma_px has the shape {sigma.shape}")
    if sigma.size and not (sigma.min() > 0.0 and sigma.max() < math.inf):  # NaN, too
        raise InputError("sigma_px must be positive and finite, pixels")
    chosen: FloatArray = sigma[rows] if sigma.ndim else np.full(len(rows), sigma)
    return chosen * chosen


@kernel
def _usable(points: FloatArray, flux: FloatArray, width: int, height: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Usable points (M, 2) of all (N, 2), their flux, empty if none is positive, and rows: on the image as in
    `Camera.contains`, brightest first, without duplicates."""
    rows, count, faintest = np.empty(len(points), np.int64), 0, math.inf
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        if -0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5:
            rows[count] = n
            count += 1
            if len(flux) > 0 and flux[n] > 0.0:
                faintest = min(faintest, flux[n])
    sorts, keys = faintest < math.inf, np.empty((3, count))
    for k in range(count):
        value = flux[rows[k]] if sorts else 0.0
        keys[0, k] = -value if 0.0 < value < math.inf else -0.5 * faintest
        keys[1, k], keys[2, k] = points[rows[k], 1], points[rows[k], 0]
    # ties are broken by position, so that the order of the input does not matter
    order, xy = order_of_columns(keys) if sorts else np.arange(count), np.empty((count, 2))
    for k in range(count):
        xy[k, 0], xy[k, 1] = keys[2, order[k]], keys[1, order[k]]
    alone, signal, chosen, left = _first_of_each(xy), np.empty(count), np.empty(count, np.int64), 0
    for k in range(count):
        if alone[k]:
            xy[left, 0], xy[left, 1] = xy[k, 0], xy[k, 1]
            signal[left], chosen[left] = -keys[0, order[k]], rows[order[k]]
            left += 1
    return xy[:left], signal[: left if sorts else 0], chosen[:left]


@kernel
def _first_of_each(points: FloatArray) -> NDArray[np.bool_]:
    """Mask (N,) of points without an earlier point within `SAME_STAR_PX` on both axes."""
    alone, x = np.ones(len(points), np.bool_), np.empty((1, len(points)))
    for n in range(len(points)):
        x[0, n] = points[n, 0]
    order = order_of_columns(x)
    for first in range(len(points)):  # sorted by x, so that neighbours in x follow
        i = order[first]
        for second in range(first + 1, len(points)):
            j = order[second]
            if points[j, 0] - points[i, 0] >= SAME_STAR_PX:
                break
            if abs(points[i, 1] - points[j, 1]) < SAME_STAR_PX:
                alone[max(i, j)] = False
    return alone
