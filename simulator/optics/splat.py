"""Rendering of stars along their paths with a PSF."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.optics.error_function import shares_of_pixels
from simulator.optics.psf import Psf
from simulator.optics.psf_table import TAPER_PX, TAPS
from simulator.optics.wings import Wings, add_wings
from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray


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
    if psf.core is None:
        add_gaussians(image, xy, weights, electrons, psf.radius_px(electrons), psf.sigma_px, psf.sigma_y_px)
    else:
        add_tabulated(image, *_tabulated(xy, weights, electrons, psf))


def add_each_star(images: FloatArray, xy: FloatArray, weights: FloatArray, electrons: FloatArray, psf: Psf) -> None:
    """`add_stars` of a tabulated PSF, with a separate image (N, H, W) of each star."""
    stars, *table = _tabulated(xy, weights, electrons, psf)
    for n, image in enumerate(images):
        # Slices of one star, because the kernel takes arrays.
        one = slice(n, n + 1)
        add_tabulated(image, _Stars(xy[one], weights, electrons[one], stars.radius[one], stars.whole[one]), *table)


def _tabulated(
    xy: FloatArray, weights: FloatArray, electrons: FloatArray, psf: Psf
) -> tuple[_Stars, NDArray[np.float64] | NDArray[np.float32], int, Wings]:
    """Arguments of `add_tabulated`."""
    assert psf.core is not None
    assert psf.wing is not None
    assert psf.drawn is not None
    radius = psf.radius_px(electrons)
    whole = np.interp(radius, np.arange(len(psf.drawn)) * psf.wing_step_px, psf.drawn)
    wings = Wings(psf.wing, 1.0 / psf.wing_step_px, 1.0 / psf.aspect, psf.core.shape[3] // 2)
    return _Stars(xy, weights, electrons, radius, whole), psf.core, psf.phases, wings


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
            # The condition is negated so that it also skips NaN, with which every comparison is false.
            if not (x > -1.0 - radius_x and x < width + radius_x and y > -1.0 - radius_y and y < height + radius_y):
                continue
            left, right = max(math.ceil(x - radius_x), 0), min(math.floor(x + radius_x), width - 1)
            top, bottom = max(math.ceil(y - radius_y), 0), min(math.floor(y + radius_y), height - 1)
            if left > right or top > bottom:
                continue
            # A Gaussian separates, so the image is the outer product of its shares in columns and rows.
            shares_of_pixels(column, left, right, x, scale_x)
            shares_of_pixels(row, top, bottom, y, scale_y)
            amount = electrons[n] * weights[k]
            for j in range(top, bottom + 1):
                line = amount * row[j - top]
                for i in range(right - left + 1):
                    image[j, left + i] += line * column[i]


class _Stars(NamedTuple):
    """Stars that `add_tabulated` renders."""

    xy: FloatArray
    """Positions (N, K, 2) at K moments of the exposure."""
    weights: FloatArray
    """Fraction of the exposure of each moment (K,)."""
    electrons: FloatArray
    """Electrons of each star (N,)."""
    radius: FloatArray
    """Radius of each star (N,), pixels along columns."""
    whole: FloatArray
    """Fraction of each star's light (N,) within that radius; NaN if it depends on the sub-pixel position."""


class _Work(NamedTuple):
    """Scratch arrays of `add_tabulated`, allocated once."""

    stamp: FloatArray
    """Light in the pixels of a stamp (M²,), of the moments in one pixel."""
    moments: FloatArray
    """Sums of that light times 1, x, y, x², xy, y² (6,)."""
    lines: FloatArray
    """A row of the wings, and the sum of their rows."""


@kernel
def add_tabulated(
    image: FloatArray, stars: _Stars, core: NDArray[np.float64] | NDArray[np.float32], phases: int, wings: Wings
) -> None:
    """Kernel: a tabulated PSF: core (stamps at all phases, P × P × M × M, `phases` per pixel) by
    Lagrange interpolation between phases, wings by distance.

    For stars whose radius does not exceed the stamp only the stamp is rendered. Others get the fraction `whole` of
    their light at any sub-pixel position: the wings are summed while they are rendered, and the stamp is scaled (by
    about 1e-5, at most 6e-5) to contain the rest, unless that depends on the sub-pixel position.
    """
    height, width = image.shape
    # Fields are read outside of the loops, because numba counts references at each access of a tuple.
    xy, weights, electrons = stars.xy, stars.weights, stars.electrons
    side, half = core.shape[3], wings.half
    flat = core.reshape(core.shape[0], core.shape[1], side * side)
    longest = 0.0
    for n in range(len(stars.radius)):
        longest = max(longest, stars.radius[n])
    lines = np.zeros((2, 2 * math.ceil(longest + TAPER_PX) + 4))
    stamp, middle = np.empty(side * side), core.shape[0] // 2
    moments, weight_x, weight_y = np.empty(6), np.empty(TAPS), np.empty(TAPS)
    work = _Work(stamp, moments, lines)
    for n in range(xy.shape[0]):
        radius = stars.radius[n]
        reach_x = radius + TAPER_PX + 1.0 if radius > half else half + 1.0
        reach_y = (radius + TAPER_PX) / wings.row_px + 1.0 if radius > half else half + 1.0
        pixel, pending = (0, 0), False
        for k in range(xy.shape[1]):
            x, y = xy[n, k, 0], xy[n, k, 1]
            if not (-1.0 - reach_x < x < width + reach_x and -1.0 - reach_y < y < height + reach_y):
                continue
            # Consecutive moments within one pixel share a stamp, which is added when the path leaves the pixel. The
            # wings then need only the moments of the light, and are rendered once per pixel instead of once per moment.
            now = (math.floor(x + 0.5), math.floor(y + 0.5))
            if pending and now != pixel:
                _add_pixel(image, work, pixel, radius, stars.whole[n], wings)
                pending = False
            if not pending:
                stamp[:] = 0.0
                moments[:] = 0.0
                pixel, pending = now, True
            dx, dy, amount = x - pixel[0], y - pixel[1], electrons[n] * weights[k]
            _add_moments(moments, dx, dy, amount)
            first_x = _lagrange(weight_x, dx * phases, amount) + middle
            first_y = _lagrange(weight_y, dy * phases, 1.0) + middle
            # The taps along x are written out, so that one pass over the stamp adds four phases.
            for b in range(TAPS):
                t0, t1 = flat[first_y + b, first_x], flat[first_y + b, first_x + 1]
                t2, t3 = flat[first_y + b, first_x + 2], flat[first_y + b, first_x + 3]
                w0, w1 = weight_y[b] * weight_x[0], weight_y[b] * weight_x[1]
                w2, w3 = weight_y[b] * weight_x[2], weight_y[b] * weight_x[3]
                for i in range(side * side):
                    stamp[i] += w0 * t0[i] + w1 * t1[i] + w2 * t2[i] + w3 * t3[i]
        if pending:
            _add_pixel(image, work, pixel, radius, stars.whole[n], wings)


@kernel_part
def _add_moments(moments: FloatArray, dx: float, dy: float, amount: float) -> None:
    """Add light at (dx, dy) from the centre of a pixel to the sums of 1, x, y, x², xy, y²."""
    moments[0] += amount
    moments[1] += amount * dx
    moments[2] += amount * dy
    moments[3] += amount * dx * dx
    moments[4] += amount * dx * dy
    moments[5] += amount * dy * dy


@kernel
def _add_pixel(
    image: FloatArray, work: _Work, pixel: tuple[int, int], radius: float, whole: float, wings: Wings
) -> None:
    """Add the light collected in one pixel: its wings, and the stamp scaled to the rest."""
    if radius > wings.half:
        outside = add_wings(image, work.lines, work.moments, pixel, radius, wings)
        if not math.isnan(whole):
            _fill(work.stamp, whole * work.moments[0] - outside)
    _add_stamp(image, work.stamp, pixel[0], pixel[1], wings.half)


@kernel_part
def _fill(stamp: FloatArray, amount: float) -> None:
    """Scale a stamp to a given amount of light."""
    held = 0.0
    for light in stamp:
        held += light
    if held > 0.0:
        for i in range(len(stamp)):
            stamp[i] *= amount / held


@kernel_part
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
