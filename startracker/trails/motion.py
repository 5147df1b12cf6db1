"""Common motion of the lines of a frame: each line is fitted, then one length for all, then the motion.

A fragment of a trail, or a slightly tilted line, looks like a shorter trail, and several of these agree with each
other. So the length is not that of most lines, but the one with which the light along all lines agrees, far beyond
their ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray, IntArray
from startracker.detection.forms import agrees, common_motion, motion_at
from startracker.detection.thresholds import MOTION_TOLERANCE_PX, MOTION_TOLERANCE_SHARE
from startracker.detection.tiles import Plane
from startracker.geometry.camera import Camera
from startracker.sorting import median
from startracker.trails.fit import best_stretches, fit_trail, light_along
from startracker.trails.lines import COARSE_SIGMA, LONGEST_SHARE
from startracker.trails.model import ANGLE, FLUX, HALF, LINE, SIGMA, TURNED, X, Y
from startracker.trails.turn import PROJECTED_PX, Turn, axes_of, fit_turn, weighted_step

FloatImage = NDArray[np.float32]

Flags = NDArray[np.bool_]

_ENOUGH = 12
"""Largest number of lines to which the motion is fitted."""
_WIDTH_TRAILS = 5
_FEWEST = 4
_SHORTEST_MOTION_PX = 5.0
"""Least length of the motion, px. These lines were fitted, each above the noise as a whole, so that shorter ones are
significant than among objects."""
_SHORTEST_PX = 4
_LENGTH_STEP = 1.02
"""Ratio of successive lengths that are tried; a flat image plane stretches trails by as much 11° from the axis."""
_LOSS = 25.0
"""Largest loss of a line's squared signal-to-noise ratio that is counted (5 standard errors), and the least amount by
which every other length must be worse."""
_BLUR_SIGMAS = 6.0
"""Largest blur of both ends together, in widths of the star image: at three widths beyond an end, a trail of 1,000
times the noise is as bright as the noise."""
_CUT_PX = 4.0
"""Distance from the border, px, below which a trail may continue beyond it."""
_LENGTH_ERROR_PX, _STRETCH, _TURN_PX = 0.3, 0.01, 0.1
"""Further differences between trails: error of the length, px; relative stretch, because a flat image plane stretches
towards its corners by the square of the angle; error of the direction, px."""


class Signal(NamedTuple):
    """Data to which trails are fitted: residual above the background and its noise, DN, and DN per electron."""

    residual: FloatImage
    noise: Plane
    inverse_gain: float

    @property
    def middle(self) -> FloatArray:
        """Centre of the image (x, y), px."""
        return 0.5 * (np.array(self.residual.shape[::-1], dtype=float) - 1.0)


class CommonMotion(NamedTuple):
    """Motion that the trails of a frame share.

    Parameters
    ----------
    motion, covariance : (3,), (3, 3)
        (a, b, c) of `startracker.detection.forms`, and its covariance.
    middle : (2,)
        Centre of the image, px.
    sigma : float
        Width of the star images, px.
    turn : Turn, optional
        The motion as a rotation, which includes the camera's projection.
    """

    motion: FloatArray
    covariance: FloatArray
    middle: FloatArray
    sigma: float
    turn: Turn | None

    def lines_at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Line (N, 2), px, of a trail at each position, and the variance of its length (N,), px²."""
        if self.turn is not None:
            return self.turn.lines_at(xy)
        lines, (x, y) = motion_at(xy - self.middle, self.motion), (xy - self.middle).T
        u, v = (lines / np.maximum(np.hypot(*lines.T), 1e-12)[:, None]).T
        # Derivatives of a trail's length with respect to a, b and c: its unit vector (u, v) times (1, 0, −y), (0, 1,
        # x).
        by_motion = np.column_stack([u, v, v * x - u * y])
        return lines, np.einsum("nk,kj,nj->n", by_motion, self.covariance, by_motion)


def lengths_of(table: FloatArray) -> FloatArray:
    """Lengths (N, 2) along x and y of trails (N, 7), px."""
    out, length = np.empty((len(table), 2)), 2.0 * table[:, HALF]
    out[:, 0], out[:, 1] = length * np.cos(table[:, ANGLE]), length * np.sin(table[:, ANGLE])
    return out


def within(signal: Signal, table: FloatArray, margin: FloatArray | float) -> Flags:
    """Mask of the trails (N, 7) whose ends are both at least `margin` px inside the image."""
    reach = 0.5 * np.abs(lengths_of(table)) + np.reshape(margin, (-1, 1))
    inside = np.abs(table[:, [X, Y]] - signal.middle) + reach <= signal.middle
    return np.asarray(inside.all(axis=1))


def _is_inside(signal: Signal, line: FloatArray) -> bool:
    """Whether a line (7,) has both ends inside the image by `_CUT_PX`."""
    height, width = signal.residual.shape
    x, y, _, _, angle, half, _ = line.tolist()  # floats; one-row arrays are 20 × slower
    margin_x, margin_y = half * abs(math.cos(angle)) + _CUT_PX, half * abs(math.sin(angle)) + _CUT_PX
    return bool(margin_x <= x <= width - 1.0 - margin_x and margin_y <= y <= height - 1.0 - margin_y)


def find_motion(
    signal: Signal, lines: FloatArray, sigma: float, measure_sigma: bool, camera: Camera | None = None
) -> CommonMotion | None:
    """Motion that lines (N, 4), see `candidate_lines`, share; None if there is none.

    Parameters
    ----------
    sigma : float
        Width of the star images, px.
    measure_sigma : bool
        Whether to measure the width in the brightest trails instead.
    camera : Camera, optional
        Its projection stretches and rotates trails over the field; None: a narrow field is assumed.
    """
    longest = LONGEST_SHARE * min(signal.residual.shape)
    steps = np.arange(0.0, math.log(max(longest, 2.0 * _SHORTEST_PX) / _SHORTEST_PX), math.log(_LENGTH_STEP))
    lengths = np.unique(np.rint(_SHORTEST_PX * np.exp(steps)).astype(np.int64))
    straight = _straightened(signal, lines, sigma, lengths)
    if straight is None:
        return None
    xy, trails = straight.table[:, [X, Y]] - signal.middle, lengths_of(straight.table)
    motion = common_motion(xy, trails, _SHORTEST_MOTION_PX, _SHORTEST_MOTION_PX)
    motion = None if motion is None else _lengthened(motion, xy, trails, straight)
    return None if motion is None else _fitted(signal, motion, straight, measure_sigma, camera)


class _Straight(NamedTuple):
    """Lines (N, 7), brightest first, each with its best length; results (N, L) for all lengths (L,).

    `scores` and `middles` are those of `best_stretches`, the middles relative to that of the line.
    """

    table: FloatArray
    lengths: IntArray
    scores: FloatArray
    middles: FloatArray


def _straightened(signal: Signal, lines: FloatArray, sigma: float, lengths: IntArray) -> _Straight | None:
    """Fit position and direction of the lines; returns those that are significant and complete, or None if too few."""
    found = []
    for x, y, u, v in lines:
        start = np.array([x, y, 0.0, 0.0, math.atan2(v, u), max(math.hypot(u, v), 2.0), sigma])
        fitted, _, chi2, _ = fit_trail(signal.residual, signal.noise, start, TURNED, 3.0, signal.inverse_gain)
        if not chi2 < math.inf or math.hypot(fitted[X] - x, fitted[Y] - y) > start[HALF] + 3.0:
            continue
        total = light_along(signal.residual, signal.noise, fitted, int(lengths[-1]))
        score, middle = best_stretches(total, lengths)
        best = int(np.argmax(score))
        _move(fitted, middle[best], lengths[best])
        if score[best] >= COARSE_SIGMA and _is_inside(signal, fitted):
            found.append((fitted, score, middle - middle[best]))
        if len(found) == _ENOUGH:
            break
    if len(found) < _FEWEST:
        return None
    found.sort(key=lambda line: -line[0][FLUX])
    table, scores, middles = (np.array(column) for column in zip(*found, strict=True))
    return _Straight(table, lengths, scores, middles)


def _move(line: FloatArray, along: float, length: float) -> None:
    """Move a line (7,) along its direction, px, in place, and set its length."""
    line[X] += along * math.cos(line[ANGLE])
    line[Y] += along * math.sin(line[ANGLE])
    line[HALF] = 0.5 * length


def _lengthened(motion: FloatArray, xy: FloatArray, trails: FloatArray, straight: _Straight) -> FloatArray | None:
    """Motion scaled to the length that explains the light along all lines of its direction; None if it is ambiguous."""
    lengths, expected = straight.lengths, motion_at(xy, motion)
    size = np.hypot(*expected.T)
    aside = np.abs(expected[:, 0] * trails[:, 1] - expected[:, 1] * trails[:, 0]) / np.maximum(size, 1e-9)
    along = aside < MOTION_TOLERANCE_PX + _STRETCH * np.hypot(*trails.T)
    squares = np.square(np.maximum(straight.scores[along], 0.0))
    # The best score of each length and its two neighbours is used, because the lengths that are tried are discrete.
    near = squares.copy()
    np.maximum(near[:, 1:], squares[:, :-1], out=near[:, 1:])
    np.maximum(near[:, :-1], squares[:, 1:], out=near[:, :-1])
    scale = lengths / median(size.copy())
    index = np.minimum(np.searchsorted(lengths, size[along, None] * scale), len(lengths) - 1)
    short_by = squares.max(axis=1)[:, None] - np.take_along_axis(near, index, axis=1)
    loss = np.minimum(short_by, _LOSS).sum(axis=0)
    best = int(np.argmin(loss))
    others = np.abs(lengths - lengths[best]) > MOTION_TOLERANCE_PX + MOTION_TOLERANCE_SHARE * lengths[best]
    sure = not others.any() or loss[others].min() > loss[best] + _LOSS
    return motion * scale[best] if sure else None


def _fitted(
    signal: Signal, motion: FloatArray, straight: _Straight, measure_sigma: bool, camera: Camera | None
) -> CommonMotion | None:
    """Motion from fits of the lines, which start with the length that a first motion gives them."""
    fits, errors = [], []
    expected = np.hypot(*motion_at(straight.table[:, [X, Y]] - signal.middle, motion).T)
    for line, length, middle in zip(straight.table, expected, straight.middles, strict=True):
        start = line.copy()
        _move(start, float(np.interp(length, straight.lengths, middle)), length)
        fitted, covariance, chi2, _ = fit_trail(
            signal.residual, signal.noise, start, LINE, 3.0 + 0.05 * start[HALF], signal.inverse_gain
        )
        if chi2 < math.inf and _is_inside(signal, fitted):
            fits.append(fitted)
            errors.append(4.0 * chi2 * np.array([covariance[HALF, HALF], fitted[HALF] ** 2 * covariance[ANGLE, ANGLE]]))
    if len(fits) < _FEWEST:
        return None
    table, variance = np.array(fits), np.array(errors)
    trails = lengths_of(table)
    motion = _without_blur(motion, table, signal.middle)
    fitting = agrees(trails, motion_at(table[:, [X, Y]] - signal.middle, motion))
    if np.count_nonzero(fitting) < _FEWEST:
        return None
    table, trails, variance = table[fitting], trails[fitting], variance[fitting] + _TURN_PX**2
    stretch = np.array([1.0, 0.0]) * (_LENGTH_ERROR_PX + _STRETCH * 2.0 * table[:, HALF, None]) ** 2
    motion, covariance = _weighted_motion(table[:, [X, Y]] - signal.middle, trails, variance + stretch, motion)
    turn = None
    if camera is not None and math.hypot(*motion[:2]) > PROJECTED_PX:
        turn = fit_turn(table[:, [X, Y]], trails, variance, motion, camera)
    sigma = median(table[:_WIDTH_TRAILS, SIGMA].copy()) if measure_sigma else float(straight.table[0, SIGMA])
    return CommonMotion(motion, covariance, signal.middle, sigma, turn)


def _without_blur(motion: FloatArray, fits: FloatArray, middle: FloatArray) -> FloatArray:
    """Motion shortened by the median excess of its lengths over those of the fits (N, 7), up to `_BLUR_SIGMAS`.

    The light along a line (`light_along`) is clipped, so that its length includes the blur at both ends: 13 px for a
    bright trail of 10 px.
    """
    expected = np.hypot(*motion_at(fits[:, [X, Y]] - middle, motion).T)
    longer_by = median(expected - 2.0 * fits[:, HALF])
    blur = min(max(longer_by, 0.0), _BLUR_SIGMAS * median(fits[:, SIGMA].copy()))
    return np.asarray(motion * (1.0 - blur / median(expected)))


def _weighted_motion(
    xy: FloatArray, trails: FloatArray, variance: FloatArray, motion: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Robust least-squares motion of trails, and its covariance (3, 3).

    `variance` (N, 2), px², is that of their lengths and of the ends across them. Directions of long trails are known
    far better than their lengths; two trails in line look like one longer trail.
    """
    axes = axes_of(trails)
    ones, zeros = np.ones(len(xy)), np.zeros(len(xy))
    design = np.stack([np.column_stack([ones, zeros, -xy[:, 1]]), np.column_stack([zeros, ones, xy[:, 0]])], axis=1)
    design = (axes @ design) / np.sqrt(variance)[:, :, None]
    length = np.hypot(*trails.T) / np.sqrt(variance[:, 0])
    for _ in range(8):
        target = np.zeros((len(xy), 2))
        target[:, 0] = np.where(design[:, 0] @ motion < 0.0, -length, length)
        motion, normal = weighted_step(design, target, motion)
    return motion, np.asarray(np.linalg.inv(normal))
