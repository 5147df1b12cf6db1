"""Rendering of stars along their paths with a PSF."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.optics.error_function import shares_of_pixels
from simulator.optics.psf import Psf
from simulator.optics.psf_table import TAPER_PX, TAPS, fade
from startracker.kernels import kernel

FloatArray = NDArray[np.float64]


def render_stars(
    shape: tuple[int, int],
    xy: FloatArray,
    weights: FloatArray,
    electrons: ArrayLike,
    psf: Psf,
    out: FloatArray | None = None,
) -> FloatArray:
    """Mean photo-electrons of stars in each pixel.

    Parameters
    ----------
    shape : (int, int)
        Rows, columns.
    xy : (N, K, 2) or (N, 2) array
        Pixel positions of each star at K moments of the exposure (`simulator.optics.smear`); moments with NaN are
        skipped.
    weights : (K,) array
        Fraction of the exposure of each moment.
    electrons : (N,) array
        Electrons of each star over the exposure.
    psf : Psf
        Point-spread function.
    out : (rows, columns) array, optional
        Image to add to; by default a new one.

    Returns
    -------
    (rows, columns) float64 array
        Stars partly outside the image contribute the part inside.
    """
    image = np.zeros(shape) if out is None else out
    xy = np.ascontiguousarray(xy, dtype=float)
    if xy.ndim == 2:
        xy = xy[:, None, :]
    e = np.ascontiguousarray(electrons, dtype=float)
    add_stars(image, xy, np.ascontiguousarray(weights, dtype=float), e, psf)
    return image


def add_stars(image: FloatArray, xy: FloatArray, weights: FloatArray, electrons: FloatArray, psf: Psf) -> None:
    """Add stars to `image` in place; shapes as in `render_stars`, all arrays contiguous float64."""
    radius = psf.radius_px(electrons)
    if psf.core is None or psf.wing is None or psf.drawn is None:
        add_gaussians(image, xy, weights, electrons, radius, psf.sigma_px, psf.sigma_y_px)
    else:
        add_tabulated(
            image,
            xy,
            weights,
            electrons,
            radius,
            psf.core,
            psf.phases,
            np.interp(radius, np.arange(len(psf.drawn)) * psf.wing_step_px, psf.drawn),
            psf.wing,
            1.0 / psf.wing_step_px,
            1.0 / psf.aspect,
        )


@kernel
def add_gaussians(
    image: FloatArray,
    xy: FloatArray,
    weights: FloatArray,
    electrons: FloatArray,
    radius: FloatArray,
    sigma_x: float,
    sigma_y: float,
) -> None:
    """Kernel: Gaussians integrated over pixels, ¼ Δerf(x/σ_x√2) Δerf(y/σ_y√2), in boxes of half width `radius`
    (along rows × σ_y/σ_x) to the edge of the last pixel."""
    height, width = image.shape
    scale_x, scale_y = 1.0 / (math.sqrt(2.0) * sigma_x), 1.0 / (math.sqrt(2.0) * sigma_y)
    column, row = np.empty(width), np.empty(height)
    for n in range(xy.shape[0]):
        radius_x, radius_y = radius[n] + 0.5, radius[n] * sigma_y / sigma_x + 0.5
        for k in range(xy.shape[1]):
            x, y = xy[n, k, 0], xy[n, k, 1]
            if not (
                x > -1.0 - radius_x and x < width + radius_x and y > -1.0 - radius_y and y < height + radius_y
            ):  # outside the image, or NaN
                continue
            left, right = max(math.ceil(x - radius_x), 0), min(math.floor(x + radius_x), width - 1)
            top, bottom = max(math.ceil(y - radius_y), 0), min(math.floor(y + radius_y), height - 1)
            if left > right or top > bottom:
                continue
            shares_of_pixels(column, left, right, x, scale_x)
            shares_of_pixels(row, top, bottom, y, scale_y)
            amount = electrons[n] * weights[k]
            for j in range(top, bottom + 1):
                line = amount * row[j - top]
                for i in range(right - left + 1):
                    image[j, left + i] += line * column[i]


@kernel
def add_tabulated(
    image: FloatArray,
    xy: FloatArray,
    weights: FloatArray,
    electrons: FloatArray,
    radius: FloatArray,
    core: NDArray[np.float64] | NDArray[np.float32],
    phases: int,
    drawn: FloatArray,
    wing: FloatArray,
    wing_per_px: float,
    row_px: float,
) -> None:
    """Kernel: a tabulated PSF: core by Lagrange interpolation between phases, wings by distance.

    For stars whose `radius` does not exceed the stamp only the stamp is rendered. Others get the fraction `drawn` of
    their light at any sub-pixel position: the wings are summed while they are rendered, and the stamp is scaled (by
    about 1e-5, at most 6e-5) to contain the rest. `row_px` is the pitch along rows over that along columns.
    """
    height, width = image.shape
    side = core.shape[3]
    half = side // 2
    middle = core.shape[0] // 2
    flat = core.reshape(core.shape[0], core.shape[1], side * side)
    stamp, moments = np.empty(side * side), np.empty(6)  # fraction of the light in the pixel at (drawn_x, drawn_y)
    weight_x, weight_y = np.empty(TAPS), np.empty(TAPS)
    longest = 0.0
    for n in range(len(radius)):
        longest = max(longest, radius[n])
    lines = np.zeros((2, 2 * math.ceil(longest + TAPER_PX) + 4))  # a row of the wings, and the sum of their rows
    for n in range(xy.shape[0]):
        winged = radius[n] > half
        reach_x = radius[n] + TAPER_PX + 1.0 if winged else half + 1.0
        reach_y = (radius[n] + TAPER_PX) / row_px + 1.0 if winged else half + 1.0
        drawn_x, drawn_y, pending = 0, 0, False
        for k in range(xy.shape[1]):
            x, y = xy[n, k, 0], xy[n, k, 1]
            if not (x > -1.0 - reach_x and x < width + reach_x and y > -1.0 - reach_y and y < height + reach_y):
                continue
            amount = electrons[n] * weights[k]
            centre_x, centre_y = math.floor(x + 0.5), math.floor(y + 0.5)
            if pending and (centre_x != drawn_x or centre_y != drawn_y):
                if winged:
                    left = drawn[n] * moments[0]
                    left -= _add_wings(
                        image, lines, moments, drawn_x, drawn_y, half, radius[n], wing, wing_per_px, row_px
                    )
                    _fill(stamp, left)
                _add_stamp(image, stamp, drawn_x, drawn_y, half)
                pending = False
            if not pending:
                stamp[:] = 0.0
                moments[:] = 0.0
                drawn_x, drawn_y, pending = centre_x, centre_y, True
            dx, dy = x - centre_x, y - centre_y
            moments[0] += amount
            moments[1] += amount * dx
            moments[2] += amount * dy
            moments[3] += amount * dx * dx
            moments[4] += amount * dx * dy
            moments[5] += amount * dy * dy
            first_x = _lagrange(weight_x, (x - centre_x) * phases, amount) + middle
            first_y = _lagrange(weight_y, (y - centre_y) * phases, 1.0) + middle
            for b in range(TAPS):
                t0, t1 = flat[first_y + b, first_x], flat[first_y + b, first_x + 1]
                t2, t3 = flat[first_y + b, first_x + 2], flat[first_y + b, first_x + 3]
                w0, w1 = weight_y[b] * weight_x[0], weight_y[b] * weight_x[1]
                w2, w3 = weight_y[b] * weight_x[2], weight_y[b] * weight_x[3]
                for i in range(side * side):
                    stamp[i] += w0 * t0[i] + w1 * t1[i] + w2 * t2[i] + w3 * t3[i]
        if pending:
            if winged:
                left = drawn[n] * moments[0]
                left -= _add_wings(image, lines, moments, drawn_x, drawn_y, half, radius[n], wing, wing_per_px, row_px)
                _fill(stamp, left)
            _add_stamp(image, stamp, drawn_x, drawn_y, half)


@kernel
def _fill(stamp: FloatArray, amount: float) -> None:
    """Scale a stamp to a given amount of light."""
    held = stamp.sum()
    if held > 0.0:
        stamp *= amount / held


@kernel
def _add_stamp(image: FloatArray, stamp: FloatArray, centre_x: int, centre_y: int, half: int) -> None:
    """Add the part of a square stamp that is on the image."""
    height, width = image.shape
    side = 2 * half + 1
    left, right = max(centre_x - half, 0), min(centre_x + half, width - 1)
    for j in range(max(centre_y - half, 0), min(centre_y + half, height - 1) + 1):
        start = (j - centre_y + half) * side + half - centre_x
        for i in range(left, right + 1):
            image[j, i] += stamp[start + i]


@kernel
def _lagrange(out: FloatArray, position: float, scale: float) -> int:
    """Weights of TAPS points around `position` on an integer grid, times `scale`; returns the first point."""
    first = math.floor(position) - TAPS // 2 + 1
    t = position - first
    for a in range(TAPS):
        w = scale
        for b in range(TAPS):
            if b != a:
                w *= (t - b) / (a - b)
        out[a] = w
    return first


@kernel
def _add_wings(
    image: FloatArray,
    lines: FloatArray,
    moments: FloatArray,
    centre_x: int,
    centre_y: int,
    half: int,
    radius: float,
    wing: FloatArray,
    wing_per_px: float,
    row_px: float,
) -> float:
    """Light outside the stamp of the moments of a path that are in the same pixel, from their sums of 1, x, y, x², xy,
    y²; returns its sum, on the image and outside, or 0 if the stamp is outside the image and the sum is not needed.

    At this distance the moments are represented by two points with the same mean and variance along the path: the error
    is about 0.08 (L/r)⁴ of the light there, for a path of length L ≤ √2 at r > half.
    """
    amount = moments[0]
    if amount == 0.0:
        return 0.0
    mean_x, mean_y = moments[1] / amount, moments[2] / amount
    xx, yy = moments[3] / amount - mean_x**2, moments[5] / amount - mean_y**2
    xy = moments[4] / amount - mean_x * mean_y
    x, y = centre_x + mean_x, centre_y + mean_y
    variance = 0.5 * (xx + yy) + math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    if variance < 1e-6:
        still: float = _add_wing(
            image, lines, x, y, centre_x, centre_y, half, radius, amount, wing, wing_per_px, row_px
        )
        return still
    spread, angle = math.sqrt(variance), 0.5 * math.atan2(2.0 * xy, xx - yy)
    dx, dy = spread * math.cos(angle), spread * math.sin(angle)
    total: float = _add_wing(
        image, lines, x + dx, y + dy, centre_x, centre_y, half, radius, 0.5 * amount, wing, wing_per_px, row_px
    )
    total += _add_wing(
        image, lines, x - dx, y - dy, centre_x, centre_y, half, radius, 0.5 * amount, wing, wing_per_px, row_px
    )
    return total


@kernel
def _add_wing(
    image: FloatArray,
    lines: FloatArray,
    x: float,
    y: float,
    centre_x: int,
    centre_y: int,
    half: int,
    radius: float,
    amount: float,
    wing: FloatArray,
    wing_per_px: float,
    row_px: float,
) -> float:
    """Light outside the stamp, out to `radius` and a taper; returns its sum, see `_add_wings`."""
    height, width = image.shape
    end = radius + TAPER_PX
    low_x, high_x = math.ceil(x - end), math.floor(x + end)
    low_y, high_y = math.ceil(y - end / row_px), math.floor(y + end / row_px)
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
        if abs(j - centre_y) <= half:  # the stamp is inside `radius`
            left_end, right_start = centre_x - half - 1, centre_x + half + 1
            for i in range(max(left_end + 1, left), min(right_start - 1, right) + 1):
                line[i - low_x] = 0.0
        else:
            left_end, right_start = math.floor(x), math.floor(x) + 1
        full = math.sqrt(max(radius * radius - dy * dy, 0.0)) if abs(dy) < radius else -1.0
        inner_left, inner_right = math.ceil(x - full), math.floor(x + full)
        if full < 0.0:
            inner_left, inner_right = left_end + 1, right_start - 1
        at = x - low_x  # of the star on the line
        inner_left, inner_right = inner_left - low_x, inner_right - low_x
        left_end, right_start = left_end - low_x, right_start - low_x
        first, last = left - low_x, right - low_x
        _wing_rim(line, first, min(inner_left - 1, left_end, last), at, dy, radius, amount, wing, wing_per_px)
        _wing_row(line, max(inner_left, first), min(left_end, last), at, dy, amount, wing, wing_per_px)
        _wing_row(line, max(right_start, first), min(inner_right, last), at, dy, amount, wing, wing_per_px)
        _wing_rim(line, max(inner_right + 1, right_start, first), last, at, dy, radius, amount, wing, wing_per_px)
        # sums over columns do not depend on the previous pixel, unlike the sum over a row
        cut_left, cut_right = max(left, 0), min(right, width - 1)
        if j < 0 or j >= height or cut_left > cut_right:  # entirely outside the image
            cut_left, cut_right = right + 1, right
        for i in range(first, cut_left - low_x):
            sums[i] += line[i]
        pixels, part = image[min(max(j, 0), height - 1), cut_left:], line[cut_left - low_x :]
        tally = sums[cut_left - low_x :]
        for i in range(cut_right - cut_left + 1):
            pixels[i] += part[i]
            tally[i] += part[i]
        for i in range(cut_right + 1 - low_x, last + 1):
            sums[i] += line[i]
    total: float = sums.sum()
    return total


@kernel
def _wing_row(
    line: FloatArray, left: int, right: int, x: float, dy: float, amount: float, wing: FloatArray, wing_per_px: float
) -> None:
    """Pixels left … right of a row of the wings; unsigned 32-bit indices let the compiler vectorise."""
    if left > right:
        return
    square, start = dy * dy, left - x
    pixels = line[left : right + 1]
    for i in range(np.int32(right - left + 1)):
        dx = start + i
        position = math.sqrt(dx * dx + square) * wing_per_px
        m = np.uint32(np.int32(position))
        low = wing[m]
        pixels[i] = amount * (low + (position - np.int32(position)) * (wing[m + np.uint32(1)] - low))


@kernel
def _wing_rim(
    line: FloatArray,
    left: int,
    right: int,
    x: float,
    dy: float,
    radius: float,
    amount: float,
    wing: FloatArray,
    wing_per_px: float,
) -> None:
    """Pixels left … right of a row of the wings in the taper."""
    last = len(wing) - 2
    for i in range(left, right + 1):
        r = math.sqrt((i - x) * (i - x) + dy * dy)
        position = r * wing_per_px
        m = min(int(position), last)
        line[i] = amount * fade(r, radius) * (wing[m] + (position - m) * (wing[m + 1] - wing[m]))
