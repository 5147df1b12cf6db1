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
_SHORT_PX = 20.0
"""Of shorter trails the motion that the search found says enough: its error moves a star by 0.002 px."""
_CAUCHY = 2.4
_STEPS = 6
_STEP_RAD = 1e-6


def mid_exposure(trails: Trails, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Where the stars stood at mid-exposure (N, 2), px, and the covariance (2, 2) of the error that they share, px²."""
    xy = trails.centroids.xy
    half, covariance = fit_turn(trails, camera)
    steps = np.vstack([np.zeros(3), np.diag(np.sqrt(np.diag(covariance)))])
    bows = _bows(xy, camera, half + steps)
    moved = np.mean(bows[1:] - bows[0], axis=1) / np.diag(steps[1:])[:, None]
    return xy - bows[0], moved.T @ covariance @ moved


def fit_turn(trails: Trails, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Half the rotation vector of the exposure (3,), camera axes, rad, and its covariance, from the directions and
    lengths of trails that were fitted each for itself."""
    a, b, c = trails.motion
    start = 0.5 * np.array([-b / camera.fy, a / camera.fx, c])
    error = _MOTION_ERROR_PX + _MOTION_ERROR_SHARE * math.hypot(a, b)
    information = (np.array([2.0 * camera.fx, 2.0 * camera.fx, camera.width]) / error) ** 2
    own = np.flatnonzero(trails.fitted_alone)
    if math.hypot(a, b) < _SHORT_PX or not len(own):
        return start, np.diag(1.0 / information)
    here, measured = camera.unproject(trails.centroids.xy[own]), trails.lengths[own]
    spans = _spans(here, start + np.vstack([np.zeros(3), _STEP_RAD * np.eye(3)]), camera)
    lengths, slopes = spans[0], np.moveaxis((spans[1:] - spans[0]) / _STEP_RAD, 0, 2)
    sign = np.where((lengths * measured).sum(axis=1) < 0.0, -1.0, 1.0)
    axes = _axes(lengths)
    variance = np.einsum("nij,njk,nik->ni", axes, trails.centroids.covariance[own], axes) * (_ENDS, _TILT)
    design = (axes @ slopes) / np.sqrt(variance)[:, :, None]
    off = np.einsum("nij,nj->ni", axes, sign[:, None] * measured - lengths) / np.sqrt(variance)
    correction = np.zeros(3)
    for _ in range(_STEPS):
        weight = 1.0 / (1.0 + ((off - design @ correction) / _CAUCHY) ** 2)
        normal = np.einsum("nik,ni,nij->kj", design, weight, design) + np.diag(information)
        correction = np.linalg.solve(normal, np.einsum("nik,ni,ni->k", design, weight, off))
    return start + correction, np.linalg.inv(normal)


def _axes(lengths: FloatArray) -> FloatArray:
    """Unit vectors along and across trails (..., 2, 2)."""
    along = lengths / np.maximum(np.linalg.norm(lengths, axis=-1, keepdims=True), 1e-12)
    return np.stack([along, np.stack([-along[..., 1], along[..., 0]], axis=-1)], axis=-2)


def _ends(here: FloatArray, halves: FloatArray, camera: Camera) -> FloatArray:
    """Pixels (2, K, N, 2) of directions (N, 3) turned back and forth by rotation vectors (K, 3)."""
    angle = np.linalg.norm(halves, axis=1)[:, None, None]
    axis = halves[:, None, :] / np.maximum(angle, 1e-15)
    along = (here * axis).sum(axis=2, keepdims=True) * axis
    still, side = (here - along) * np.cos(angle) + along, np.cross(axis, here) * np.sin(angle)
    turned = np.stack([still - side, still + side])
    return camera.project(turned.reshape(-1, 3)).reshape(*turned.shape[:3], 2)


def _spans(here: FloatArray, halves: FloatArray, camera: Camera) -> FloatArray:
    """From the beginning to the end of trails (K, N, 2), px."""
    begin, end = _ends(here, halves, camera)
    return np.asarray(end - begin)


def _bows(xy: FloatArray, camera: Camera, halves: FloatArray) -> FloatArray:
    """How far the middle of a trail lies from where its star stood at mid-exposure (K, N, 2), px."""
    begin, end = _ends(camera.unproject(xy), halves, camera)
    off, unit = 0.5 * (begin + end) - xy, _axes(end - begin)[..., 0, :]
    along = (off * unit).sum(axis=-1, keepdims=True) * unit
    bow = along + (off - along) / 3.0
    return np.where(np.isfinite(bow), bow, 0.0)
