"""Wings of stars: the light of a tabulated PSF outside its stamp, by the distance from the star."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from simulator.optics.psf_table import TAPER_PX, smooth_step
from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray

_smooth_step = kernel_part(smooth_step)


class Wings(NamedTuple):
    """Wings of a PSF as a table over the distance from the star."""

    share: FloatArray
    """(W,): Fraction of the light in a pixel by its distance."""
    per_px: float
    """Entries of `share` per pixel."""
    row_px: float
    """Pitch along rows over that along columns."""
    half: int
    """Half of the side of the stamp, which contains the core."""


@kernel
def add_wings(
    image: FloatArray, lines: FloatArray, moments: FloatArray, pixel: tuple[int, int], radius: float, wings: Wings
) -> float:
    """Add the light outside the stamp of that part of a path that is within one pixel.

    `moments` (6,) are the sums of 1, x, y, x², xy and y² of the light. At this distance the part is represented by two
    points with the same mean and variance along the path; the error is about 0.08 (L/r)⁴ of the light there, for a path
    of length L ≤ √2 at r > half. Returns the sum of the added light, on the image and outside; it is incomplete if the
    stamp is outside the image, where it is not needed.
    """
    amount = moments[0]
    if amount == 0.0:
        return 0.0
    mean_x, mean_y = moments[1] / amount, moments[2] / amount
    xx, yy = moments[3] / amount - mean_x**2, moments[5] / amount - mean_y**2
    xy = moments[4] / amount - mean_x * mean_y
    x, y = pixel[0] + mean_x, pixel[1] + mean_y
    # The larger eigenvalue of the covariance, and the direction of its eigenvector, are those along the path.
    variance = 0.5 * (xx + yy) + math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    points, dx, dy, total = 1, 0.0, 0.0, 0.0
    if variance >= 1e-6:
        spread, angle = math.sqrt(variance), 0.5 * math.atan2(2.0 * xy, xx - yy)
        points, dx, dy = 2, spread * math.cos(angle), spread * math.sin(angle)
    for point in range(points):
        side = 1 - 2 * point
        total += _add_wing(image, lines, (x + side * dx, y + side * dy, amount / points), pixel, radius, wings)
    return total


@kernel
def _add_wing(
    image: FloatArray,
    lines: FloatArray,
    point: tuple[float, float, float],
    pixel: tuple[int, int],
    radius: float,
    wings: Wings,
) -> float:
    """Light of a point (x, y, amount) outside the stamp, out to `radius` and a taper; returns its sum, see
    `add_wings`."""
    height, width = image.shape
    (x, y, amount), (centre_x, centre_y) = point, pixel
    share, per_px, row_px, half = wings
    end = radius + TAPER_PX
    low_x, high_x = math.ceil(x - end), math.floor(x + end)
    low_y, high_y = math.ceil(y - end / row_px), math.floor(y + end / row_px)
    # With the stamp outside the image its light is not scaled, so the wings outside need not be summed.
    if centre_x + half < 0 or centre_x - half >= width or centre_y + half < 0 or centre_y - half >= height:
        low_x, high_x = max(low_x, 0), min(high_x, width - 1)
        low_y, high_y = max(low_y, 0), min(high_y, height - 1)
    line, sums = lines[0], lines[1]
    sums[:] = 0.0
    for j in range(low_y, high_y + 1):
        dy = (j - y) * row_px
        chord = math.sqrt(max(end * end - dy * dy, 0.0))
        left, right = max(math.ceil(x - chord), low_x), min(math.floor(x + chord), high_x)
        if left > right:
            continue
        gap = (math.floor(x) + 1 - low_x, math.floor(x) - low_x)  # an empty interval
        if abs(j - centre_y) <= half:  # columns of the stamp, which is inside `radius`
            gap = (centre_x - half - low_x, centre_x + half - low_x)
        _fill_line(line, (left - low_x, right - low_x), gap, (x - low_x, dy), radius, amount, share, per_px)
        _add_line(image, sums, line, j, low_x, (left, right))
    total = 0.0
    for light in sums:
        total += light
    return total


@kernel
def _fill_line(
    line: FloatArray,
    ends: tuple[int, int],
    gap: tuple[int, int],
    star: tuple[float, float],
    radius: float,
    amount: float,
    share: FloatArray,
    per_px: float,
) -> None:
    """Fill the pixels ends[0] … ends[1] of a row of the wings, with 0 in the gap; the star is at column star[0], and
    star[1] is its distance across the row."""
    first, last = ends
    x, dy = star
    for i in range(max(gap[0], first), min(gap[1], last) + 1):
        line[i] = 0.0
    inner_left, inner_right = gap[0], gap[1]  # a row that is entirely in the taper
    if abs(dy) < radius:
        full = math.sqrt(max(radius * radius - dy * dy, 0.0))
        inner_left, inner_right = math.ceil(x - full), math.floor(x + full)
    # On either side of the gap, pixels inside `radius` have the plain table, and those beyond it are in the taper.
    for side in range(2):
        begin, end = (first, min(gap[0] - 1, last)) if side == 0 else (max(gap[1] + 1, first), last)
        rim_begin, rim_end = (begin, min(inner_left - 1, end)) if side == 0 else (max(inner_right + 1, begin), end)
        _wing_rim(line, rim_begin, rim_end, star, radius, amount, share, per_px)
        _wing_row(line, max(inner_left, begin), min(inner_right, end), star, amount, share, per_px)


@kernel
def _add_line(
    image: FloatArray, sums: FloatArray, line: FloatArray, row: int, low_x: int, ends: tuple[int, int]
) -> None:
    """Add a row of the wings to the sums of the columns, and to the image where it is on the image.

    Light is summed by columns because these additions are independent of each other and can be vectorised, unlike the
    sum over a row.
    """
    height, width = image.shape
    left, right = ends
    cut_left, cut_right = max(left, 0), min(right, width - 1)
    if row < 0 or row >= height or cut_left > cut_right:  # entirely outside the image
        cut_left, cut_right = right + 1, right
    # Left of the image, on the image, and right of it: three loops without a condition inside.
    for i in range(left - low_x, cut_left - low_x):
        sums[i] += line[i]
    pixels, part = image[min(max(row, 0), height - 1), cut_left:], line[cut_left - low_x :]
    tally = sums[cut_left - low_x :]
    for i in range(cut_right - cut_left + 1):
        pixels[i] += part[i]
        tally[i] += part[i]
    for i in range(cut_right + 1 - low_x, right + 1 - low_x):
        sums[i] += line[i]


@kernel_part
def _wing_row(
    line: FloatArray,
    left: int,
    right: int,
    star: tuple[float, float],
    amount: float,
    share: FloatArray,
    per_px: float,
) -> None:
    """Fill the pixels left … right of a row of the wings inside the taper."""
    # The compiler vectorises the table look-up only with unsigned 32-bit indices.
    if left > right:
        return
    square, start = star[1] * star[1], left - star[0]
    pixels = line[left : right + 1]
    for i in range(np.int32(right - left + 1)):
        dx = start + i
        position = math.sqrt(dx * dx + square) * per_px
        m = np.uint32(np.int32(position))
        low = share[m]
        pixels[i] = amount * (low + (position - np.int32(position)) * (share[m + np.uint32(1)] - low))


@kernel_part
def _wing_rim(
    line: FloatArray,
    left: int,
    right: int,
    star: tuple[float, float],
    radius: float,
    amount: float,
    share: FloatArray,
    per_px: float,
) -> None:
    """Fill the pixels left … right of a row of the wings within the taper."""
    last = len(share) - 2
    for i in range(left, right + 1):
        r = math.sqrt((i - star[0]) * (i - star[0]) + star[1] * star[1])
        position = r * per_px
        m = min(int(position), last)
        t = min(max((radius + TAPER_PX - r) / TAPER_PX, 0.0), 1.0)
        line[i] = amount * _smooth_step(t) * (share[m] + (position - m) * (share[m + 1] - share[m]))
