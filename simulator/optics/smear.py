"""Smear: where each star stands over the exposure while the camera turns."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.camera import Camera

FloatArray = NDArray[np.float64]

DEFAULT_FEATURE_PX = 0.5
"""Width of the image of a star (σ of a Gaussian) that paths are sampled for unless the PSF says otherwise."""

DEFAULT_MARGIN_PX = 64.0
"""Paths are followed this far outside the image: wings reach in."""

_MAX_PANEL = 128


def exposure_nodes(streak_px: float, feature_px: float = DEFAULT_FEATURE_PX) -> tuple[FloatArray, FloatArray]:
    """Moments of an exposure and their weights, for the mean image of a star that moves.

    Gauss–Legendre nodes: 1.03 L/σ + 1.6 of them for a streak of L pixels and a Gaussian of σ = `feature_px` keep the
    smeared image within 1e-4 of its peak; one where the streak is shorter than σ/25. Very long streaks are cut into
    equal panels of 128 nodes at most.

    Parameters
    ----------
    streak_px : float
        Length of the path, pixels.
    feature_px : float
        Finest structure of the PSF (`simulator.optics.psf.Psf.feature_px`).

    Returns
    -------
    nodes : (K,) array
        Moments, −1 (start) to +1 (end of the exposure), rising.
    weights : (K,) array
        Share of the exposure; their sum is 1.
    """
    ratio = streak_px / feature_px
    count = 1 if ratio <= 0.04 else math.ceil(1.03 * ratio + 1.6)
    panels = math.ceil(count / _MAX_PANEL)
    nodes, weights = _legendre(math.ceil(count / panels))
    middles = (2.0 * np.arange(panels) + 1.0) / panels - 1.0
    return (middles[:, None] + nodes / panels).ravel(), np.tile(weights / (2.0 * panels), panels)


def star_paths(
    camera: Camera,
    directions: FloatArray,
    rate_rad_s: ArrayLike,
    exposure_s: float,
    feature_px: float = DEFAULT_FEATURE_PX,
    margin_px: float = DEFAULT_MARGIN_PX,
) -> tuple[FloatArray, FloatArray]:
    """Pixel positions of stars over an exposure under a constant body rate.

    In camera axes a star's direction turns by −ω t about the rate's axis (Rodrigues' formula, exact), so that a roll
    about the boresight draws arcs; each moment goes through the projection with its distortion.

    Parameters
    ----------
    camera : Camera
        Projection.
    directions : (N, 3) array
        Unit vectors in camera axes at the middle of the exposure.
    rate_rad_s : (3,) array
        Inertial angular velocity of the camera, in camera axes, rad/s.
    exposure_s : float
        Exposure time.
    feature_px : float
        Finest structure of the PSF, pixels; sets how many moments there are.
    margin_px : float
        How far outside the image paths are followed: at least the radius of the widest disk that may reach in.

    Returns
    -------
    xy : (N, K, 2) array
        Positions; NaN while a star is further from the boresight than the corners of the image by more than
        the margin: the projection may fold back there.
    weights : (K,) array
        Share of the exposure of each moment; their sum is 1.
    """
    directions = np.atleast_2d(np.asarray(directions, dtype=float))
    turn = -np.asarray(rate_rad_s, dtype=float) * exposure_s
    limit_rad = min(camera.half_diagonal_rad + margin_px * camera.pixel_rad, math.radians(89.9))
    nodes, weights = exposure_nodes(_longest_path_px(camera, directions, turn, limit_rad), feature_px)
    return _positions(camera, directions, turn, nodes / 2.0, limit_rad), weights


def _longest_path_px(camera: Camera, directions: FloatArray, turn: FloatArray, limit_rad: float) -> float:
    """Length of the longest path on the image, by chords."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0 or len(directions) == 0:
        return 0.0
    chords = 8 + math.ceil(angle / math.radians(5.0))
    xy = _positions(camera, directions, turn, np.linspace(-0.5, 0.5, chords + 1), limit_rad)
    return float(np.nansum(np.linalg.norm(np.diff(xy, axis=1), axis=2), axis=1).max())


def _positions(
    camera: Camera, directions: FloatArray, turn: FloatArray, moments: FloatArray, limit_rad: float
) -> FloatArray:
    """(N, K, 2) pixels at the given shares of the whole turn."""
    vectors = np.einsum("kij,nj->nki", _rotations(turn, moments), directions).reshape(-1, 3)
    xy = camera.project(vectors)
    xy[vectors[:, 2] < math.cos(limit_rad)] = np.nan
    return np.asarray(xy.reshape(len(directions), len(moments), 2))


def _rotations(turn: FloatArray, moments: FloatArray) -> FloatArray:
    """Rodrigues' matrices (K, 3, 3) of the rotation vectors `moments` × `turn`."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return np.tile(np.eye(3), (len(moments), 1, 1))
    x, y, z = turn / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = np.sin(angle * moments), 2.0 * np.sin(0.5 * angle * moments) ** 2
    return np.asarray(np.eye(3) + sine[:, None, None] * cross + versine[:, None, None] * (cross @ cross))


@functools.lru_cache(maxsize=256)
def _legendre(count: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights
