"""Checks of centroids that are given by the caller."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arrays import FloatArray, IntArray
from startracker.camera import Camera
from startracker.errors import InputError
from startracker.kernels import kernel
from startracker.survey import plain

SAME_STAR_PX = 0.75
"""Two centroids closer than this are taken as the same star, detected twice."""


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
        points = np.array(plain(xy), dtype=float, order="C")
        signal = None if flux is None else np.asarray(plain(flux), dtype=float).reshape(-1)
    except (TypeError, ValueError):
        raise InputError("centroids and fluxes must be numbers: xy with the shape (N, 2), flux with (N,)") from None
    if points.size == 0:
        points = points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"centroids must have the shape (N, 2), columns x and y; got {points.shape}")
    if signal is not None and len(signal) != len(points):
        raise InputError(f"there are {len(points)} centroids, but {len(signal)} fluxes")
    rows = _on_image(points, camera.width, camera.height)
    if signal is not None:
        signal = signal[rows]
        good = (signal > 0.0) & (signal < math.inf)
        usable = np.count_nonzero(good)
        if usable < len(good):
            signal = np.where(good, signal, signal[good].min() * 0.5) if usable else None
    if signal is not None:  # ties are broken by position, so that the order of the input does not matter
        order = np.lexsort((points[rows, 0], points[rows, 1], -signal))
        rows, signal = rows[order], signal[order]
    points = points[rows]
    alone = _first_of_each(points)
    return points[alone], None if signal is None else signal[alone], rows[alone]


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
    try:
        sigma = np.asarray(sigma_px, dtype=float)
    except (TypeError, ValueError):
        raise InputError("sigma_px must be numbers: the standard error of each centroid on one axis, pixels") from None
    if sigma.shape not in ((), (given,)):
        raise InputError(f"there are {given} centroids, but sigma_px has the shape {sigma.shape}")
    if np.count_nonzero((sigma > 0.0) & (sigma < math.inf)) < sigma.size:
        raise InputError("sigma_px must be positive and finite, pixels")
    chosen: FloatArray = sigma[rows] if sigma.ndim else np.full(len(rows), sigma)
    return chosen * chosen


@kernel
def _on_image(points: FloatArray, width: int, height: int) -> IntArray:
    """Rows (M,) of the points (N, 2) on the image, as `Camera.contains`; none is infinite or NaN."""
    rows, count = np.empty(len(points), np.int64), 0
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        rows[count] = n
        count += -0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5
    return rows[:count]


@kernel
def _first_of_each(points: FloatArray) -> NDArray[np.bool_]:
    """Mask (N,) of points without an earlier point within `SAME_STAR_PX` on both axes."""
    alone = np.ones(len(points), np.bool_)
    order = np.argsort(points[:, 0])
    for first in range(len(points)):  # sorted by x, so that neighbours in x follow
        i = order[first]
        for second in range(first + 1, len(points)):
            j = order[second]
            if points[j, 0] - points[i, 0] >= SAME_STAR_PX:
                break
            if abs(points[i, 1] - points[j, 1]) < SAME_STAR_PX:
                alone[max(i, j)] = False
    return alone
