"""How the camera turned while a frame's stars trailed, and where these stood in the middle of the exposure.

The image of a steady turn neither runs evenly nor straight, so that the middle of a trail lies some hundredths of a
pixel from where its star stood at mid-exposure. Along the trail the middle is that of its ends; across it is the mean
of an arc, which lies at two thirds of its height. An error of the turn about the line of sight, which directions and
lengths of the trails show, moves all stars alike: it is the covariance that all positions share.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.camera import Camera
from startracker.trails.find import Trails

__all__ = ["fit_turn", "mid_exposure"]

FloatArray = NDArray[np.float64]

_MOTION_ERROR_PX, _MOTION_ERROR_SHARE = 0.3, 0.02
"""Of the motion that the search found: in pixels, and of its length, as it knows no projection."""
_ENDS, _TILT = 4.0, 12.0
"""Variance of a trail's length, and of what its direction moves its ends by, over that of its middle."""
_CAUCHY = 2.4
_STEPS = 6
_STEP_RAD = 1e-6


def mid_exposure(trails: Trails, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Where the stars stood at mid-exposure (N, 2), px, and the covariance (2, 2) of the error that they share, px²."""
    xy = trails.centroids.xy
    half, covariance = fit_turn(trails, camera)
    here, moved = camera.unproject(xy), np.empty((3, 2))
    bow = _bow(xy, here, half, camera)
    for k in range(3):
        step = math.sqrt(covariance[k, k]) * np.eye(3)[k]
        difference = _bow(xy, here, half + step, camera) - _bow(xy, here, half - step, camera)
        moved[k] = 0.5 * np.mean(difference, axis=0) / step[k]
    return xy - bow, moved.T @ covariance @ moved


def fit_turn(trails: Trails, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Half the rotation vector of the exposure (3,), camera axes, rad, and its covariance, from the directions and
    lengths of trails that were fitted each for itself."""
    a, b, c = trails.motion
    half = 0.5 * np.array([-b / camera.fy, a / camera.fx, c])
    error = _MOTION_ERROR_PX + _MOTION_ERROR_SHARE * math.hypot(a, b)
    prior = np.full(3, 2.0 * camera.fx / error)
    prior[2] = camera.width / error
    own = np.flatnonzero(trails.fitted_alone)
    here, start = camera.unproject(trails.centroids.xy[own]), half
    for _ in range(_STEPS):
        lengths = _span(here, half, camera)
        sign = np.where((lengths * trails.lengths[own]).sum(axis=1) < 0.0, -1.0, 1.0)
        slopes = np.stack([_span(here, half + step, camera) - lengths for step in _STEP_RAD * np.eye(3)], axis=2)
        axes = _axes(lengths)
        within = np.einsum("nij,njk,nik->ni", axes, trails.centroids.covariance[own], axes)
        scale = 1.0 / np.sqrt(within * (_ENDS, _TILT))
        design = scale[:, :, None] * (axes @ slopes) / _STEP_RAD
        off = scale * np.einsum("nij,nj->ni", axes, sign[:, None] * trails.lengths[own] - lengths)
        weight = 1.0 / (1.0 + (off / _CAUCHY) ** 2)
        normal = np.einsum("nik,ni,nij->kj", design, weight, design) + np.diag(prior**2)
        right = np.einsum("nik,ni,ni->k", design, weight, off) - prior**2 * (half - start)
        half = half + np.linalg.solve(normal, right)
    return half, np.linalg.inv(normal)


def _axes(lengths: FloatArray) -> FloatArray:
    """Unit vectors along and across trails (N, 2, 2)."""
    along = lengths / np.maximum(np.hypot(*lengths.T), 1e-12)[:, None]
    return np.stack([along, np.column_stack([-along[:, 1], along[:, 0]])], axis=1)


def _turned(here: FloatArray, half: FloatArray, camera: Camera) -> FloatArray:
    """Pixels (N, 2) of directions turned by a rotation vector (3,)."""
    angle = float(np.linalg.norm(half))
    axis = half / max(angle, 1e-15)
    along = (here @ axis)[:, None] * axis
    return camera.project((here - along) * math.cos(angle) + np.cross(axis, here) * math.sin(angle) + along)


def _span(here: FloatArray, half: FloatArray, camera: Camera) -> FloatArray:
    """From the beginning to the end of trails (N, 2), px."""
    return _turned(here, half, camera) - _turned(here, -half, camera)


def _bow(xy: FloatArray, here: FloatArray, half: FloatArray, camera: Camera) -> FloatArray:
    """How far the middle of a trail lies from where its star stood at mid-exposure (N, 2), px."""
    begin, end = _turned(here, -half, camera), _turned(here, half, camera)
    off, axes = 0.5 * (begin + end) - xy, _axes(end - begin)
    along = (off * axes[:, 0]).sum(axis=1)[:, None] * axes[:, 0]
    bow = along + (off - along) / 3.0
    return np.where(np.isfinite(bow), bow, 0.0)
