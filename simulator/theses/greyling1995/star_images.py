"""Star images in a 5 × 5 window and the errors of their first moments (Greyling 1995, section 4.3).

Computed in two ways: sampled at pixel centres, as in the thesis, and integrated over pixels, as by a detector.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics.psf import Psf
from simulator.optics.smear import exposure_nodes
from simulator.optics.splat import render_stars
from simulator.randomness import stream
from simulator.theses.greyling1995.blur import OFFSETS, THESIS_SIGMA
from startracker.centroid import METHODS
from startracker.centroid.bias import moment_bias
from startracker.centroid.window import Pixels, read_window
from startracker.core import FloatArray
from startracker.detection import find_components
from startracker.detection.tiles import as_plane
from startracker.front_end import Clock, find_stars
from startracker.inputs import GivenImage
from startracker.settings import CentroidSettings, DetectionSettings

_HALF = 2
_ELECTRONS = 1e6
_LATTICE, _PITCH_PX = 9, 32

Path = tuple[FloatArray, FloatArray]
"""Path (K, 2) of a star over the exposure, pixels, and fraction (K,) of the exposure at each position."""

_STILL: Path = (np.zeros((1, 2)), np.ones(1))


def star_stamps(
    offset_px: ArrayLike = OFFSETS,
    sigma_px: float = THESIS_SIGMA,
    sigma_y_px: float | None = None,
    path: Path = _STILL,
    *,
    integrated: bool = False,
) -> FloatArray:
    """Images (N, 5, 5) of stars `offset_px` to the right of the centre, relative to the peak of a star at rest.

    Gaussian, optionally with a different width along y; integrated over the pixels (`simulator.optics.splat`) or
    sampled at their centres.
    """
    offsets = np.atleast_1d(np.asarray(offset_px, dtype=float))
    sigma_y = sigma_px if sigma_y_px is None else sigma_y_px
    way, weights = path
    x = offsets[:, None] + way[:, 0]
    y = np.broadcast_to(way[:, 1], x.shape)
    if not integrated:
        pixels = np.arange(-_HALF, _HALF + 1.0)
        along_x = np.exp(-0.5 * ((pixels - x[..., None]) / sigma_px) ** 2)
        along_y = np.exp(-0.5 * ((pixels - y[..., None]) / sigma_y) ** 2)
        return np.asarray(np.einsum("k,nkj,nki->nji", weights, along_y, along_x))
    psf = Psf("gaussian", sigma_px, sigma_y, min(sigma_px, sigma_y))
    side = 2 * _HALF + 1
    positions = np.stack([x, y], axis=-1) + _HALF
    images = [render_stars((side, side), position[None], weights, [_ELECTRONS], psf) for position in positions]
    return np.array(images) / (_ELECTRONS * psf.peak)


def moments(stamps: FloatArray) -> FloatArray:
    """First moments (N,) along x, pixels from the central pixel (eq. 4.6), by the tracker's kernel."""
    side = 2 * _HALF + 1
    level, noise = as_plane(np.zeros((side, side), np.float32)), as_plane(np.ones((side, side), np.float32))
    frames = (Pixels(stamp.astype(np.float32), level, noise, 0.0, 0.0) for stamp in stamps)
    return np.array([read_window(frame, _HALF, _HALF, _HALF)[1] for frame in frames])


def _errors(stamps: FloatArray, sigma_px: float, *, integrated: bool) -> FloatArray:
    """Errors (11,) after subtraction of the known bias of a star at rest at each offset (Table 4.1)."""
    return OFFSETS - moments(stamps) - moment_bias(OFFSETS, sigma_px, 2 * _HALF + 1, integrated=integrated)


def smear_path(rate_px_s: float, angle_deg: float) -> Path:
    """Path of a star at constant rate over 0.5 s, about its midpoint (eq. 4.11)."""
    length = rate_px_s * 0.5
    nodes, weights = exposure_nodes(length, THESIS_SIGMA)
    angle = np.radians(angle_deg)
    return 0.5 * length * nodes[:, None] * np.array([np.cos(angle), np.sin(angle)]), weights


def smear_errors(rate_px_s: float, angle_deg: float, sigma_px: float = THESIS_SIGMA) -> FloatArray:
    """Errors (11,) along x of stars smeared for 0.5 s, minus the bias of a star at rest."""
    stamps = star_stamps(OFFSETS, sigma_px, path=smear_path(rate_px_s, angle_deg))
    return _errors(stamps, sigma_px, integrated=False)


def distortion_errors(ratio: float, *, integrated: bool = False) -> FloatArray:
    """Errors (11,) along x of stars elongated along x: d_r = σ_y / σ_x (eq. 4.12), σ_y the width of a round star."""
    stamps = star_stamps(OFFSETS, THESIS_SIGMA / ratio, THESIS_SIGMA, integrated=integrated)
    return _errors(stamps, THESIS_SIGMA, integrated=integrated)


def tracker_errors(
    sigma_px: float = THESIS_SIGMA,
    sigma_y_px: float | None = None,
    path: Path = _STILL,
    snr_db: float | None = None,
    *,
    centroider: str = "moment",
) -> FloatArray:
    """Errors (N, 2) in x and y, pixels, of the product's tracker for 81 stars at different sub-pixel phases.

    Found and measured by `startracker.front_end.find_stars` with its default detector and one of its centroiders, which
    estimate widths and bias from the frame; noise uniform between ±10^(−SNR/20) of a star's peak. Stars that are not
    detected are excluded.
    """
    sigma_y = sigma_px if sigma_y_px is None else sigma_y_px
    way, weights = path
    phase = (np.arange(_LATTICE) + 0.5) / _LATTICE - 0.5
    along = _PITCH_PX * (np.arange(_LATTICE) + 1.0) + phase
    truth = np.stack([axis.ravel() for axis in np.meshgrid(along, along)], axis=1)
    side = _PITCH_PX * (_LATTICE + 1)
    psf = Psf("gaussian", sigma_px, sigma_y, min(sigma_px, sigma_y))
    image = render_stars((side, side), truth[:, None, :] + way, weights, np.full(len(truth), _ELECTRONS), psf)
    if snr_db is not None:
        amplitude = _ELECTRONS * psf.peak * 10.0 ** (-snr_db / 20.0)
        image += stream(1, "greyling1995 noisy frame").uniform(-amplitude, amplitude, image.shape)
    settings = DetectionSettings(max_stars=2 * len(truth))
    frame = image.astype(np.float32)
    found = find_stars(GivenImage(frame), find_components, METHODS[centroider], settings, CentroidSettings(), Clock())
    xy = found.stars.xy
    if not len(xy):
        return np.empty((0, 2))
    away = xy[None] - truth[:, None]
    nearest = np.argmin(np.hypot(away[..., 0], away[..., 1]), axis=1)
    errors = away[np.arange(len(truth)), nearest]
    return np.asarray(errors[np.hypot(errors[:, 0], errors[:, 1]) < 3.0])
