"""How the camera turned while a frame's stars trailed, and where these stood in the middle of the exposure.

The image of a steady turn neither runs evenly nor straight, so that the middle of a trail lies some hundredths of a
pixel from where its star stood at mid-exposure. Along the trail the middle is that of its ends; across it is the mean
of an arc, which lies at two thirds of its height. An error of the turn about the line of sight, which directions and
lengths of the trails show, moves all stars alike: it is the covariance that all positions share.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import FloatArray
from startracker.centroid.psf_fit import MISFIT_SIGMA
from startracker.centroid.result import Centroids
from startracker.geometry.camera import Camera
from startracker.trails.result import Trails

_MOTION_ERROR_PX, _MOTION_ERROR_SHARE = 0.3, 0.02
"""Of the motion that the search found: in pixels, and of its length, as it knows no projection."""
_ENDS, _TILT = 4.0, 12.0
"""Variance of a trail's length, and of what its direction moves its ends by, over that of its middle."""
_FORM_ERROR_PX = 0.1
"""Error of a trail's length and direction besides: its bow, and the distortion that the calibration leaves."""
PROJECTED_PX = 20.0
"""Of shorter trails the motion that the search found says enough: its error moves a star by 0.002 px."""
_CAUCHY = 2.4
_STEPS = 6
_STEP_RAD = 1e-6


class Turn(NamedTuple):
    """Half the rotation vector of the exposure (3,), camera axes, rad, its covariance (3, 3), and the camera."""

    half: FloatArray
    covariance: FloatArray
    camera: Camera

    def lines_at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Line (N, 2), px, from the beginning to the end of a trail about each position, and the variance of its
        length (N,)."""
        lines, slopes = _spans_and_slopes(self.camera.unproject(xy), self.half, self.camera)
        by_turn = np.einsum("ni,nik->nk", _axes(lines)[:, 0], slopes)
        return lines, np.einsum("nk,kj,nj->n", by_turn, self.covariance, by_turn)


def mid_exposure(trails: Trails, camera: Camera) -> Centroids:
    """Positions of the stars at mid-exposure.

    A trail whose own length or direction contradicts the turn by more than 4 standard errors has light of another star
    along it, which moves its middle in proportion: its covariance grows by the square of these standard errors. The
    error that all stars share is that of the turn.
    """
    stars, own = trails.centroids, trails.fitted_alone
    xy, axes = stars.xy, _axes(trails.lengths[own])
    variance = np.einsum("nij,njk,nik->ni", axes, stars.covariance[own], axes) * (_ENDS, _TILT)
    turn = fit_turn(xy[own], trails.lengths[own], variance, trails.motion, camera)
    steps = np.vstack([np.zeros(3), np.diag(np.sqrt(np.diag(turn.covariance)))])
    bows = _bows(xy, camera, turn.half + steps)
    moved = np.mean(bows[1:] - bows[0], axis=1) / np.diag(steps[1:])[:, None]
    covariance = stars.covariance.copy()
    covariance[own] *= _widening(turn, xy[own], trails.lengths[own], variance)[:, None, None]
    common = moved.T @ turn.covariance @ moved
    return replace(stars, xy=xy - bows[0], covariance=covariance, common_px2=common)


def _widening(turn: Turn, xy: FloatArray, measured: FloatArray, variance: FloatArray) -> FloatArray:
    """Factor (N,) of the covariances of trails by how they contradict the turn; parameters as of `fit_turn`."""
    if np.hypot(*turn.half[:2]) * 2.0 * turn.camera.fx < PROJECTED_PX:
        return np.ones(len(xy))
    lines, by_turn = turn.lines_at(xy)
    off = np.einsum("nij,nj->ni", _axes(lines), np.where(_opposite(lines, measured), -1.0, 1.0) * measured - lines)
    error2 = variance + _FORM_ERROR_PX**2 + np.column_stack([by_turn, np.zeros(len(xy))])
    away = (off**2 / error2).max(axis=1, initial=0.0)
    return np.where(away > MISFIT_SIGMA**2, away, 1.0)


def _opposite(lines: FloatArray, measured: FloatArray) -> NDArray[np.bool_]:
    """Which lines (N, 2) run the other way round (N, 1)."""
    return np.asarray((lines * measured).sum(axis=1, keepdims=True) < 0.0)


def fit_turn(xy: FloatArray, measured: FloatArray, variance: FloatArray, motion: FloatArray, camera: Camera) -> Turn:
    """The turn of the camera from trails that were fitted each for itself, outliers held down.

    Parameters
    ----------
    xy, measured : (N, 2)
        Their middles, and their lengths along x and y, px.
    variance : (N, 2)
        Of the length, and of the ends across it, px².
    motion : (3,)
        (a, b, c) of `startracker.detection.motion`.
    camera : Camera
    """
    a, b, c = motion
    start = 0.5 * np.array([-b / camera.fy, a / camera.fx, c])
    error = _MOTION_ERROR_PX + _MOTION_ERROR_SHARE * math.hypot(a, b)
    information = np.diag((np.array([2.0 * camera.fx, 2.0 * camera.fx, camera.width]) / error) ** 2)
    if math.hypot(a, b) < PROJECTED_PX or not len(xy):
        return Turn(start, np.asarray(np.linalg.inv(information)), camera)
    lines, slopes = _spans_and_slopes(camera.unproject(xy), start, camera)
    sign = np.where(_opposite(lines, measured), -1.0, 1.0)
    axes, scale = _axes(lines), 1.0 / np.sqrt(variance)
    design = (axes @ slopes) * scale[:, :, None]
    off = np.einsum("nij,nj->ni", axes, sign * measured - lines) * scale
    correction = np.zeros(3)
    for _ in range(_STEPS):
        weight = 1.0 / (1.0 + ((off - design @ correction) / _CAUCHY) ** 2)
        normal = np.einsum("nik,ni,nij->kj", design, weight, design) + information
        correction = np.linalg.solve(normal, np.einsum("nik,ni,ni->k", design, weight, off))
    return Turn(start + correction, np.asarray(np.linalg.inv(normal)), camera)


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


def _spans_and_slopes(here: FloatArray, half: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """From the beginning to the end of trails (N, 2), px, and the derivatives (N, 2, 3) by half the rotation vector."""
    begin, end = _ends(here, half + np.vstack([np.zeros(3), _STEP_RAD * np.eye(3)]), camera)
    spans = end - begin
    return spans[0], np.moveaxis((spans[1:] - spans[0]) / _STEP_RAD, 0, 2)


def _bows(xy: FloatArray, camera: Camera, halves: FloatArray) -> FloatArray:
    """How far the middle of a trail lies from where its star stood at mid-exposure (K, N, 2), px."""
    begin, end = _ends(camera.unproject(xy), halves, camera)
    off, unit = 0.5 * (begin + end) - xy, _axes(end - begin)[..., 0, :]
    along = (off * unit).sum(axis=-1, keepdims=True) * unit
    bow = along + (off - along) / 3.0
    return np.where(np.isfinite(bow), bow, 0.0)
