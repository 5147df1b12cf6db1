"""Predicted sensitivity of a scenario's camera, without rendering: detection limit and centroid error.

The star image (PSF, smear, pixels) and the pixel noise determine the signal-to-noise ratio of the detection and the
Cramér–Rao bound of the centroid. Not included: stray light, ghosts, jitter, cosmic rays, hot pixels, catalogue and
calibration errors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.build import aged_detector, build_focal_plane, build_mounting, build_orbit
from simulator.detector.parameters import DetectorParameters
from simulator.detector.readout import gain_e_per_dn, highest_dn
from simulator.focal_plane import FocalPlane
from simulator.mission.attitude_law import law_rate_rad_s
from simulator.mission.attitudes import build_attitude_law
from simulator.mission.spin import spin_rate_rad_s
from simulator.optics.illumination import star_illumination
from simulator.optics.smear import star_paths
from simulator.scenario import Scenario
from simulator.sky.background import sky_brightness_s10
from simulator.sky.photometry import Photometer
from simulator.study.coverage.boresights import sky_grid
from simulator.study.trials.bounds import (
    fisher_of_position,
    image_slopes,
    mean_dark_e,
    mean_displacement_e,
    pixel_variance_e2,
)
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera

_POSITIONS = 16
"""Number of field positions, with different sub-pixel phases, over which images and bounds are averaged."""

_HALF_WIDTHS, _LEAST_HALF = 4.0, 4
"""Half width of an image beside the star's path, in σ or pixels."""

_ELECTRONS = np.geomspace(10.0, 1e9, 65)
_B_V = 0.6
"""B−V of the star to which magnitude limits refer."""


@dataclass(frozen=True)
class Pixel:
    """A pixel without a star."""

    sky_e: float
    dark_e: float
    """Mean electrons of diffuse sky and dark current."""
    noise_e: float
    """Standard deviation, electrons."""
    top_e: float
    """Saturation level, electrons."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Detection limit and centroid errors of a scenario's camera."""

    camera: Camera
    """The calibrated camera."""
    pixel: Pixel
    """Background and noise of a pixel without a star."""
    photometer: Photometer
    """Electrons per second of stars at the centre of the field."""
    gathered_s: float
    """Exposure time × mean illumination of the field relative to its centre."""
    snr_per_electron: float
    """Signal-to-noise ratio of the detection per electron of a star."""
    least_snr: float
    """Minimum ratio of a detected star."""
    electrons: FloatArray
    sigma_px: FloatArray
    """(K,): Electrons of a star, and the Cramér–Rao bound of its centroid: root mean square of the two axes, pixels."""

    __repr__ = fields_repr

    @property
    def least_electrons(self) -> float:
        """Electrons of the faintest detectable star."""
        return self.least_snr / self.snr_per_electron

    @property
    def magnitude_limit(self) -> float:
        """V of the faintest detectable star (B−V = 0.6), with a detection probability of 50 %."""
        at_zero = float(self.electrons_of(np.zeros(1), np.array([_B_V]))[0])
        return 2.5 * math.log10(at_zero / self.least_electrons)

    def electrons_of(self, v_mag: FloatArray, b_v: FloatArray, giant: FloatArray | None = None) -> FloatArray:
        """Electrons (N,) of stars in an exposure, mean over the field; arguments as for `Photometer`."""
        return self.photometer.electrons_per_s(v_mag, b_v, giant) * self.gathered_s

    def sigma_rad(self, electrons: FloatArray) -> FloatArray:
        """Standard error of the directions of stars on one axis, radians; infinite if saturation leaves no
        information."""
        logarithm = np.interp(np.log(np.maximum(electrons, 1e-300)), np.log(self.electrons), np.log(self.sigma_px))
        return np.asarray(np.exp(logarithm) * self.camera.pixel_rad)


def nominal_rate_rad_s(scenario: Scenario) -> FloatArray:
    """Inertial angular velocity (3,) of the camera in camera axes, without pointing error; of an attitude law that at
    the epoch, or at the nearest end of its span."""
    pointing, orbit = scenario.pointing, build_orbit(scenario)
    rate = np.radians(pointing.rate_deg_s)
    offset = Attitude.from_rotation_vector(np.radians(pointing.offset_deg), "local_level", "body")
    if pointing.spin.rate_deg_s:
        rate = rate + offset.apply(spin_rate_rad_s(pointing.spin, 0.0))
    elif (law := build_attitude_law(pointing, orbit, scenario.base_dir)) is not None:
        first, last = law.span_s
        rate = rate + offset.apply(law_rate_rad_s(law, min(max(0.0, first), last)))
    elif pointing.target is None:
        orbital = 2.0 * math.pi / orbit.period_s
        rate = rate + offset.apply(np.array([0.0, -orbital, 0.0]))
    return np.asarray(build_mounting(scenario).apply(rate))


def build_sensitivity(scenario: Scenario, snr: float | None = None) -> Sensitivity:
    """Sensitivity of a scenario's camera.

    A star is detected if its signal-to-noise ratio is at least `snr`. With the tracker's matched filter it is F √(Σ
    p²)/σ, with p the fractions of the light in the pixels and σ the noise of a pixel; without it F p_k/σ, with p_k the
    fraction in the k-th brightest pixel, k = `min_pixels`.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    snr : float, optional
        Minimum ratio; by default the tracker's ``detection.threshold_sigma``.

    Raises
    ------
    InputError
        For a ratio that is not positive, or invalid names in the scenario.
    """
    detection = scenario.tracker.detection
    least = detection.threshold_sigma if snr is None else snr
    if not (math.isfinite(least) and least > 0):
        raise InputError(f"snr: must be positive, not {least}")
    plane = build_focal_plane(scenario)
    exposure_s, detector = scenario.detector.exposure_s, aged_detector(scenario)
    images = _images(plane, nominal_rate_rad_s(scenario), exposure_s)
    pixel = _pixel(plane, detector, exposure_s)
    if detection.matched_filter:
        share = np.sqrt(np.sum(images[0] ** 2, axis=(1, 2)))
    else:
        falling = -np.sort(-images[0].reshape(len(images[0]), -1), axis=1)
        share = falling[:, min(detection.min_pixels, falling.shape[1]) - 1]
    sigma = [
        math.sqrt(float(np.mean(centroid_bound_px(images, float(e), pixel, detector, exposure_s) ** 2)))
        for e in _ELECTRONS
    ]
    return Sensitivity(
        camera=plane.camera,
        pixel=pixel,
        photometer=plane.photometer,
        gathered_s=exposure_s * _mean_illumination(plane),
        snr_per_electron=float(np.mean(share)) / pixel.noise_e,
        least_snr=least,
        electrons=_ELECTRONS,
        sigma_px=np.array(sigma),
    )


def centroid_bound_px(
    images: tuple[FloatArray, FloatArray, FloatArray],
    electrons: float,
    pixel: Pixel,
    detector: DetectorParameters,
    exposure_s: float,
) -> FloatArray:
    """Cramér–Rao bound (P, 2) of a star's position along columns and rows, pixels: the inverse of
    `simulator.study.trials.bounds.fisher_of_position`, infinite if saturation leaves no information.

    Parameters
    ----------
    images : three (P, M, M) arrays
        Fraction of the light in each pixel for P positions, and its derivatives
        (`simulator.study.trials.bounds.image_slopes`).
    electrons : float
        Electrons of the star.
    pixel : Pixel
        Background and noise.
    detector, exposure_s : DetectorParameters, float
        The detector and its exposure time.
    """
    signal = electrons * images[0]
    light = pixel.sky_e + signal
    variance = pixel_variance_e2(light, pixel.dark_e, signal, detector, exposure_s)
    variance = np.where(light + pixel.dark_e < pixel.top_e, variance, np.inf)
    information = fisher_of_position(*images, np.full(len(signal), electrons), variance)
    xx, yy, xy = information[:, 0, 0], information[:, 1, 1], information[:, 0, 1]
    determinant = xx * yy - xy * xy
    known = determinant > 1e-12 * xx * yy
    inverse = np.stack([yy, xx]) / np.where(known, determinant, 1.0)
    return np.sqrt(np.where(known, inverse, np.inf)).T


def _images(plane: FocalPlane, rate_rad_s: FloatArray, exposure_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smeared images (P, H, W) of a star at positions distributed over the field, and their derivatives along x and
    y."""
    camera = plane.camera
    k = np.arange(_POSITIONS)
    # at the rms distance from the centre, so that a roll rate gives streaks of the rms length
    azimuth = 2.0 * math.pi * k / _POSITIONS
    x = 0.5 * (camera.width - 1) + camera.width / math.sqrt(6.0) * np.cos(azimuth)
    y = 0.5 * (camera.height - 1) + camera.height / math.sqrt(6.0) * np.sin(azimuth)
    positions = np.stack([np.floor(x) + (k + 0.5) / _POSITIONS, np.floor(y) + (k * 0.618034) % 1.0], axis=1)
    psf = plane.psfs.psf(_B_V)
    paths, weights = star_paths(camera, camera.unproject(positions), rate_rad_s, exposure_s, psf.feature_px)
    if not np.isfinite(paths).all():
        raise InputError("the lens model has no direction at the rms distance from the image centre")
    local = paths - np.rint(positions)[:, None, :]
    sigma = max(psf.sigma_px, psf.sigma_y_px)
    half = max(_LEAST_HALF, psf.core_half_px, math.ceil(_HALF_WIDTHS * sigma)) + math.ceil(float(np.abs(local).max()))
    return image_slopes(psf, local, weights, half)


def _pixel(plane: FocalPlane, detector: DetectorParameters, exposure_s: float) -> Pixel:
    directions = sky_grid(200)
    s10 = sky_brightness_s10(directions, -directions[0], plane.sky)
    sky_e = float(np.median(s10)) * plane.s10_e_s_pixel * exposure_s
    dark_e = mean_dark_e(detector, exposure_s) + mean_displacement_e(detector, exposure_s)
    none = np.zeros(1)
    noise_e = math.sqrt(max(float(pixel_variance_e2(none + sky_e, dark_e, none, detector, exposure_s)[0]), 1e-12))
    highest = highest_dn(detector)
    top_e = detector.full_well_e
    if highest is not None:
        top_e = min(top_e, (highest - detector.offset_dn) * gain_e_per_dn(detector))
    return Pixel(sky_e, dark_e, noise_e, top_e)


def _mean_illumination(plane: FocalPlane) -> float:
    """Mean relative illumination of stars over the field (vignetting)."""
    camera = plane.camera
    if plane.vignetting.is_off:
        return 1.0
    x, y = np.meshgrid((np.arange(16) + 0.5) / 16 * camera.width, (np.arange(16) + 0.5) / 16 * camera.height)
    seen = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1) - 0.5)
    return float(np.nanmean(star_illumination(camera, plane.vignetting, seen)))
