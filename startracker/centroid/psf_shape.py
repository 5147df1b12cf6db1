"""The star image of a frame, measured from its brightest stars: an elliptical Gaussian, or one drawn out by smear."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.bias import SMALLEST_SIGMA_PX
from startracker.centroid.cholesky import factorise, substitute
from startracker.centroid.moments import Prepared
from startracker.centroid.psf_kernel import fit_stars
from startracker.centroid.psf_model import PsfModel, gaussian_psf
from startracker.centroid.psf_sums import normal_equations
from startracker.centroid.window import read_pixels
from startracker.detection.plane import Plane
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.kernels import kernel
from startracker.sorting import median

__all__ = ["fit_gaussians", "frame_psf", "is_alone"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_SHAPE_STARS = 9
"""Brightest clean stars whose shapes are fitted."""
_FEWEST_ALONE = 3
_LARGEST_HALF_PX = 8
_NODES = np.polynomial.legendre.leggauss(3)[0] / 2.0
_WEIGHTS = np.polynomial.legendre.leggauss(3)[1] / 2.0
_STEPS = 15
_CONVERGED = 1e-3
_LENGTHS = (0.9, 1.0, 1.1)
_STREAK_RATIO = 1.5
"""Ratio of the axes from which a line is tried instead of an ellipse."""


@kernel
def fit_gaussians(
    image: Image,
    level: Plane,
    noise: Plane,
    xs: FloatArray,
    ys: FloatArray,
    half: int,
    xx: float,
    yy: float,
    inverse_gain: float,
) -> FloatArray:
    """Variances along x and y and covariance (N, 3), px², of pixel-integrated Gaussians fitted to stars; NaN: none.

    Gauss-Newton in x, y, ln(flux), xx, yy, xy, weighted with the noise of the model; pixels are integrated by
    3×3 Gauss-Legendre nodes. `xx`, `yy` are the start.
    """
    height, width = image.shape
    out = np.full((len(xs), 3), np.nan)
    side, nodes = 2 * half + 1, len(_NODES)
    gradient, normal, right = np.empty(6), np.zeros((6, 6)), np.empty(6)
    slopes, pixels = np.empty((6, side * side)), np.empty((5, side * side))
    signal, dark, weights, residuals, work = pixels[0], pixels[1], pixels[2], pixels[3], pixels[4]
    # the Gaussian is a product of one factor along x, one along y and one of both, which steps from pixel to pixel
    along_x, along_y = np.empty(nodes * side), np.empty(nodes * side)
    both, step_y = np.empty((nodes, nodes * side)), np.empty(nodes * side)
    for index in range(len(xs)):
        cx, cy = round(xs[index]), round(ys[index])
        x, y, a, b, c = xs[index], ys[index], xx, yy, 0.0
        flux = -1.0
        low_x, high_x = max(cx - half, 0), min(cx + half + 1, width)
        low_y, high_y = max(cy - half, 0), min(cy + half + 1, height)
        wide, high = high_x - low_x, high_y - low_y
        read_pixels(image, level, noise, low_x, low_y, wide, high, np.inf, signal, dark)
        for _ in range(_STEPS):
            above, below = 0.0, 0.0
            determinant = a * b - c * c
            ia, ib, ic = b / determinant, a / determinant, -c / determinant
            scale = 1.0 / (2.0 * math.pi * math.sqrt(determinant))
            for k in range(nodes * wide):
                u = low_x + k // nodes + _NODES[k % nodes] - x
                along_x[k] = scale * _WEIGHTS[k % nodes] * math.exp(-0.5 * ia * u * u)
                if k < nodes:
                    step_y[k] = math.exp(-ic * u)
            for t in range(nodes):
                v = low_y + _NODES[t] - y
                for k in range(nodes):
                    both[t, k] = math.exp(-ic * (low_x + _NODES[k] - x) * v)
                step_x = math.exp(-ic * v)
                for k in range(nodes, nodes * wide):
                    both[t, k] = step_x * both[t, k - nodes]
            step_both = math.exp(-ic)
            for k in range(nodes, nodes * wide):
                step_y[k] = step_both * step_y[k - nodes]
            for k in range(nodes * high):
                v = low_y + k // nodes + _NODES[k % nodes] - y
                along_y[k] = _WEIGHTS[k % nodes] * math.exp(-0.5 * ib * v * v)
            pixel = np.uint64(0)
            for j in range(low_y, high_y):
                for i in range(low_x, high_x):
                    total, u1, v1, uu, uv, vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                    for t in range(nodes):
                        v = j + _NODES[t] - y
                        row, row_u, row_uu = 0.0, 0.0, 0.0
                        for s in range(nodes):
                            k, u = (i - low_x) * nodes + s, i + _NODES[s] - x
                            p = along_x[k] * both[t, k]
                            row, row_u, row_uu = row + p, row_u + p * u, row_uu + p * u * u
                            both[t, k] *= step_y[k]
                        g = along_y[(j - low_y) * nodes + t]
                        total, u1, uu = total + g * row, u1 + g * row_u, uu + g * row_uu
                        v1, uv, vv = v1 + g * row * v, uv + g * row_u * v, vv + g * row * v * v
                    d, variance = signal[pixel], dark[pixel]
                    gradient[0], gradient[1], gradient[2] = ia * u1 + ic * v1, ic * u1 + ib * v1, total
                    gradient[3] = 0.5 * (ia * ia * uu + 2.0 * ia * ic * uv + ic * ic * vv - ia * total)
                    gradient[4] = 0.5 * (ic * ic * uu + 2.0 * ic * ib * uv + ib * ib * vv - ib * total)
                    gradient[5] = ia * ic * uu + (ia * ib + ic * ic) * uv + ic * ib * vv - ic * total
                    light = flux * total if flux > 0.0 else max(d, 0.0)
                    weight = 1.0 / (variance + light * inverse_gain)
                    above += weight * total * d
                    below += weight * total * total
                    if flux > 0.0:
                        residual = d - flux * total
                        for m in range(6):
                            slopes[m, pixel] = flux * gradient[m]
                        weights[pixel], residuals[pixel] = weight, residual
                    pixel += np.uint64(1)
            if flux <= 0.0:
                flux = above / below
                if not flux > 0.0:
                    break
                continue
            normal_equations(slopes, weights, residuals, wide * high, normal, right, work)
            for m in range(6):
                normal[m, m] *= 1.0 + 1e-9
                if not normal[m, m] > 0.0:
                    normal[m, m] = 1.0
            if not factorise(normal, 6):
                break
            substitute(normal, 6, right)
            largest = 0.0
            for k in range(6):
                largest = max(largest, abs(right[k])) if math.isfinite(right[k]) else np.inf
            if not math.isfinite(largest):
                break
            short = min(1.0, 0.4 * min(a, b, 1.0) / largest) if largest > 0.0 else 1.0
            x, y, flux = x + short * right[0], y + short * right[1], flux * math.exp(short * right[2])
            a, b, c = a + short * right[3], b + short * right[4], c + short * right[5]
            if not (a * b - c * c > 1e-4 and a > 0.0 and abs(x - cx) < half and abs(y - cy) < half):
                break
            if largest < _CONVERGED:
                out[index, 0], out[index, 1], out[index, 2] = a, b, c
                break
    return out


def is_alone(positions: FloatArray, chosen: IntArray, reach: float) -> NDArray[np.bool_]:
    """Which of the chosen positions have no other nearer than `reach` on both axes."""
    near: NDArray[np.bool_] = np.all(np.abs(positions - positions[chosen][:, None]) < reach, axis=2)
    near[np.arange(len(chosen)), chosen] = False
    return np.asarray(~np.any(near, axis=1))


def _frame_shape(
    image: Image,
    level: Plane,
    noise: Plane,
    saturated: NDArray[np.bool_],
    edge: NDArray[np.bool_],
    positions: FloatArray,
    half: int,
    start_xx: float,
    start_yy: float,
    inverse_gain: float,
) -> tuple[FloatArray, FloatArray, tuple[float, float, float], int]:
    """Positions x and y of the brightest clean stars, medians of their shapes, and how many tell theirs."""
    clean = np.flatnonzero(~(saturated | edge) & np.isfinite(positions[:, 0] + positions[:, 1]))[: 2 * _SHAPE_STARS]
    alone = clean[is_alone(positions, clean, 2.0 * _LARGEST_HALF_PX)]
    clean = (alone if len(alone) >= _FEWEST_ALONE else clean)[:_SHAPE_STARS]
    x, y = positions[clean, 0], positions[clean, 1]
    shapes = fit_gaussians(image, level, noise, x, y, half, start_xx, start_yy, inverse_gain)
    told = np.isfinite(shapes[:, 0])
    xx, yy, xy = start_xx, start_yy, 0.0
    if told.any():
        xx, yy, xy = median(shapes[told, 0]), median(shapes[told, 1]), median(shapes[told, 2])
        if not xx * yy - xy * xy > SMALLEST_SIGMA_PX**4:
            xx, yy, xy = start_xx, start_yy, 0.0
    return x, y, (xx, yy, xy), int(np.count_nonzero(told))


def frame_psf(
    frame: Prepared, spots: Spots, positions: FloatArray, sigmas: tuple[float, float], reach_px: float
) -> PsfModel:
    """The star image of a frame.

    The median ellipse of the brightest clean stars. Where it is elongated, a round Gaussian moved along a line
    is taken instead when it leaves the smaller χ² in the same stars: L² = 12 × the difference of the principal
    variances, then L by the parabola through χ² there and a tenth to either side.

    Parameters
    ----------
    positions : array, shape (N, 2)
        Of the spots, approximate.
    sigmas : (float, float)
        Widths along x and y by the moments, for the start and in case no star tells.
    reach_px : float
        Least half width of the table.
    """
    start_xx, start_yy = (max(sigma**2, SMALLEST_SIGMA_PX**2) for sigma in sigmas)
    half = min(max(frame.half, math.ceil(2.5 * max(sigmas))), _LARGEST_HALF_PX)
    x, y, (xx, yy, xy), told = _frame_shape(
        frame.image,
        frame.level,
        frame.noise,
        spots.saturated,
        spots.edge,
        positions,
        half,
        start_xx,
        start_yy,
        frame.inverse_gain,
    )
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    radius = max(reach_px, 2.5 * math.sqrt(middle + spread) + 2.0)
    ellipse = gaussian_psf(xx, yy, xy, radius_px=radius)
    minor, major = middle - spread, middle + spread
    if major < _STREAK_RATIO**2 * minor or not told:
        return ellipse
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    window = np.full(len(x), min(math.ceil(2.5 * math.sqrt(major)), _LARGEST_HALF_PX))
    length = math.sqrt(12.0 * (major - minor))
    along, across = length * math.cos(angle), length * math.sin(angle)
    round_one = gaussian_psf(minor, minor, radius_px=radius)
    lines = [round_one.smeared(f * along, f * across) for f in _LENGTHS]
    misfits = [_misfit(frame, model, x, y, window) for model in lines]
    if min(misfits) > _misfit(frame, ellipse, x, y, window):
        return ellipse
    square, slope, _ = np.polyfit(_LENGTHS, misfits, 2)
    if not square > 0:
        return lines[int(np.argmin(misfits))]
    best = min(max(-0.5 * slope / square, 2 * _LENGTHS[0] - _LENGTHS[1]), 2 * _LENGTHS[2] - _LENGTHS[1])
    return round_one.smeared(best * along, best * across)


def _misfit(frame: Prepared, model: PsfModel, x: FloatArray, y: FloatArray, halves: IntArray) -> float:
    """Median χ² per degree of freedom of stars; one that the image does not fit at all counts against it."""
    fits = fit_stars(
        frame.image,
        frame.level,
        frame.noise,
        *model.samples,
        np.arange(len(x)),
        x,
        y,
        halves,
        np.full(len(x), np.inf),
        frame.inverse_gain,
        frame.settings.flat_field_error,
        True,
    )
    return float(np.median(np.nan_to_num(fits[:, 6] / fits[:, 7], nan=1e6)))
