"""Checks of centroids that are given by the caller."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arrays import FloatArray
from startracker.camera import Camera
from startracker.errors import InputError
from startracker.kernels import kernel
from startracker.survey import plain

SAME_STAR_PX = 0.75
"""Two centroids closer than this are taken as the same star, detected twice."""


def clean_centroids(xy: ArrayLike, flux: ArrayLike | None, camera: Camera) -> tuple[FloatArray, FloatArray | None]:
    """Usable centroids (N, 2), brightest first, and their flux: finite, on the image, without duplicates.

    A star whose flux is not a positive number is taken as the faintest.
    """
    try:
        points = np.asarray(plain(xy), dtype=float)
        signal = None if flux is None else np.asarray(plain(flux), dtype=float).reshape(-1)
    except (TypeError, ValueError):
        raise InputError("centroids and fluxes must be numbers: xy with the shape (N, 2), flux with (N,)") from None
    if points.size == 0:
        points = points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"centroids must have the shape (N, 2), columns x and y; got {points.shape}")
    if signal is not None and len(signal) != len(points):
        raise InputError(f"there are {len(points)} centroids, but {len(signal)} fluxes")
    keep = np.flatnonzero(np.isfinite(points).all(axis=1) & camera.contains(points))
    points = points[keep]
    if signal is not None:
        signal = signal[keep]
        good = np.isfinite(signal) & (signal > 0)
        if good.any():
            if not good.all():
                signal = np.where(good, signal, signal[good].min() * 0.5)
            # ties are broken by position, so that the order of the input does not matter
            order = np.lexsort((points[:, 0], points[:, 1], -signal))
            points, signal = points[order], signal[order]
        else:
            signal = None
    alone = _first_of_each(points)
    return points[alone], None if signal is None else signal[alone]


def stated_variance(sigma_px: ArrayLike | None, xy: ArrayLike, kept: FloatArray) -> FloatArray | None:
    """Variance (M,), pixels², of the centroids `kept` (M, 2) by `clean_centroids`, from the given standard errors (one
    per centroid, or one for all); None if none are given.

    Raises
    ------
    InputError
        For a shape that does not fit, or an error that is not positive and finite.
    """
    if sigma_px is None:
        return None
    points = np.asarray(xy, dtype=float).reshape(-1, 2)
    try:
        sigma = np.asarray(sigma_px, dtype=float)
    except (TypeError, ValueError):
        raise InputError("sigma_px must be numbers: the standard error of each centroid on one axis, pixels") from None
    if sigma.shape not in ((), (len(points),)):
        raise InputError(f"there are {len(points)} centroids, but sigma_px has the shape {sigma.shape}")
    if sigma.size and not (np.isfinite(sigma) & (sigma > 0.0)).all():
        raise InputError("sigma_px must be positive and finite, pixels")
    row = {(x, y): k for k, (x, y) in reversed(list(enumerate(points.tolist())))}  # the first of equal centroids
    chosen = [row[x, y] for x, y in kept.tolist()]
    return np.asarray(np.broadcast_to(sigma, len(points))[chosen] ** 2)


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
