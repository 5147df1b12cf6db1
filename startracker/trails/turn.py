"""Rotation of the camera while a frame's stars trailed, and their positions in the middle of the exposure.

The image of a steady rotation is neither uniform nor straight, so that the middle of a trail differs by some hundredths
of a pixel from the star's position at mid-exposure. Along the trail, the measured middle is that of its ends; across
it, it is the mean of an arc, at two thirds of its height. An error of the rotation about the line of sight, which is
determined from directions and lengths of the trails, moves all stars together: it is the covariance that all positions
share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.psf_fit import MISFIT_SIGMA
from startracker.centroid.result import Centroids
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.geometry.camera import Camera
from startracker.geometry.linalg import solve

_MOTION_ERROR_PX, _MOTION_ERROR_SHARE = 0.3, 0.02
"""Errors of the motion from the search: in pixels, and as a share of its length, because it ignores the projection."""
_ENDS, _TILT = 4.0, 12.0
"""Ratios of the variance of a trail's length, and of its ends across it, to that of its middle."""
_FORM_ERROR_PX = 0.1
"""Further error of a trail's length and direction, px: its curvature, and the distortion that the calibration
leaves."""
PROJECTED_PX = 20.0
"""Length, px, below which the motion from the search is sufficient: its error moves a star by 0.002 px."""
_CAUCHY = 2.4
"""Residual in standard errors at which a trail has half its weight (95 % efficiency for Gaussian errors)."""
_STEPS = 6
_STEP_RAD = 1e-6


class Turn(NamedTuple):
    """Half the rotation vector of the exposure (3,), camera axes, rad, its covariance (3, 3), and the camera."""

    half: FloatArray
    covariance: FloatArray
    camera: Camera

    def lines_at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Vector (N, 2), px, from the beginning to the end of a trail at each position, and the variance of its length
        (N,)."""
        lines, slopes = _spans_and_slopes(self.camera.unproject(xy), self.half, self.camera)
        by_turn = np.einsum("ni,nik->nk", axes_of(lines)[:, 0], slopes)
        return lines, np.einsum("nk,kj,nj->n", by_turn, self.covariance, by_turn)


def mid_exposure(trails: Trails, camera: Camera) -> Centroids:
    """Positions of the stars at mid-exposure.

    If a trail's own length or direction contradicts the rotation by more than 4 standard errors, it includes light of
    another star, which moves its middle in proportion: its covariance is multiplied by the square of these standard
    errors. The error that all stars share is that of the rotation.
    """
    stars, own = trails.centroids, trails.fitted_alone
    xy, axes = stars.xy, axes_of(trails.lengths[own])
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
    """Factor (N,) on the covariances of trails that contradict the rotation; parameters as for `fit_turn`."""
    if np.hypot(*turn.half[:2]) * 2.0 * turn.camera.fx < PROJECTED_PX:
        return np.ones(len(xy))
    lines, by_turn = turn.lines_at(xy)
    off = np.einsum("nij,nj->ni", axes_of(lines), np.where(_opposite(lines, measured), -1.0, 1.0) * measured - lines)
    error2 = variance + _FORM_ERROR_PX**2 + np.column_stack([by_turn, np.zeros(len(xy))])
    away = (off**2 / error2).max(axis=1, initial=0.0)
    return np.where(away > MISFIT_SIGMA**2, away, 1.0)


def _opposite(lines: FloatArray, measured: FloatArray) -> NDArray[np.bool_]:
    """Mask (N, 1) of lines (N, 2) that run in the opposite direction."""
    return np.asarray((lines * measured).sum(axis=1, keepdims=True) < 0.0)


def fit_turn(xy: FloatArray, measured: FloatArray, variance: FloatArray, motion: FloatArray, camera: Camera) -> Turn:
    """Robust fit of the camera's rotation to trails that were fitted individually.

    Parameters
    ----------
    xy, measured : (N, 2)
        Their middles, and lengths along x and y, px.
    variance : (N, 2)
        Variances of the length, and of the ends across it, px².
    motion : (3,)
        (a, b, c) of `startracker.detection.forms`.
    camera : Camera
    """
    a, b, c = motion
    # In a narrow field a shift of a px along x is a rotation by a / fx about y, and b px along y by −b / fy about x.
    start = 0.5 * np.array([-b / camera.fy, a / camera.fx, c])
    error = _MOTION_ERROR_PX + _MOTION_ERROR_SHARE * math.hypot(a, b)
    information = np.diag((np.array([2.0 * camera.fx, 2.0 * camera.fx, camera.width]) / error) ** 2)
    if math.hypot(a, b) < PROJECTED_PX or not len(xy):
        return Turn(start, np.asarray(np.linalg.inv(information)), camera)
    lines, slopes = _spans_and_slopes(camera.unproject(xy), start, camera)
    sign = np.where(_opposite(lines, measured), -1.0, 1.0)
    axes, scale = axes_of(lines), 1.0 / np.sqrt(variance)
    design = (axes @ slopes) * scale[:, :, None]
    off = np.einsum("nij,nj->ni", axes, sign * measured - lines) * scale
    correction = np.zeros(3)
    for _ in range(_STEPS):
        correction, normal = weighted_step(design, off, correction, information)
    return Turn(start + correction, np.asarray(np.linalg.inv(normal)), camera)


def weighted_step(
    design: FloatArray, target: FloatArray, found: FloatArray, information: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Robust least-squares step for three unknowns, and its normal matrix (3, 3).

    `design` (N, 2, 3) holds the derivatives and `target` (N, 2) the values of trails, in standard errors; outliers are
    weighted down by their distance from the solution `found` of the step before.
    """
    slopes, values = design.reshape(-1, 3), target.ravel()
    # Weights of Cauchy's distribution.
    weighted = slopes.T / (1.0 + ((values - slopes @ found) / _CAUCHY) ** 2)
    normal = weighted @ slopes + information
    return solve(normal, weighted @ values), normal


def axes_of(lengths: FloatArray) -> FloatArray:
    """Unit vectors along and across trails (..., 2, 2)."""
    axes, length = np.empty((*lengths.shape, 2)), np.maximum(np.hypot(lengths[..., 0], lengths[..., 1]), 1e-12)
    axes[..., 0, :] = lengths / length[..., None]
    axes[..., 1, 0], axes[..., 1, 1] = -axes[..., 0, 1], axes[..., 0, 0]
    return axes


def _ends(here: FloatArray, halves: FloatArray, camera: Camera) -> FloatArray:
    """Pixels (2, K, N, 2) of directions (N, 3) rotated by rotation vectors (K, 3) and by their opposites."""
    turned = here @ np.array([rotation_vector_to_matrix(sign * half).T for sign in (1.0, -1.0) for half in halves])
    return camera.project(turned.reshape(-1, 3)).reshape(2, len(halves), len(here), 2)


def _spans_and_slopes(here: FloatArray, half: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Vectors (N, 2), px, from beginning to end of trails, and derivatives (N, 2, 3) by half the rotation vector."""
    begin, end = _ends(here, half + np.vstack([np.zeros(3), _STEP_RAD * np.eye(3)]), camera)
    spans = end - begin
    return spans[0], np.moveaxis((spans[1:] - spans[0]) / _STEP_RAD, 0, 2)


def _bows(xy: FloatArray, camera: Camera, halves: FloatArray) -> FloatArray:
    """Displacement (K, N, 2), px, of the middle of a trail from the star's position at mid-exposure."""
    begin, end = _ends(camera.unproject(xy), halves, camera)
    off, unit = 0.5 * (begin + end) - xy, axes_of(end - begin)[..., 0, :]
    along = (off * unit).sum(axis=-1, keepdims=True) * unit
    bow = along + (off - along) / 3.0
    return np.where(np.isfinite(bow), bow, 0.0)


@dataclass(frozen=True, eq=False)
class Trails:
    """Stars trailed along the motion of the frame.

    Parameters
    ----------
    centroids : Centroids
        Middles of the trails, the stars' positions in the middle of the exposure, brightest first.
    motion : (3,)
        (a, b, c): during the exposure, the image at (x, y), relative to its centre, moved by (a − c y, b + c x), px;
        the direction of time is unknown.
    lengths : (N, 2)
        Lengths of the trails along x and y, px.
    fitted_alone : bool (N,)
        Whether a trail's length and direction were fitted individually, rather than taken from the motion.
    """

    centroids: Centroids
    motion: FloatArray
    lengths: FloatArray
    fitted_alone: NDArray[np.bool_]

    __repr__ = fields_repr
