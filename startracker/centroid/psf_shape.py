"""The star image of a frame, measured from its brightest stars: an elliptical Gaussian, or a smeared one."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from startracker.arrays import FloatArray, IntArray
from startracker.centroid.bias import SMALLEST_SIGMA_PX
from startracker.centroid.frame import MODEL_STARS, Prepared, brightest_alone
from startracker.centroid.psf_kernel import Starts, fit_stars
from startracker.centroid.psf_model import PsfModel, gaussian_psf
from startracker.centroid.psf_sums import normal_equations
from startracker.centroid.window import Pixels, read_pixels
from startracker.detection.spots import Spots
from startracker.geometry.linalg import factorise, substitute
from startracker.kernels import kernel, kernel_part
from startracker.sorting import finite_medians

Shape: TypeAlias = tuple[float, float, float]

_LOOKED_AT, _FEWEST_ALONE = 18, 3
_LARGEST_HALF_PX = 8
_NODES = np.polynomial.legendre.leggauss(3)[0] / 2.0
_WEIGHTS = np.polynomial.legendre.leggauss(3)[1] / 2.0
_STEPS = 15
_CONVERGED = 1e-3
_LENGTHS = (0.9, 1.0, 1.1)
_STREAK_RATIO = 1.5
"""Ratio of the axes from which a line is tried instead of an ellipse."""


class _Space(NamedTuple):
    """Working space of `fit_gaussians` for windows of N pixels, W wide."""

    pixels: FloatArray
    """(4, N)."""
    slopes: FloatArray
    """(6, N)."""
    factors: FloatArray
    """(6, 3 W)."""
    normal: FloatArray
    """(6, 6)."""
    right: FloatArray
    """(6,)."""


def fit_gaussians(pixels: Pixels, starts: Starts, stars: IntArray, half: int, shape: Shape) -> Shape:
    """Median variances along x and y and covariance, px², of pixel-integrated Gaussians fitted to stars; NaN: none.

    Gauss-Newton in x, y, ln(flux), xx, yy, xy, weighted with the noise of the model; `shape` is the start.
    """
    side, found = 2 * half + 1, np.full((len(stars), 3), np.nan)
    factors = np.empty((3 + len(_NODES), len(_NODES) * side))
    space = _Space(np.empty((4, side**2)), np.empty((6, side**2)), factors, np.empty((6, 6)), np.empty(6))
    _fit_gaussians(pixels, starts, stars, half, shape, space, found)
    xx, yy, xy = finite_medians(found)
    return xx, yy, xy


@kernel
def _fit_gaussians(
    pixels: Pixels, starts: Starts, stars: IntArray, half: int, shape: Shape, space: _Space, found: FloatArray
) -> None:
    """Fills the shapes (N, 3) of stars, as far as they can be fitted."""
    for n in range(len(stars)):
        _fit_gaussian(pixels, starts.x[stars[n]], starts.y[stars[n]], half, shape, space, found[n])


@kernel_part
def _fit_gaussian(
    pixels: Pixels, x: float, y: float, half: int, shape: Shape, space: _Space, found: FloatArray
) -> None:
    """Fills the shape of one star, if it can be fitted."""
    height, width = pixels.image.shape
    (a, b, c), cx, cy, flux = shape, round(x), round(y), -1.0
    left, top = max(cx - half, 0), max(cy - half, 0)
    wide, high = min(cx + half + 1, width) - left, min(cy + half + 1, height) - top
    count, work, slopes, normal, right = wide * high, space.pixels, space.slopes, space.normal, space.right
    signal, dark, weights, residuals = work[0, :count], work[1, :count], work[2, :count], work[3, :count]
    read_pixels(pixels, left, top, wide, high, np.inf, signal, dark)
    for _ in range(_STEPS):
        _gaussian_slopes((left - x, top - y), wide, high, (a, b, c), slopes, space.factors)
        above, below = 0.0, 0.0
        for n in range(count):
            light = flux * slopes[2, n] if flux > 0.0 else max(signal[n], 0.0)
            weights[n] = 1.0 / (dark[n] + light * pixels.inverse_gain)
            above += weights[n] * slopes[2, n] * signal[n]
            below += weights[n] * slopes[2, n] * slopes[2, n]
            residuals[n] = signal[n] - light
        if flux <= 0.0:
            flux = above / below
            if not flux > 0.0:
                return
            continue
        # a loop: for the error that an array expression may raise, numba compiles its text, which takes seconds
        for m in range(6):
            for n in range(count):
                slopes[m, n] *= flux
        normal_equations(slopes, weights, residuals, normal, right)
        for m in range(6):
            normal[m, m] *= 1.0 + 1e-9
            if not normal[m, m] > 0.0:
                normal[m, m] = 1.0
        if not factorise(normal, 6):
            return
        substitute(normal, 6, right)
        largest = 0.0
        for k in range(6):
            largest = max(largest, abs(right[k])) if math.isfinite(right[k]) else np.inf
        if not math.isfinite(largest):
            return
        short = min(1.0, 0.4 * min(a, b, 1.0) / largest) if largest > 0.0 else 1.0
        x, y, flux = x + short * right[0], y + short * right[1], flux * math.exp(short * right[2])
        a, b, c = a + short * right[3], b + short * right[4], c + short * right[5]
        if not (a * b - c * c > 1e-4 and a > 0.0 and abs(x - cx) < half and abs(y - cy) < half):
            return
        if largest < _CONVERGED:
            found[0], found[1], found[2] = a, b, c
            return


@kernel_part
def _gaussian_slopes(
    corner: tuple[float, float], wide: int, high: int, shape: Shape, out: FloatArray, factors: FloatArray
) -> None:
    """Slopes (6, N) by x, y, ln(flux), xx, yy, xy of a unit Gaussian in the pixels of a window, whose first pixel is at
    `corner` from its centre; pixels are integrated by 3 × 3 Gauss-Legendre nodes.

    The Gaussian is a product of one factor along x, one along y and one of both, which steps from pixel to pixel.
    """
    nodes, (left, top), (a, b, c) = len(_NODES), corner, shape
    along_x, along_y, step_y, both = factors[0], factors[1], factors[2], factors[3:]
    determinant = a * b - c * c
    ia, ib, ic = b / determinant, a / determinant, -c / determinant
    scale = 1.0 / (2.0 * math.pi * math.sqrt(determinant))
    for k in range(nodes * wide):
        u = left + k // nodes + _NODES[k % nodes]
        along_x[k] = scale * _WEIGHTS[k % nodes] * math.exp(-0.5 * ia * u * u)
        step_y[k] = math.exp(-ic * u) if k < nodes else math.exp(-ic) * step_y[k - nodes]
    for t in range(nodes):
        v = top + _NODES[t]
        step_x = math.exp(-ic * v)
        for k in range(nodes * wide):
            both[t, k] = math.exp(-ic * (left + _NODES[k]) * v) if k < nodes else step_x * both[t, k - nodes]
    for k in range(nodes * high):
        v = top + k // nodes + _NODES[k % nodes]
        along_y[k] = _WEIGHTS[k % nodes] * math.exp(-0.5 * ib * v * v)
    pixel = np.uint64(0)
    for j in range(high):
        for i in range(wide):
            total, u1, v1, uu, uv, vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for t in range(nodes):
                v = top + j + _NODES[t]
                row, row_u, row_uu = 0.0, 0.0, 0.0
                for s in range(nodes):
                    k, u = i * nodes + s, left + i + _NODES[s]
                    p = along_x[k] * both[t, k]
                    row, row_u, row_uu = row + p, row_u + p * u, row_uu + p * u * u
                    both[t, k] *= step_y[k]
                g = along_y[j * nodes + t]
                total, u1, uu = total + g * row, u1 + g * row_u, uu + g * row_uu
                v1, uv, vv = v1 + g * row * v, uv + g * row_u * v, vv + g * row * v * v
            out[0, pixel], out[1, pixel], out[2, pixel] = ia * u1 + ic * v1, ic * u1 + ib * v1, total
            out[3, pixel] = 0.5 * (ia * ia * uu + 2.0 * ia * ic * uv + ic * ic * vv - ia * total)
            out[4, pixel] = 0.5 * (ic * ic * uu + 2.0 * ic * ib * uv + ib * ib * vv - ib * total)
            out[5, pixel] = ia * ic * uu + (ia * ib + ic * ic) * uv + ic * ib * vv - ic * total
            pixel += np.uint64(1)


def frame_psf(frame: Prepared, spots: Spots, starts: Starts, sigmas: tuple[float, float], reach_px: float) -> PsfModel:
    """The star image of a frame.

    The median ellipse of the brightest clean stars. Where it is elongated, a round Gaussian moved along a line
    is taken instead when it leaves the smaller χ² in the same stars: L² = 12 × the difference of the principal
    variances, then L by the parabola through χ² there and a tenth to either side.

    Parameters
    ----------
    starts : Starts
        Approximate positions of the spots.
    sigmas : (float, float)
        Widths along x and y by the moments, for the start and in case no star can be measured.
    reach_px : float
        Least half width of the table.
    """
    half = min(max(frame.half, math.ceil(2.5 * max(sigmas))), _LARGEST_HALF_PX)
    unfit = spots.saturated | spots.edge
    chosen = brightest_alone(starts.x, starts.y, spots.flux, unfit, _LOOKED_AT)
    if len(chosen) < _FEWEST_ALONE:
        chosen = np.flatnonzero(~unfit & np.isfinite(starts.x + starts.y))[:MODEL_STARS]
    xx, yy, xy = start = max(sigmas[0], SMALLEST_SIGMA_PX) ** 2, max(sigmas[1], SMALLEST_SIGMA_PX) ** 2, 0.0
    found = fit_gaussians(frame.pixels, starts, chosen, half, start)
    if found[0] * found[1] - found[2] ** 2 > SMALLEST_SIGMA_PX**4:
        xx, yy, xy = found
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    radius = max(reach_px, 2.5 * math.sqrt(middle + spread) + 2.0)
    ellipse = gaussian_psf(xx, yy, xy, radius_px=radius)
    minor, major = middle - spread, middle + spread
    if major < _STREAK_RATIO**2 * minor or math.isnan(found[0]):
        return ellipse
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    window = min(math.ceil(2.5 * math.sqrt(major)), _LARGEST_HALF_PX)
    stars = Starts(starts.x[chosen], starts.y[chosen], np.full(len(chosen), window), np.full(len(chosen), np.inf))
    length = math.sqrt(12.0 * (major - minor))
    along, across = length * math.cos(angle), length * math.sin(angle)
    round_one = gaussian_psf(minor, minor, radius_px=radius)
    lines = [round_one.smeared(f * along, f * across) for f in _LENGTHS]
    misfits = [_misfit(frame, model, stars) for model in lines]
    if min(misfits) > _misfit(frame, ellipse, stars):
        return ellipse
    square, slope, _ = np.polyfit(_LENGTHS, misfits, 2)
    if not square > 0:
        return lines[int(np.argmin(misfits))]
    best = min(max(-0.5 * slope / square, 2 * _LENGTHS[0] - _LENGTHS[1]), 2 * _LENGTHS[2] - _LENGTHS[1])
    return round_one.smeared(best * along, best * across)


def _misfit(frame: Prepared, model: PsfModel, stars: Starts) -> float:
    """Median χ² per degree of freedom of stars; one that the image does not fit at all counts against it."""
    fits = fit_stars(frame.pixels, model.samples, stars, np.arange(len(stars.x)), True)
    return float(np.median(np.nan_to_num(fits[:, 6] / fits[:, 7], nan=1e6)))
