"""Sources that move relative to the stars during the exposure, such as satellites."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics.jitter_series import JitterMotion
from simulator.optics.smear import (
    DEFAULT_FEATURE_PX,
    DEFAULT_MARGIN_PX,
    exposure_nodes,
    path_limit_rad,
    rotation_matrices,
    wander_length_px,
)
from startracker.core import FloatArray
from startracker.geometry.camera import Camera

_CHORDS = 32
"""Chords by which the length of a path is estimated."""


class Drift(NamedTuple):
    """Directions of N sources over time, in the axes of the camera at mid-exposure."""

    coefficients: FloatArray
    """(N, D, 3): Polynomial of the seconds from mid-exposure, lowest power first, of a vector along the direction."""

    def at(self, t_s: FloatArray) -> FloatArray:
        """Unit vectors (N, K, 3) at moments (N, K)."""
        vectors = np.zeros((*t_s.shape, 3))
        # Horner's scheme, from the highest power.
        for power in range(self.coefficients.shape[1] - 1, -1, -1):
            vectors = vectors * t_s[..., None] + self.coefficients[:, None, power]
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def drifting_paths(
    camera: Camera,
    drift: Drift,
    rate_rad_s: ArrayLike,
    exposure_s: float,
    feature_px: float = DEFAULT_FEATURE_PX,
    margin_px: float = DEFAULT_MARGIN_PX,
    jitter: JitterMotion | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Pixel positions of moving sources during an exposure with a constant body rate and jitter.

    Parameters
    ----------
    camera, rate_rad_s, exposure_s, feature_px, margin_px, jitter
        As in `simulator.optics.smear.star_paths`.
    drift : Drift
        Directions of the sources.

    Returns
    -------
    xy, weights
        As returned by `star_paths`.
    """
    rate = np.asarray(rate_rad_s, dtype=float)
    limit_rad = path_limit_rad(camera, margin_px)
    length_px, cycles = longest_drift_px(camera, drift, rate, exposure_s, limit_rad), 0.0
    if jitter is not None:
        length_px += wander_length_px(camera, jitter, exposure_s, limit_rad)
        cycles = jitter.max_hz * exposure_s
    nodes, weights = exposure_nodes(length_px, feature_px, cycles)
    return _positions(camera, drift, rate, nodes * exposure_s / 2.0, limit_rad, jitter), weights


def longest_drift_px(
    camera: Camera, drift: Drift, rate_rad_s: FloatArray, exposure_s: float, limit_rad: float
) -> float:
    """Length of the longest path on the image, pixels: the sum of its chords."""
    t_s = np.linspace(-0.5, 0.5, _CHORDS + 1) * exposure_s
    chords = np.linalg.norm(np.diff(_positions(camera, drift, rate_rad_s, t_s, limit_rad, None), axis=1), axis=-1)
    return float(np.nansum(chords, axis=1).max(initial=0.0))


def _positions(
    camera: Camera,
    drift: Drift,
    rate_rad_s: FloatArray,
    t_s: FloatArray,
    limit_rad: float,
    jitter: JitterMotion | None,
) -> FloatArray:
    """Pixels (N, K, 2) at moments (K,); NaN beyond an angle from the boresight."""
    # The camera rotates by +ω t, so directions rotate by −ω t in its axes.
    turning = rotation_matrices(-rate_rad_s * t_s[:, None])
    if jitter is not None:
        turning = rotation_matrices(-jitter.at(t_s)) @ turning
    moments = np.broadcast_to(t_s, (len(drift.coefficients), len(t_s)))
    vectors = np.einsum("kij,nkj->nki", turning, drift.at(moments))
    vectors[vectors[..., 2] < math.cos(limit_rad)] = np.nan
    return camera.project(vectors.reshape(-1, 3)).reshape(*moments.shape, 2)
