"""Cramér–Rao bound of every trial, from the truth.

The covariance of an unbiased estimator of a star's position is at least the inverse of its Fisher matrix, and that of
the attitude follows from these positions. Both are computed from the true star image, its electrons, and the noise of
each pixel around it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from simulator.detector.excess_noise import excess_noise_factor, signal_gain
from simulator.detector.fixed_pattern import FixedPattern, dark_current_factor
from simulator.detector.parameters import DetectorParameters
from simulator.detector.readout import detector_reset_noise_e, gain_e_per_dn
from simulator.frame import FrameTruth
from simulator.optics.error_function import shares_of_pixels
from simulator.optics.psf import Psf
from simulator.optics.smear import star_paths
from simulator.optics.splat import add_each_star
from simulator.renderer import Renderer
from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera
from startracker.geometry.image_map import pixel_slopes as slopes_of_pixels

SAME_STAR_PX = 3.0
"""A matched centroid is attributed to the brightest true star within this distance."""

_STEP_PX = 0.02
_HALF_WIDTHS, _LEAST_HALF, _MOST_HALF = 4.0, 4, 16


class Wells(NamedTuple):
    """Charge of the pixels: dark current, (H, W) or (1, 1) if uniform, exposure, electrons per photo-electron of the
    photocathode, and full well."""

    dark_e_s: FloatArray | NDArray[np.float32]
    exposure_s: float
    gain: float
    full_well_e: float


def attitude_bound_deg(renderer: Renderer, truth: FrameTruth, stars: IntArray) -> FloatArray:
    """Cramér–Rao bound of the attitude of one frame: minimum standard deviation about x, y, z of the camera, degrees.

    P = [Σ Jᵢᵀ Fᵢ Jᵢ]⁻¹ with the Fisher matrix Fᵢ (2, 2) of each star's position (`star_information`) and
    Jᵢ = ∂(x, y)/∂θ (2, 3), the derivatives of its pixel position with respect to the camera's rotation vector. For
    equal errors σᵢ on both axes of a star and pixels of equal angular size it is P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ (Shuster &
    Oh 1981, J. Guidance & Control 4, 70); it is also valid off axis, where a pixel of a pinhole subtends a smaller
    angle.

    Parameters
    ----------
    renderer : Renderer
        Renderer of the scenario.
    truth : FrameTruth
        With `mean_electrons`.
    stars : (N,) int array
        Rows of the true sources to use: those matched by the tracker (`matched_sources`).

    Returns
    -------
    (3,) array
        NaN if the stars do not determine an attitude, or if the scenario has no noise and therefore no bound.
    """
    if len(stars) < 2:
        return np.full(3, np.nan)
    directions = truth.attitude.apply(truth.sources.direction[stars])
    information = _information(renderer, truth, stars, directions)
    return np.asarray(_deviations_deg(information, pixel_slopes(renderer.focal_plane.true_camera, directions)))


def _deviations_deg(information: FloatArray, slopes: FloatArray) -> FloatArray:
    """Square roots of the diagonal of [Σ Jᵀ F J]⁻¹ in degrees (3,); NaN if singular."""
    rows = slopes.reshape(-1, 3)
    total = rows.T @ (information @ slopes).reshape(-1, 3)
    if np.isfinite(total).all():
        value, axis = np.linalg.eigh(total)
        if value[0] > 1e-12 * value[2]:
            return np.asarray(np.degrees(np.sqrt((axis**2 / value).sum(axis=1))))
    return np.full(3, np.nan)


def matched_sources(truth: FrameTruth, xy: FloatArray) -> IntArray:
    """Rows of the true stars of matched centroids (N, 2), without duplicates and without unmatched ones."""
    sources = truth.sources
    if not len(sources):
        return np.empty(0, np.int64)
    dx, dy = (sources.image_xy[:, axis] - xy[:, axis, None] for axis in (0, 1))
    near = sources.is_star & (dx * dx + dy * dy <= SAME_STAR_PX**2)
    light = np.where(near, sources.electrons, 0.0)
    brightest = light.argmax(axis=1)[light.max(axis=1) > 0.0]
    return np.array(sorted(set(brightest.tolist())), np.int64)


def star_information(renderer: Renderer, truth: FrameTruth, stars: IntArray) -> FloatArray:
    """Fisher matrices (N, 2, 2), px⁻², of the positions of stars at mid-exposure, with unknown flux.

    With the mean μ = F p(x, y) of the pixels about a star, F_ab = Σ ∂_a μ ∂_b μ / v over x, y and F, with F eliminated
    by the Schur complement (Winick 1986, J. Opt. Soc. Am. A 3, 1809; King 1983, PASP 95, 163). p is the scenario's own
    PSF, pixel-integrated and smeared along the star's path over the exposure; derivatives are central differences of
    0.02 px. The background is assumed known, as the tracker estimates it from thousands of pixels. v is the variance of
    a pixel (`pixel_variance_e2`), including the shot noise of neighbours. Jitter, which adds blur, is neglected: the
    bound is then lower, but still valid. Saturated pixels contain no information.

    Parameters
    ----------
    renderer, truth, stars
        As for `attitude_bound_deg`.
    """
    if not len(stars):
        return np.zeros((0, 2, 2))
    return _information(renderer, truth, stars, truth.attitude.apply(truth.sources.direction[stars]))


def _information(renderer: Renderer, truth: FrameTruth, stars: IntArray, directions: FloatArray) -> FloatArray:
    """`star_information` of stars in the directions (N, 3), camera axes."""
    plane, sources, detector = renderer.focal_plane, truth.sources, renderer.detector.parameters
    information = np.empty((len(stars), 2, 2))
    assert truth.mean_electrons is not None
    wells = _wells(renderer.detector.pattern, detector, renderer.exposure_s)
    noise = _noise(detector, renderer.exposure_s)
    paths, weights = star_paths(
        plane.true_camera, directions, truth.rate_camera_rad_s, renderer.exposure_s, plane.psfs.feature_px
    )
    if not plane.displacement.is_off:  # the same displacement at every moment
        paths = paths + (sources.xy[stars] - plane.true_camera.project(directions))[:, None, :]
    streak_px = _widest(paths)
    for members, psf in plane.psfs.groups(sources.b_v[stars], sources.xy[stars]):
        wide = math.ceil(_HALF_WIDTHS * max(psf.sigma_px, psf.sigma_y_px) + 0.5 * streak_px)
        half = min(max(_LEAST_HALF, psf.core_half_px, wide), max(_MOST_HALF, math.ceil(0.5 * streak_px) + _LEAST_HALF))
        chosen = stars[members]
        centres = np.rint(sources.xy[chosen])
        images, flux = image_slopes(psf, paths[members] - centres[:, None, :], weights, half), sources.electrons[chosen]
        variance = images[0] * flux[:, None, None]
        _variances_about(variance, truth.mean_electrons, wells, centres, noise)
        information[members] = fisher_of_position(*images, flux, variance)
    return information


def fisher_of_position(
    share: FloatArray, slope_x: FloatArray, slope_y: FloatArray, flux: FloatArray, variance: FloatArray
) -> FloatArray:
    """Fisher matrices (N, 2, 2) of positions from images of unit flux, their derivatives, and variances (N, M, M);
    pixels with infinite variance are ignored."""
    out = np.empty((len(flux), 2, 2))
    fill_fisher(out, share, slope_x, slope_y, np.asarray(flux, dtype=float), variance)
    return out


@kernel
def fill_fisher(
    out: FloatArray, share: FloatArray, slope_x: FloatArray, slope_y: FloatArray, flux: FloatArray, variance: FloatArray
) -> None:
    """Kernel of `fisher_of_position`."""
    for n in range(len(flux)):
        xx = xy = yy = xf = yf = ff = 0.0
        for j in range(share.shape[1]):
            for i in range(share.shape[2]):
                x, y, f = flux[n] * slope_x[n, j, i], flux[n] * slope_y[n, j, i], share[n, j, i]
                if f == 0.0 and x == 0.0 and y == 0.0:  # a constant pixel contains no information
                    continue
                weight = 1.0 / variance[n, j, i] if variance[n, j, i] > 0.0 else np.inf
                xx += x * weight * x
                xy += x * weight * y
                yy += y * weight * y
                xf += x * weight * f
                yf += y * weight * f
                ff += f * weight * f
        of_flux = ff if ff > 0.0 else 1.0
        out[n, 0, 0], out[n, 1, 1] = xx - xf * xf / of_flux, yy - yf * yf / of_flux
        out[n, 0, 1] = out[n, 1, 0] = xy - xf * yf / of_flux


def image_slopes(
    psf: Psf, paths: FloatArray, weights: FloatArray, half: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fraction of a star's light in the surrounding pixels, and its derivatives in x and y, px⁻¹: three (N, M, M)
    arrays, M = 2 `half` + 1, of stars with paths (N, K, 2) relative to the central pixel."""
    side = 2 * half + 1
    if psf.core is None:
        images = np.zeros((3, len(paths), side, side))
        radius = float(psf.radius_px(1.0))
        _gaussian_slopes(images, paths + half, weights, radius, psf.sigma_px, psf.sigma_y_px)
        return images[0], images[1], images[2]
    steps = np.array([[0.0, 0.0], [_STEP_PX, 0.0], [-_STEP_PX, 0.0], [0.0, _STEP_PX], [0.0, -_STEP_PX]])
    moved = np.ascontiguousarray((paths[None] + half + steps[:, None, None, :]).reshape(-1, *paths.shape[1:]))
    images = np.zeros((len(moved), side, side))
    add_each_star(images, moved, weights, np.ones(len(moved)), psf)
    here, right, left, below, above = images.reshape(5, len(paths), side, side)
    return here, (right - left) / (2.0 * _STEP_PX), (below - above) / (2.0 * _STEP_PX)


@kernel
def _gaussian_slopes(
    images: FloatArray, paths: FloatArray, weights: FloatArray, radius: float, sigma_x: float, sigma_y: float
) -> None:
    """Kernel: pixel-integrated Gaussians of one electron as in `simulator.optics.splat.add_gaussians`, each in a
    separate image, and their derivatives: `images` (3, N, M, M), initially zero."""
    side = images.shape[2]
    scale = 1.0 / (math.sqrt(2.0) * sigma_x), 1.0 / (math.sqrt(2.0) * sigma_y)
    reach = radius + 0.5, radius * sigma_y / sigma_x + 0.5
    lines = np.empty((2, 3, side))
    column, row = lines[0], lines[1]
    for n in range(paths.shape[0]):
        for k in range(paths.shape[1]):
            if not (math.isfinite(paths[n, k, 0]) and math.isfinite(paths[n, k, 1])):
                continue
            for axis in range(2):
                for s in range(3):
                    centre = paths[n, k, axis] + (0.0, _STEP_PX, -_STEP_PX)[s]
                    _shares(lines[axis, s], centre, reach[axis], scale[axis])
            for j in range(side):
                here = weights[k] * row[0, j]
                down = weights[k] * (row[1, j] - row[2, j]) / (2.0 * _STEP_PX)
                for i in range(side):
                    images[0, n, j, i] += here * column[0, i]
                    images[1, n, j, i] += here * (column[1, i] - column[2, i]) / (2.0 * _STEP_PX)
                    images[2, n, j, i] += down * column[0, i]


@kernel_part
def _shares(out: FloatArray, centre: float, radius: float, scale: float) -> None:
    """Fraction of a Gaussian in each pixel of a line, out to `radius`."""
    out[:] = 0.0
    first, last = max(math.ceil(centre - radius), 0), min(math.floor(centre + radius), len(out) - 1)
    shares_of_pixels(out[first:], first, last, centre, scale)


def _widest(paths: FloatArray) -> float:
    """The longest side of the boxes around paths (N, K, 2), without those with a NaN."""
    sides = (paths.max(axis=1) - paths.min(axis=1)).max(axis=1)
    return float(np.fmax.reduce(sides, initial=0.0))


def pixel_variance_e2(
    mean_e: FloatArray, dark_e: FloatArray | float, star_e: FloatArray, detector: DetectorParameters, exposure_s: float
) -> FloatArray:
    """Variance of pixels, photo-electrons²: shot noise of light and dark current, reset and read noise, the converter's
    rounding (g²/12), and the fixed pattern, which the tracker does not know: PRNU times the star's light in a pixel,
    and DSNU times the mean dark current. With an intensifier shot noise is multiplied by the excess noise factor and
    other noise divided by the gain; the blur of its phosphor is neglected, and the bound remains valid.

    Parameters
    ----------
    mean_e : array
        Mean photo-electrons, all sources and the background.
    dark_e : array or float
        Mean dark electrons, of each pixel if not uniform.
    star_e : array
        The part of `mean_e` from the star itself.
    detector, exposure_s : DetectorParameters, float
        The detector and its exposure time.
    """
    return np.asarray(_variance(mean_e, dark_e, star_e, *_noise(detector, exposure_s)))


@register_jitable
def _variance(
    mean_e: Any, dark_e: Any, star_e: Any, of_light: float, of_dark: float, electronics: float, prnu: float
) -> Any:
    return of_light * mean_e + of_dark * dark_e + electronics + (prnu * star_e) ** 2


def _noise(detector: DetectorParameters, exposure_s: float) -> tuple[float, float, float, float]:
    """Variance per electron of light and of dark current, the uniform variance, and the PRNU."""
    gain, dn_e = signal_gain(detector), gain_e_per_dn(detector)
    of_light = excess_noise_factor(detector) if detector.shot_noise else 0.0
    of_dark = 1.0 / gain**2 if detector.shot_noise else 0.0
    cathode_e = detector.intensifier.dark_e_s * exposure_s if detector.intensifier.gain else 0.0
    rounding = 0.0 if detector.adc_bits is None else dn_e**2 / 12.0
    video = (detector.video.noise_dn * dn_e) ** 2
    electronics = (detector.read_noise_e**2 + detector_reset_noise_e(detector) ** 2 + video + rounding) / gain**2
    uneven = (detector.dsnu * mean_dark_e(detector, exposure_s) / gain) ** 2
    return of_light, of_dark, of_light * cathode_e + electronics + uneven, detector.prnu


def mean_dark_e(detector: DetectorParameters, exposure_s: float) -> float:
    """Mean dark electrons of a normal pixel over the exposure."""
    factor = dark_current_factor(detector.temperature_c, detector.dark_reference_c, detector.dark_doubling_c)
    return detector.dark_current_e_s * exposure_s * factor


def mean_displacement_e(detector: DetectorParameters, exposure_s: float) -> float:
    """Mean electrons of displacement damage in a pixel over the exposure."""
    factor = dark_current_factor(detector.temperature_c, detector.dark_reference_c, detector.dark_doubling_c)
    return detector.displacement.mean_e_s * exposure_s * factor


def _wells(pattern: FixedPattern, detector: DetectorParameters, exposure_s: float) -> Wells:
    """`Wells` of a device."""
    dark_e_s = pattern.dark_e_s
    if not isinstance(dark_e_s, np.ndarray):
        dark_e_s = np.full((1, 1), dark_e_s, np.float32)
    return Wells(dark_e_s, exposure_s, signal_gain(detector), detector.full_well_e)


@kernel
def _variances_about(
    stars_e: FloatArray,
    mean_e: FloatArray,
    wells: Wells,
    centres: FloatArray,
    noise: tuple[float, float, float, float],
) -> None:
    """Kernel: variances (N, M, M) of the pixels around stars; infinite outside the image and above the full well. A
    single dark pixel represents all."""
    height, width = mean_e.shape
    uneven = wells.dark_e_s.size > 1
    half = stars_e.shape[1] // 2
    for n in range(len(centres)):
        top, left = int(centres[n, 1]) - half, int(centres[n, 0]) - half
        for j in range(stars_e.shape[1]):
            for i in range(stars_e.shape[2]):
                row, column, star_e = top + j, left + i, stars_e[n, j, i]
                stars_e[n, j, i] = np.inf
                if 0 <= row < height and 0 <= column < width:
                    dark = wells.exposure_s * (wells.dark_e_s[row, column] if uneven else wells.dark_e_s[0, 0])
                    if wells.gain * mean_e[row, column] + dark < wells.full_well_e:
                        stars_e[n, j, i] = _variance(mean_e[row, column], dark, star_e, *noise)


def pixel_slopes(camera: Camera, vectors: FloatArray) -> FloatArray:
    """∂(x, y)/∂θ (N, 2, 3), pixels per radian: motion of the images of stars in the directions (N, 3), camera axes, for
    small rotation vectors θ of the camera, v → v − θ × v; central differences including lens and distortion.
    """
    return np.asarray(slopes_of_pixels(vectors, camera.image_map))
