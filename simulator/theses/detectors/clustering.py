"""Clustering of bright pixels in one pass (Yee 1999, section 2.2)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from startracker._compiled import kernel, kernel_part
from startracker.core import IntArray
from startracker.detection.background import Background, as_image
from startracker.detection.classify import select_spots
from startracker.detection.forms import brightest_first
from startracker.detection.sources import SOURCE, Sources, add_pixel, find_runs, join_runs
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.errors import InputError
from startracker.settings import DetectionSettings

_LEAST_RADIUS_PX = 2.0
_LARGEST_RADIUS_PX = 64.0
_LARGE_QUANTILE = 0.9
_GROWTH_PX = 1.0
"""Growth of τ with the square root of a cluster's pixels, px. When half of a round star has been read, the pixel
farthest from the centre of that half is at most 0.9 times that root away."""

FloatImage = NDArray[np.float32]


def find_clusters(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates by clustering: each bright pixel joins the nearest cluster within τ, or starts a new one.

    Pixels above background + `threshold_sigma` × noise, or above `threshold_dn` as in Yee 1999, are read once, in
    reading order. A pixel within τ of the running centre of a cluster joins the nearest such cluster and moves its
    centre; otherwise it starts a new cluster (Yee 1999, section 2.2). Two improvements proposed in section 5.2 of that
    work are added. First, τ is adapted to the frame (`adaptive_radius`) instead of by trial and error, and to each
    star, by growing as √n with the pixels of a cluster. Second, clusters whose centres end up within τ of one another,
    as happens when a star is entered from two sides, are merged. A given `cluster_radius_px` is used unchanged.
    Clusters of fewer than `min_pixels` are dropped (Yee 1999: 10).

    Parameters
    ----------
    image : array, shape (H, W)
        DN. Values that are not finite belong to no cluster.
    background : Background
        Of the same shape.
    settings : DetectionSettings
        Thresholds, limits, `cluster_radius_px`.
    saturation_dn : float, optional
        DN at and above which a pixel is saturated; None: a flat top at the highest value.

    Returns
    -------
    Spots
        Brightest first, as every detector's. Yee 1999 sorts by the number of pixels: that order is
        ``np.argsort(-spots.pixels, kind="stable")``.

    Raises
    ------
    InputError
        Shapes that differ, radius not positive.
    """
    pixels = as_image(image)
    level, noise = background.level, background.noise
    if pixels.shape != background.shape:
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; compute it again")
    radius = settings.cluster_radius_px
    if radius is not None and not 0.0 < radius < math.inf:
        raise InputError(f"detection.cluster_radius_px is {radius}; it must be a positive number of pixels")
    if settings.threshold_dn is None:
        runs = find_runs(pixels, level, noise, np.float32(settings.threshold_sigma))
    else:
        limit = np.full_like(pixels, settings.threshold_dn)
        runs = find_runs(pixels, limit, np.zeros_like(pixels), np.float32(0.0))
    tau, growth = (adaptive_radius(runs, settings.max_pixels), _GROWTH_PX) if radius is None else (radius, 0.0)
    saturation = np.inf if saturation_dn is None else float(saturation_dn)
    table = merge_clusters(cluster_pixels(runs, tau, pixels, level, np.float32(saturation), growth), tau, growth)
    return select_spots(brightest_first(table), settings, saturation_dn is not None, pixels, background)


def adaptive_radius(runs: IntArray, max_pixels: int) -> float:
    """Radius τ, px, that keeps nine in ten of the frame's bright spots in one piece; at least 2 px.

    A spot is a set of at most `max_pixels` connected pixels; none of its pixels can be farther from the running centre
    of its cluster than the larger side of the spot (columns or rows).
    """
    number, count = join_runs(runs)
    if count == 0:
        return _LEAST_RADIUS_PX
    size = np.bincount(number, weights=runs[:, 2] - runs[:, 1], minlength=count)
    first, last = np.full((2, count), np.iinfo(np.int64).max), np.full((2, count), -1)
    # Columns first, as runs (first, last column), then rows, of which each run has one.
    for axis, (low, high) in enumerate(((runs[:, 1], runs[:, 2] - 1), (runs[:, 0], runs[:, 0]))):
        np.minimum.at(first[axis], number, low)
        np.maximum.at(last[axis], number, high)
    side = (last - first).max(axis=0)[(size > 1) & (size <= max_pixels)] + 1.0
    if not len(side):
        return _LEAST_RADIUS_PX
    return min(max(_LEAST_RADIUS_PX, float(np.quantile(side, _LARGE_QUANTILE))), _LARGEST_RADIUS_PX)


@kernel
def cluster_pixels(
    runs: IntArray, tau: float, image: FloatImage, level: FloatImage, saturation: float, growth: float = 0.0
) -> Sources:
    """Table of clusters (see `select_spots`) of the pixels in runs.

    Pixels are compared with the unweighted mean position of the cluster's pixels. A cluster of n pixels extends as far
    as the larger of τ and `growth` × √n, at most 64 px. To keep the search short, clusters are chained in cells of τ
    columns, and are dropped from their chain when the current row is out of their reach.
    """
    height, width = image.shape
    table = np.zeros(64, SOURCE)
    centre = np.zeros((64, 2))
    following = np.full(64, -1)  # chain of clusters in a cell of columns
    cells = int(width / tau) + 2
    head = np.full(cells, -1)
    cell_of = np.zeros(64, np.int64)
    count, found = 0, 0
    widest = tau
    for index in range(len(runs)):
        y = runs[index, 0]
        for x in range(runs[index, 1], runs[index, 2]):
            cell = int(x / tau)
            best, found = np.inf, -1
            around = int(np.ceil(widest / tau))
            for c in range(max(cell - around, 0), min(cell + around + 1, cells)):
                previous, other = -1, head[c]
                while other >= 0:
                    after = following[other]
                    dy = y - centre[other, 1]
                    reach = max(tau, min(growth * np.sqrt(table["pixels"][other]), _LARGEST_RADIUS_PX))
                    if dy > reach:  # no later pixel reaches it: rows only grow
                        if previous < 0:
                            head[c] = after
                        else:
                            following[previous] = after
                    else:
                        distance = (x - centre[other, 0]) ** 2 + dy * dy
                        if distance <= reach * reach and distance < best:
                            best, found = distance, other
                        previous = other
                    other = after
            if found < 0:
                if count == len(table):
                    table = np.concatenate((table, np.zeros_like(table)))
                    centre = np.concatenate((centre, np.zeros_like(centre)))
                    following = np.concatenate((following, np.full(count, -1)))
                    cell_of = np.concatenate((cell_of, np.zeros(count, np.int64)))
                found = count
                count += 1
                cell_of[found] = -1
            row = table[found]
            add_pixel(row, x, y, image[y, x], level[y, x], saturation)
            if x == 0 or y == 0 or x == width - 1 or y == height - 1:
                row["edge"] = True
            widest = max(widest, min(growth * np.sqrt(row["pixels"]), _LARGEST_RADIUS_PX))
            centre[found, 0] += (x - centre[found, 0]) / row["pixels"]
            centre[found, 1] += (y - centre[found, 1]) / row["pixels"]
            moved = int(centre[found, 0] / tau)
            if moved != cell_of[found]:
                _move_to_cell(moved, found, head, following, cell_of)
    return table[:count]


@kernel_part
def _move_to_cell(moved: int, cluster: int, head: IntArray, following: IntArray, cell_of: IntArray) -> None:
    """Remove a cluster from the chain of its cell, if it is in one, and insert it first into the chain of cell
    `moved`."""
    if cell_of[cluster] >= 0:
        previous, other = -1, head[cell_of[cluster]]
        while other != cluster:
            previous, other = other, following[other]
        if previous < 0:
            head[cell_of[cluster]] = following[cluster]
        else:
            following[previous] = following[cluster]
    following[cluster] = head[moved]
    head[moved] = cluster
    cell_of[cluster] = moved


def merge_clusters(table: Sources, tau: float, growth: float = 0.0) -> Sources:
    """Merge clusters whose centres lie within the reach of either of them.

    A cluster of n pixels extends as far as the larger of τ and `growth` × √n, at most 64 px.
    """
    if len(table) < 2:
        return table
    # A cluster without positive flux has no centre; an infinite signal puts it at the origin.
    signal = np.where(table["flux"] > 0, table["flux"], np.inf)
    centre = np.column_stack([table["sum_x"], table["sum_y"]]) / signal[:, None]
    reach = np.maximum(tau, np.minimum(growth * np.sqrt(table["pixels"]), _LARGEST_RADIUS_PX))
    pairs = cKDTree(centre).query_pairs(reach.max(), output_type="ndarray")
    apart = np.linalg.norm(centre[pairs[:, 0]] - centre[pairs[:, 1]], axis=1)
    pairs = pairs[apart <= np.maximum(reach[pairs[:, 0]], reach[pairs[:, 1]])]
    if not len(pairs):
        return table
    link = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(table), len(table)))
    count, label = connected_components(link, directed=False)
    merged = np.zeros(count, SOURCE)
    for column in ("pixels", "flux", "saturated", "edge", "sum_x", "sum_y", "sum_xx", "sum_yy", "sum_xy"):
        np.add.at(merged[column], label, table[column])  # for flags, this is a logical or
    # In ascending order of peaks the highest is written last; of equal ones, the first in reading order.
    order = np.lexsort((-table["x_peak"], -table["y_peak"], table["peak"]))
    for column in ("x_peak", "y_peak", "peak", "peak_residual"):
        merged[column][label[order]] = table[column][order]
    top = table["peak"] == merged["peak"][label]
    merged["at_peak"] = np.bincount(label, weights=np.where(top, table["at_peak"], 0.0), minlength=count)
    return merged
