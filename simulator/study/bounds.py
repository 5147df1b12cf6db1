"""What limits it: the Cramér–Rao bound of every trial, from the truth.

No unbiased estimator of a star's place does better than the inverse of its Fisher matrix, none of the attitude better
than what these places tell of it. Both follow from what really was: the star's image, its electrons, and the noise of
each pixel about it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.detector.fixed_pattern import FixedPattern, dark_current_factor
from simulator.detector.intensifier import excess_noise_factor, signal_gain
from simulator.detector.readout import gain_e_per_dn, section_reset_noise_e
from simulator.frame import FrameTruth
from simulator.optics.psf import Psf
from simulator.optics.smear import star_paths
from simulator.optics.splat import add_gaussians, add_tabulated
from simulator.renderer import Renderer
from simulator.scenario.schema import DetectorSection
from startracker.camera import Camera

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SAME_STAR_PX = 3.0
"""A matched centroid belongs to the brightest true star this near."""

_STEP_PX = 0.02
_HALF_WIDTHS, _LEAST_HALF, _MOST_HALF = 4.0, 4, 16
_TURN_RAD = 1e-5


def attitude_bound_deg(renderer: Renderer, truth: FrameTruth, stars: IntArray) -> FloatArray:
    """Cramér–Rao bound of the attitude of one frame: least standard deviation about x, y, z of the camera, degrees.

    P = [Σ Jᵢᵀ Fᵢ Jᵢ]⁻¹ with the Fisher matrix Fᵢ (2, 2) of each star's place (`star_information`) and Jᵢ = ∂(x, y)/∂θ
    (2, 3), the slopes of its pixel against the camera's rotation vector. For equal errors σᵢ on both axes of a star and
    pixels of equal size it is P = [Σ σᵢ⁻² (I − bᵢ bᵢᵀ)]⁻¹ (Shuster & Oh 1981, J. Guidance & Control 4, 70); but
    unlike that it holds away from the axis too, where a pixel of a pinhole spans a smaller angle.

    Parameters
    ----------
    renderer : Renderer
        Of the scenario.
    truth : FrameTruth
        With `mean_electrons`.
    stars : (N,) int array
        Rows of the true sources that are used: those that the tracker has matched (`matched_sources`).

    Returns
    -------
    (3,) array
        NaN where the stars do not determine an attitude, or where nothing in the scenario is random, in which case
        there is no bound.
    """
    information = star_information(renderer, truth, stars)
    slopes = pixel_slopes(renderer.focal_plane.true_camera, truth.attitude.apply(truth.sources.direction[stars]))
    total = np.einsum("nia,nij,njb->ab", slopes, information, slopes)
    bound = np.full(3, np.nan)
    if len(stars) >= 2 and np.isfinite(total).all() and np.linalg.cond(total) < 1e12:
        bound = np.degrees(np.sqrt(np.diag(np.linalg.inv(total))))
    return bound


def matched_sources(truth: FrameTruth, xy: FloatArray) -> IntArray:
    """Rows of the true stars that matched centroids (N, 2) belong to, each once; those that belong to none are left
    out."""
    sources = truth.sources
    rows = np.flatnonzero(sources.kind == "star")
    if not len(rows) or not len(xy):
        return np.empty(0, dtype=np.int64)
    distance = np.hypot(*np.moveaxis(sources.xy[rows][None, :, :] - xy[:, None, :], -1, 0))
    light = np.where(distance <= SAME_STAR_PX, sources.electrons[rows], -1.0)
    best = light.argmax(axis=1)
    return np.unique(rows[best[light[np.arange(len(xy)), best] > 0.0]])


def star_information(renderer: Renderer, truth: FrameTruth, stars: IntArray) -> FloatArray:
    """Fisher matrices (N, 2, 2), px⁻², of the places of stars at mid-exposure, their flux unknown too.

    With the mean μ = F p(x, y) of the pixels about a star, F_ab = Σ ∂_a μ ∂_b μ / v over x, y and F, and F eliminated
    (Schur's complement), as its value tells nothing of the place that is not in these sums (Winick 1986, J. Opt. Soc.
    Am. A 3, 1809; King 1983, PASP 95, 163). p is the scenario's own PSF, pixel-integrated and drawn out along the
    star's path over the exposure; slopes are central differences of 0.02 px. The background counts as known: the
    tracker has it from thousands of pixels. v is the variance of a pixel (`pixel_variance_e2`), to which neighbours add
    their shot noise. Jitter is left out, which blurs further: without it the bound is lower, and still a bound.
    Saturated pixels tell nothing.

    Parameters
    ----------
    renderer, truth, stars
        As for `attitude_bound_deg`.
    """
    scenario, plane = renderer.scenario, renderer.focal_plane
    sources, detector = truth.sources, scenario.detector
    information = np.zeros((len(stars), 2, 2))
    if not len(stars):
        return information
    assert truth.mean_electrons is not None
    directions = truth.attitude.apply(sources.direction[stars])
    paths, weights = star_paths(
        plane.true_camera, directions, truth.rate_camera_rad_s, detector.exposure_s, plane.psfs.feature_px
    )
    streak_px = float(np.nanmax(np.ptp(paths, axis=1), initial=0.0))
    for members, psf in plane.psfs.groups(sources.b_v[stars], sources.xy[stars]):
        wide = math.ceil(_HALF_WIDTHS * max(psf.sigma_px, psf.sigma_y_px) + 0.5 * streak_px)
        half = min(max(_LEAST_HALF, psf.core_half_px, wide), max(_MOST_HALF, math.ceil(0.5 * streak_px) + _LEAST_HALF))
        chosen = stars[members]
        centres = np.rint(sources.xy[chosen]).astype(np.int64)
        flux = sources.electrons[chosen]
        share, slope_x, slope_y = image_slopes(psf, paths[members] - centres[:, None, :], weights, half)
        variance = _variances(truth.mean_electrons, renderer.pattern, detector, centres, flux[:, None, None] * share)
        information[members] = fisher_of_place(share, slope_x, slope_y, flux, variance)
    return information


def fisher_of_place(
    share: FloatArray, slope_x: FloatArray, slope_y: FloatArray, flux: FloatArray, variance: FloatArray
) -> FloatArray:
    """Fisher matrices (N, 2, 2) of places from images of unit flux, their slopes, and variances (N, M, M); pixels of
    infinite variance tell nothing."""
    weight = np.divide(1.0, variance, out=np.full_like(variance, np.inf), where=variance > 0.0)
    # a pixel that neither varies nor changes tells nothing
    weight = np.where((share == 0.0) & (slope_x == 0.0) & (slope_y == 0.0), 0.0, weight)
    parts = np.stack([flux[:, None, None] * slope_x, flux[:, None, None] * slope_y, share], axis=1)
    parts = parts.reshape(len(flux), 3, -1)
    with np.errstate(invalid="ignore"):
        full = (parts * weight.reshape(len(flux), 1, -1)) @ parts.transpose(0, 2, 1)
        cross = full[:, :2, 2]
        of_flux = np.where(full[:, 2, 2] > 0.0, full[:, 2, 2], 1.0)
        return np.asarray(full[:, :2, :2] - cross[:, :, None] * cross[:, None, :] / of_flux[:, None, None])


def image_slopes(
    psf: Psf, paths: FloatArray, weights: FloatArray, half: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Share of a star's light in the pixels about it, and its slopes against x and y, px⁻¹: three (N, M, M) arrays,
    M = 2 `half` + 1, of stars with paths (N, K, 2) relative to the middle pixel."""
    steps = np.array([[0.0, 0.0], [_STEP_PX, 0.0], [-_STEP_PX, 0.0], [0.0, _STEP_PX], [0.0, -_STEP_PX]])
    moved = (paths[None] + half + steps[:, None, None, :]).reshape(-1, *paths.shape[1:])
    images = np.zeros((len(moved), 2 * half + 1, 2 * half + 1))
    _draw_each(images, np.ascontiguousarray(moved), np.ascontiguousarray(weights), psf)
    here, right, left, below, above = images.reshape(5, len(paths), *images.shape[1:])
    return here, (right - left) / (2.0 * _STEP_PX), (below - above) / (2.0 * _STEP_PX)


def _draw_each(images: FloatArray, xy: FloatArray, weights: FloatArray, psf: Psf) -> None:
    """Stars of one electron, each on an image of its own, as far as the images reach."""
    one = np.ones(len(images))
    radius = psf.radius_px(one)
    if psf.core is None or psf.wing is None or psf.drawn is None:
        _gaussians(images, xy, weights, one, radius, psf.sigma_px, psf.sigma_y_px)
        return
    drawn = np.interp(radius, np.arange(len(psf.drawn)) * psf.wing_step_px, psf.drawn)
    for k in range(len(images)):
        add_tabulated(
            images[k], xy[k : k + 1], weights, one[k : k + 1], radius[k : k + 1], psf.core, psf.phases,
            drawn[k : k + 1], psf.wing, 1.0 / psf.wing_step_px, 1.0 / psf.aspect,
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _gaussians(
    images: FloatArray,
    xy: FloatArray,
    weights: FloatArray,
    electrons: FloatArray,
    radius: FloatArray,
    sigma_x: float,
    sigma_y: float,
) -> None:
    for k in range(len(images)):
        add_gaussians(images[k], xy[k : k + 1], weights, electrons[k : k + 1], radius[k : k + 1], sigma_x, sigma_y)


def pixel_variance_e2(
    mean_e: FloatArray, dark_e: FloatArray | float, star_e: FloatArray, detector: DetectorSection
) -> FloatArray:
    """Variance of pixels, photo-electrons²: shot noise of light and dark current, reset and read noise, the converter's
    rounding (g²/12), and what is fixed in the device but not told to the tracker: the response of a pixel (PRNU) times
    the star's light in it, and DSNU times the mean dark current. Behind an intensifier shot noise grows by the excess
    noise factor, all else is divided by the gain; what its phosphor blurs is left out: the bound stays one.

    Parameters
    ----------
    mean_e : array
        Mean photo-electrons, all sources and the background.
    dark_e : array or float
        Dark electrons, the mean over exposures: of each pixel, where they are not alike.
    star_e : array
        Of `mean_e`, those of the star itself.
    detector : DetectorSection
        The detector.
    """
    gain, dn_e = signal_gain(detector), gain_e_per_dn(detector)
    cathode_e = detector.intensifier.dark_e_s * detector.exposure_s if detector.intensifier.gain else 0.0
    counted = excess_noise_factor(detector) * (mean_e + cathode_e) + dark_e / gain**2
    shot = counted if detector.shot_noise else np.zeros_like(mean_e)
    rounding = 0.0 if detector.adc_bits is None else dn_e**2 / 12.0
    video = (detector.video.noise_dn * dn_e) ** 2
    electronics = (detector.read_noise_e**2 + section_reset_noise_e(detector) ** 2 + video + rounding) / gain**2
    fixed = (detector.prnu * star_e) ** 2 + (detector.dsnu * mean_dark_e(detector) / gain) ** 2
    return np.asarray(shot + electronics + fixed)


def mean_dark_e(detector: DetectorSection) -> float:
    """Mean dark electrons of an ordinary pixel over the exposure."""
    factor = dark_current_factor(detector.temperature_c, detector.dark_reference_c, detector.dark_doubling_c)
    return detector.dark_current_e_s * detector.exposure_s * factor


def _variances(
    mean_e: FloatArray, pattern: FixedPattern, detector: DetectorSection, centres: IntArray, star_e: FloatArray
) -> FloatArray:
    """Variances (N, M, M) of the pixels about stars; infinite off the image and where charge overflows."""
    height, width = mean_e.shape
    offsets = np.arange(star_e.shape[1]) - star_e.shape[1] // 2
    columns, rows = centres[:, 0, None] + offsets, centres[:, 1, None] + offsets
    inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
    at = (np.clip(rows, 0, height - 1)[:, :, None], np.clip(columns, 0, width - 1)[:, None, :])
    mean = mean_e[at]
    dark = pattern.dark_e[at] if isinstance(pattern.dark_e, np.ndarray) else np.full_like(mean, pattern.dark_e)
    variance = pixel_variance_e2(mean, dark, star_e, detector)
    return np.where(inside & (signal_gain(detector) * mean + dark < detector.full_well_e), variance, np.inf)


def pixel_slopes(camera: Camera, vectors: FloatArray) -> FloatArray:
    """∂(x, y)/∂θ (N, 2, 3), pixels per radian: how stars seen along unit vectors (N, 3) in the camera move on the image
    when it turns by small rotation vectors θ, v → v − θ × v; central differences, which lens and distortion go through.
    """
    slopes = np.empty((len(vectors), 2, 3))
    turns = np.concatenate([np.eye(3), -np.eye(3)]) * _TURN_RAD
    turned = vectors[None] - np.cross(turns[:, None, :], vectors[None])
    xy = camera.project(turned.reshape(-1, 3)).reshape(6, len(vectors), 2)
    slopes[:] = np.moveaxis((xy[:3] - xy[3:]) / (2.0 * _TURN_RAD), 0, -1)
    return slopes
