"""How the camera turned while a frame's stars trailed, and where these stood in the middle of the exposure.

The image of a steady turn neither runs evenly nor straight, so that the middle of a trail lies some hundredths of a
pixel from where its star stood at mid-exposure. Along the trail the middle is that of its ends; across it is the mean
of an arc, which lies at two thirds of its height. An error of the turn about the line of sight, which directions and
lengths of the trails show, moves all stars alike: it is the covariance that all positions share.
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
"""Of the motion that the search found: in pixels, and of its length, as it knows no projection."""
_ENDS, _TILT = 4.0, 12.0
"""Variance of a trail's length, and of what its direction moves its ends by, over that of its middle."""
_FORM_ERROR_PX = 0.1
"""Error of a trail's length and direction besides: its bow, and the distortion that the calibration leaves."""
PROJECTED_PX = 20.0
"""Of shorter trails the motion that the search found says enough: its error moves a star by 0.002 px."""
_CAUCHY = 2.4
"""Residual in standard errors at which a trail has half its weight (95 % efficiency)."""
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
        by_turn = np.einsum("ni,nik->nk", axes_of(lines)[:, 0], slopes)
        return lines, np.einsum("nk,kj,nj->n", by_turn, self.covariance, by_turn)


def mid_exposure(trails: Trails, camera: Camera) -> Centroids:
    """Positions of the stars at mid-exposure.

    A trail whose own length or direction contradicts the turn by more than 4 standard errors has light of another star
    along it, which moves its middle in proportion: its covariance grows by the square of these standard errors. The
    error that all stars share is that of the turn.
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
    """Factor (N,) of the covariances of trails by how they contradict the turn; parameters as of `fit_turn`."""
    if np.hypot(*turn.half[:2]) * 2.0 * turn.camera.fx < PROJECTED_PX:
        return np.ones(len(xy))
    lines, by_turn = turn.lines_at(xy)
    off = np.einsum("nij,nj->ni", axes_of(lines), np.where(_opposite(lines, measured), -1.0, 1.0) * measured - lines)
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
        (a, b, c) of `startracker.detection.forms`.
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
    """Unknowns (3,) from the slopes (N, 2, 3) and values (N, 2) of trails, all in standard errors, outliers held down
    by their distance from what was found before; and the normal matrix."""
    slopes, values = design.reshape(-1, 3), target.ravel()
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
    """Pixels (2, K, N, 2) of directions (N, 3) turned back and forth by rotation vectors (K, 3)."""
    turned = here @ np.array([rotation_vector_to_matrix(sign * half).T for sign in (1.0, -1.0) for half in halves])
    return camera.project(turned.reshape(-1, 3)).reshape(2, len(halves), len(here), 2)


def _spans_and_slopes(here: FloatArray, half: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """From the beginning to the end of trails (N, 2), px, and the derivatives (N, 2, 3) by half the rotation vector."""
    begin, end = _ends(here, half + np.vstack([np.zeros(3), _STEP_RAD * np.eye(3)]), camera)
    spans = end - begin
    return spans[0], np.moveaxis((spans[1:] - spans[0]) / _STEP_RAD, 0, 2)


def _bows(xy: FloatArray, camera: Camera, halves: FloatArray) -> FloatArray:
    """How far the middle of a trail lies from where its star stood at mid-exposure (K, N, 2), px."""
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
        Middles of the trails, where the stars stood in the middle of the exposure; brightest first.
    motion : (3,)
        (a, b, c): during the exposure what is at (x, y) from the image's middle moved by (a − c y, b + c x), pixels;
        forwards or backwards is not known.
    lengths : (N, 2)
        Of the trails along x and y, px.
    fitted_alone : bool (N,)
        Whether a trail's length and direction were fitted to itself, not taken from the motion.
    """

    centroids: Centroids
    motion: FloatArray
    lengths: FloatArray
    fitted_alone: NDArray[np.bool_]

    __repr__ = fields_repr
