"""Smear: the path of each star during the exposure while the camera rotates."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics.jitter_series import JitterMotion
from simulator.optics.pupil import legendre
from startracker._compiled import kernel
from startracker.core import FloatArray
from startracker.geometry.camera import Camera
from startracker.geometry.image_map import ImageMap, to_pixels

DEFAULT_FEATURE_PX = 0.5
"""Default width of a star image (σ of a Gaussian) for the sampling of paths."""

DEFAULT_MARGIN_PX = 64.0
"""Paths are computed this far outside the image because of the wings of the PSF."""

_MAX_PANEL = 128
"""Largest number of nodes of a panel."""
_UNIT = np.eye(3)


def exposure_nodes(
    streak_px: float, feature_px: float = DEFAULT_FEATURE_PX, cycles: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Moments of an exposure and their weights, for the mean image of a moving star.

    For a streak of L pixels and a Gaussian of σ = `feature_px`, 1.03 L/σ + 1.6 Gauss–Legendre nodes give the smeared
    image to 1e-4 of its peak; one node is sufficient if the streak is shorter than σ/25. Very long streaks are divided
    into equal panels of at most 128 nodes. Jitter needs 3.5 more nodes for each cycle of its fastest component: π/2 for
    the cosine, the same for its square, and a margin.

    Parameters
    ----------
    streak_px : float
        Length of the path, pixels.
    feature_px : float
        Finest structure of the PSF (`simulator.optics.psf.Psf.feature_px`).
    cycles : float
        Periods of the fastest jitter within the exposure.

    Returns
    -------
    nodes : (K,) array
        Moments, −1 (start) to +1 (end of the exposure), ascending.
    weights : (K,) array
        Fraction of the exposure; their sum is 1.
    """
    ratio = streak_px / feature_px
    count = 1 if ratio <= (0.04 if cycles == 0.0 else 1e-4) else math.ceil(1.03 * ratio + 1.6 + 3.5 * cycles)
    panels = math.ceil(count / _MAX_PANEL)
    nodes, weights = legendre(math.ceil(count / panels))
    if panels == 1:
        return nodes.copy(), weights / 2.0
    middles = (2.0 * np.arange(panels) + 1.0) / panels - 1.0
    return (middles[:, None] + nodes / panels).ravel(), np.tile(weights / (2.0 * panels), panels)


def star_paths(
    camera: Camera,
    directions: FloatArray,
    rate_rad_s: ArrayLike,
    exposure_s: float,
    feature_px: float = DEFAULT_FEATURE_PX,
    margin_px: float = DEFAULT_MARGIN_PX,
    jitter: JitterMotion | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Pixel positions of stars during an exposure with a constant body rate and jitter.

    In camera axes the direction of a star rotates by −ω t about the axis of the rate (Rodrigues' formula, exact), so
    that roll gives arcs, and by the rotation vector of the jitter, v(t) = R(−φ(t)) R(−ωt) v. Each moment is projected
    with the lens distortion.

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
        Finest structure of the PSF, pixels; determines the number of moments.
    margin_px : float
        Margin around the image in which paths are computed: at least the radius of the largest disk that may overlap.
    jitter : JitterMotion, optional
        Small rotation of the camera during the exposure (`simulator.optics.jitter`).

    Returns
    -------
    xy : (N, K, 2) array
        Positions; NaN while a star is further from the boresight than the image corners plus the margin, where the
        projection may fold back.
    weights : (K,) array
        Fraction of the exposure of each moment; their sum is 1.
    """
    directions = np.atleast_2d(np.asarray(directions, dtype=float))
    # The number of moments follows from the length of the longest path, including that of the jitter.
    turn = -np.asarray(rate_rad_s, dtype=float) * exposure_s
    limit_rad = path_limit_rad(camera, margin_px)
    streak_px = longest_path_px(camera, directions, turn, limit_rad)
    if jitter is None:
        nodes, weights = exposure_nodes(streak_px, feature_px)
        rotations = turning(turn, nodes / 2.0)
    else:
        wander_px = wander_length_px(camera, jitter, exposure_s, limit_rad)
        nodes, weights = exposure_nodes(streak_px + wander_px, feature_px, jitter.max_hz * exposure_s)
        rotations = rotation_matrices(-jitter.at(nodes * exposure_s / 2.0)) @ turning(turn, nodes / 2.0)
    return np.asarray(_positions(directions, rotations, math.cos(limit_rad), camera.image_map)), weights


def path_limit_rad(camera: Camera, margin_px: float) -> float:
    """Angle from the boresight up to which paths are computed: the corners plus a margin, or the camera's limit."""
    return min(camera.half_diagonal_rad + margin_px * camera.pixel_rad, camera.limit_rad)


def wander_length_px(camera: Camera, jitter: JitterMotion, exposure_s: float, limit_rad: float) -> float:
    """Length of the path due to jitter alone at the edge of the field at its maximum speed, pixels.

    The sampling must be sufficient at the maximum speed: twice the rms rate gives the mean image to 1e-4 of its peak
    (compared with 20,000 steps). A pinhole stretches by 1/cos² θ at the edge.
    """
    # Rotation about x and y displaces all stars by the angle, rotation about z in proportion to their radius.
    x, y, z = jitter.rms_rate_rad_s() * exposure_s
    edge = min(limit_rad, math.radians(75.0)) if camera.projection == "pinhole" else limit_rad
    stretch, radius = (1.0 / math.cos(edge) ** 2, math.tan(edge)) if camera.projection == "pinhole" else (1.0, edge)
    return float(2.0 * (math.hypot(x, y) * stretch + z * radius) / camera.pixel_rad)


def longest_path_px(camera: Camera, directions: FloatArray, turn: FloatArray, limit_rad: float) -> float:
    """Length of the longest path on the image, pixels: the sum of its chords."""
    angle = math.hypot(*turn.tolist())
    if angle == 0.0 or len(directions) == 0:
        return 0.0
    # A chord is shorter than its arc by θ²/24 of it for a rotation by θ, so a few are sufficient for most exposures.
    chords = min(math.ceil(angle / math.radians(0.1)), 8) + math.ceil(angle / math.radians(5.0))
    return _longest(_positions(directions, turning(turn, _ends(chords)), math.cos(limit_rad), camera.image_map))


@functools.lru_cache(maxsize=64)
def _ends(chords: int) -> FloatArray:
    """Moments that divide an exposure into this number of chords, −1/2 to 1/2."""
    return np.arange(-chords, chords + 1, 2) / (2.0 * chords)


def _longest(xy: FloatArray) -> float:
    """Length of the longest of paths (N, K, 2), without chords from or to a NaN."""
    steps = xy[:, 1:] - xy[:, :-1]
    # np.fmax ignores NaN, unlike np.maximum.
    chords = np.hypot(steps[..., 0], steps[..., 1])
    return float(np.fmax(chords, 0.0).sum(axis=1).max(initial=0.0))


@kernel
def _positions(directions: FloatArray, rotations: FloatArray, least_z: float, image: ImageMap) -> FloatArray:
    """Kernel: pixels (N, K, 2) of directions (N, 3) rotated by each matrix (K, 3, 3); NaN where z is below
    `least_z`."""
    vectors = np.empty((len(directions) * len(rotations), 3))
    for n in range(len(directions)):
        for k in range(len(rotations)):
            i = n * len(rotations) + k
            for axis in range(3):
                row = rotations[k, axis]
                vectors[i, axis] = row[0] * directions[n, 0] + row[1] * directions[n, 1] + row[2] * directions[n, 2]
            if vectors[i, 2] < least_z:
                vectors[i] = np.nan
    positions: FloatArray = to_pixels(vectors, image).reshape(len(directions), len(rotations), 2)
    return positions


def turning(turn: FloatArray, moments: FloatArray) -> FloatArray:
    """Rodrigues' matrices (K, 3, 3) of the rotation vectors `moments` (K,) × `turn` (3,); cached, so not to be
    modified."""
    return _turning(turn.tobytes(), moments.tobytes())


@functools.lru_cache(maxsize=4)
def _turning(turn: bytes, moments: bytes) -> FloatArray:
    """`turning` of the bytes of its arguments, by which results are cached."""
    x, y, z = np.frombuffer(turn).tolist()
    angle = math.hypot(x, y, z) or 1.0
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / angle
    half = (0.5 * angle * np.frombuffer(moments))[:, None, None]
    return np.asarray(_UNIT + np.sin(2.0 * half) * cross + 2.0 * np.sin(half) ** 2 * (cross @ cross))


def rotation_matrices(vectors: FloatArray) -> FloatArray:
    """Rodrigues' matrices (..., 3, 3) of rotation vectors (..., 3), accurate also for very small ones."""
    # R = 1 + (sin θ/θ) [v×] + ((1 − cos θ)/θ²) [v×]², whose coefficients as sinc functions are finite at θ = 0.
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vectors.shape, 3)
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    sine, versine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))
