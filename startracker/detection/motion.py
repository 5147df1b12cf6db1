"""The frame's own motion: streaks that all fit one rotation of the camera are stars, the odd ones out are not."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.detection.thresholds import (
    AGREEING_SHARE,
    CLEAR_MOTION_PX,
    FEWEST_AGREEING,
    MOTION_TOLERANCE_PX,
    MOTION_TOLERANCE_SHARE,
    SHORT_AGREEING_SHARE,
    SHORTEST_MOTION_PX,
)
from startracker.kernels import kernel
from startracker.sorting import median

_TRIED = 14
"""Brightest streaks of which every pair proposes a motion."""


def elongations(variance_x: FloatArray, variance_y: FloatArray, covariance: FloatArray) -> FloatArray:
    """Length along x and y (N, 2), pixels, of the even line that widens round images to these second moments.

    A line of length L adds L²/12 along itself. Which of its ends came first is unknown: the sign means nothing.
    """
    half = np.hypot(0.5 * (variance_x - variance_y), covariance)
    angle = 0.5 * np.arctan2(2.0 * covariance, variance_x - variance_y)
    length = np.sqrt(24.0 * half)
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])


def common_motion(
    xy: FloatArray, lines: FloatArray, shortest_px: float = SHORTEST_MOTION_PX, clear_px: float = CLEAR_MOTION_PX
) -> FloatArray | None:
    """Motion (a, b, c) that most streaks share, or None where fewer than four do.

    Of the brightest 0.6 must share it, or 0.7 where it is shorter than `clear_px` in the middle of them, and it must
    not be shorter than `shortest_px`.

    A camera that turns moves the image at (x, y) by (a − c y, b + c x): two shifts and a turn about the line of
    sight (narrow field). Every pair of the brightest streaks, with either sign, proposes one by least squares; the
    one that most of these fit, to 12 % of the length and 1 px, is taken and fitted to all that do. Fainter objects have
    no say before: among hundreds of them some always agree.

    Parameters
    ----------
    xy : (N, 2)
        Centres, brightest first, about the middle of the image.
    lines : (N, 2)
        From `elongations`.
    shortest_px, clear_px : float
        Least motion, and the least that 0.6 suffice for.
    """
    count = len(xy)
    if count < FEWEST_AGREEING:
        return None
    tried = min(count, _TRIED)
    best, motion = _search(xy, lines, tried)
    if best < FEWEST_AGREEING:
        return None
    for _ in range(2):
        expected = motion_at(xy, motion)
        sign = np.where((expected * lines).sum(axis=1) < 0.0, -1.0, 1.0)
        fits = agrees(lines, expected)
        if np.count_nonzero(fits[:tried]) < max(FEWEST_AGREEING, AGREEING_SHARE * tried):
            return None
        motion = _fit(xy[fits], (sign[:, None] * lines)[fits])
    length = median(np.hypot(*motion_at(xy[:tried], motion).T))
    sure = length > clear_px or np.count_nonzero(fits[:tried]) >= SHORT_AGREEING_SHARE * tried
    return motion if sure and length > shortest_px else None


def frame_motion(xy: FloatArray, lines: FloatArray) -> FloatArray | None:
    """`common_motion`, also where a train of satellites has bright streaks, all alike in another direction.

    Where no motion of the brightest streaks is that of half of all streaks, each of the two largest groups of one
    motion is set aside in turn; of the motions that the others then share, that of more streaks is the frame's.
    """
    first = common_motion(xy, lines)
    if len(xy) < 2 * FEWEST_AGREEING or (
        first is not None and 2 * np.count_nonzero(_fits(xy, lines, first)) >= len(xy)
    ):
        return first
    best, most, left = first, 0 if first is None else np.count_nonzero(_fits(xy, lines, first)), np.ones(len(xy), bool)
    for _ in range(2):
        agreeing, group = _search(xy[left], lines[left], min(int(left.sum()), _TRIED))
        if agreeing < FEWEST_AGREEING:
            break
        aside = _fits(xy, lines, group)
        left &= ~aside
        motion = common_motion(xy[~aside], lines[~aside])
        count = 0 if motion is None else np.count_nonzero(_fits(xy, lines, motion))
        if count > most:
            best, most = motion, count
    return best


def _fits(xy: FloatArray, lines: FloatArray, motion: FloatArray) -> NDArray[np.bool_]:
    """Which streaks a motion explains."""
    return agrees(lines, motion_at(xy, motion))


def motion_at(xy: FloatArray, motion: FloatArray) -> FloatArray:
    """Streak (N, 2) that a motion makes at each position."""
    a, b, c = motion
    return np.column_stack([a - c * xy[:, 1], b + c * xy[:, 0]])


def agrees(lines: FloatArray, expected: FloatArray) -> NDArray[np.bool_]:
    """Which streaks are as expected, either way round."""
    limit = MOTION_TOLERANCE_PX + MOTION_TOLERANCE_SHARE * np.hypot(*expected.T)
    apart = np.minimum(np.hypot(*(lines - expected).T), np.hypot(*(lines + expected).T))
    return np.asarray(apart <= limit)


def _fit(xy: FloatArray, lines: FloatArray) -> FloatArray:
    """Least squares: the turn from the differences to the means, the shift from these."""
    (x, y), (u, v) = xy.mean(axis=0), lines.mean(axis=0)
    apart = xy - (x, y)
    turn = (apart[:, 0] @ lines[:, 1] - apart[:, 1] @ lines[:, 0]) / max(float((apart * apart).sum()), 1e-12)
    return np.array([u + turn * y, v - turn * x, turn])


@kernel
def _search(xy: FloatArray, lines: FloatArray, tried: int) -> tuple[int, FloatArray]:
    best, most = np.zeros(3), 0
    smallest = np.inf
    for first in range(tried):
        for second in range(first + 1, tried):
            for sign in (1.0, -1.0):
                # least squares of two points: the turn from their differences, the shift from their means
                x, y = xy[second, 0] - xy[first, 0], xy[second, 1] - xy[first, 1]
                u = sign * lines[second, 0] - lines[first, 0]
                v = sign * lines[second, 1] - lines[first, 1]
                c = (x * v - y * u) / max(x * x + y * y, 1e-12)
                a = 0.5 * (lines[first, 0] + sign * lines[second, 0] + c * (xy[first, 1] + xy[second, 1]))
                b = 0.5 * (lines[first, 1] + sign * lines[second, 1] - c * (xy[first, 0] + xy[second, 0]))
                count, total = 0, 0.0
                for k in range(tried):
                    p, q = a - c * xy[k, 1], b + c * xy[k, 0]
                    u, v = lines[k, 0], lines[k, 1]
                    limit = MOTION_TOLERANCE_PX + MOTION_TOLERANCE_SHARE * math.sqrt(p * p + q * q)
                    apart = math.sqrt(min((u - p) ** 2 + (v - q) ** 2, (u + p) ** 2 + (v + q) ** 2))
                    if apart <= limit:
                        count += 1
                        total += apart
                if count > most or (count == most and total < smallest):
                    best[0], best[1], best[2], most, smallest = a, b, c, count, total
    return most, best
