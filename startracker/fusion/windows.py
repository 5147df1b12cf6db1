"""Consistency of each head with the filter, over few frames and over many.

The whitened innovations of a consistent filter are independent Gaussian deviates of variance 1. Of each head two things
are averaged with exponential weights: the innovations, whose mean shows a mounting that has moved, or a gyro that has;
and the squares of their successive differences, which show noise that is larger than stated whatever moves slowly (von
Neumann 1941, Ann. Math. Statist. 12, 367). The means of several heads at one time show which of them has moved: if all
of them have the same mean, it is not a head but the motion of the body that is not as assumed; if all but one have, it
is that one; of two, the means do not show which.

Source of the test of a mean: Bar-Shalom, Li & Kirubarajan 2001, *Estimation with Applications to Tracking and
Navigation*, section 5.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from startracker.core import FloatArray
from startracker.fusion.state import SCALES, HeadRecord, Window
from startracker.tracking.mekf import Innovation, chi_square_limit

_FALSE_ALARM = 1e-6
"""Probability that a consistent head exceeds the limit at one frame."""
_ONE_HEAD = 1e-3
"""Probability that the means of heads that agree differ by more than the limit of agreement."""
_CLEARLY = 9.0
"""By how much one explanation must be better than the next, in χ²: a ratio of likelihoods of 90."""
_WAIT = 2.0
"""Ratio of χ² to its limit up to which a decision between three or more heads may wait."""
_WORST = 5.5
"""Length to which a whitened innovation is cut, so that a single outlier does not raise an alarm."""
_FARTHEST2 = 1e3
"""χ² of a single attitude beyond which it is an outlier that says nothing about mounting and noise."""
_DISPLACED = 0.75
"""Displacement of the attitude by a motion of a mounting that is not known, see `unseen_shift`."""
_SCATTER = 64
_MOST_NOISE = 1e4
"""Largest factor on the covariance of a head."""

_LAMBDA = np.array([2.0 / (n + 1.0) for n in SCALES])
_SCATTER_LAMBDA = 2.0 / (_SCATTER + 1.0)


class Finding(NamedTuple):
    """Heads that are not as assumed; the motion of the body if there are none."""

    heads: tuple[int, ...]
    resolved: bool
    """Whether the other heads agree, and show that it is this one."""
    shift_rad: tuple[float, ...]
    """By how much the mean innovation of each of `heads` differs from those of the others."""
    duration_s: float
    """Time in which it happened."""


def extended(window: Window, innovation: Innovation, spread: FloatArray, t_s: float) -> Window:
    """The averages of a head after one more innovation.

    Parameters
    ----------
    spread : array, shape (3, 3)
        Innovation covariance in body axes, rad².
    t_s : float
        Time of the innovation.
    """
    white = innovation.whitened
    if white is None or not innovation.distance2 < _FARTHEST2:
        return window
    white = white * min(1.0, _WORST / max(math.sqrt(float(white @ white)), 1e-9))
    change = white - window.last
    scatter, counted = window.scatter, window.scatter_frames
    if window.frames:
        counted += 1
        weight = max(_SCATTER_LAMBDA, 1.0 / counted)
        scatter += weight * (float(change @ change) / 6.0 - scatter)
    return Window(
        window.mean + _LAMBDA[:, None] * (white - window.mean),
        window.frames + 1,
        white,
        scatter,
        counted,
        np.asarray(np.linalg.cholesky(spread), dtype=float),
        t_s if not window.frames else window.first_s,
        t_s,
    )


def restarted(window: Window) -> Window:
    """Averages that begin again; the scatter is kept."""
    return Window()._replace(scatter=window.scatter, scatter_frames=window.scatter_frames)


def _variance(count: int) -> FloatArray:
    """Variances (scales,) of the averages of a number of independent deviates of variance 1, from a start at zero."""
    return np.asarray(_LAMBDA / (2.0 - _LAMBDA) * -np.expm1(2.0 * count * np.log1p(-_LAMBDA)))


def noise_factor(record: HeadRecord, covariance: FloatArray, false_alarm: float = _FALSE_ALARM) -> float:
    """Factor on the stated covariance (3, 3) that the scatter of a head requires; that of the record if it fits.

    With ν = 2 N effective degrees of freedom of the mean of squared differences of N frames. An excess of the
    innovation's variance is attributed to the head's own noise.
    """
    window = record.window
    frames = min(window.scatter_frames, _SCATTER)
    if frames < SCALES[0] // 2:
        return record.noise
    freedom = 2.0 * frames
    high = chi_square_limit(round(freedom), false_alarm) / freedom
    low = chi_square_limit(round(freedom), 0.99) / freedom
    if not (window.scatter > high or (record.noise > 1.0 and window.scatter < low)):
        return record.noise
    if window.scatter < 1.0:
        return max(record.noise * window.scatter, 1.0)
    total, own = float(np.sum(window.factor**2)), float(np.trace(covariance))
    return min(record.noise + (window.scatter - 1.0) * total / own, _MOST_NOISE)


def finding(records: Sequence[HeadRecord], head: int) -> Finding | None:
    """What the innovations of a head, the last one included, say of it; None if they are consistent."""
    window = records[head].window
    if window.frames < SCALES[0]:
        return None
    z2 = _chi2_of_means(window)
    scale = int(np.argmax(z2))
    if not z2[scale] > chi_square_limit(3, _FALSE_ALARM):
        return None
    frames = min(SCALES[scale], window.frames)
    step_s = (window.last_s - window.first_s) / max(window.frames - 1, 1)
    duration_s = max(frames * step_s, 1e-3)
    present = {
        k: one.window
        for k, one in enumerate(records)
        if one.window.frames >= SCALES[0] // 2 and window.last_s - one.window.last_s <= duration_s
    }
    found = _explained(present, scale, duration_s)
    if len(found.heads) > 2 and z2[scale] < _WAIT * chi_square_limit(3, _FALSE_ALARM):
        return None  # more frames will show which of them it is
    return found


def contradiction(window: Window) -> float:
    """χ² (3 degrees of freedom) of the mean innovation of a head, the largest of all scales."""
    if window.frames < SCALES[0]:
        return 0.0
    return float(_chi2_of_means(window).max())


def _chi2_of_means(window: Window) -> FloatArray:
    return np.asarray(
        np.sum(window.mean**2, axis=1) / (_variance(window.frames) * max(window.scatter, 1.0)), dtype=float
    )


def unseen_shift(windows: Sequence[Window], chi2: float) -> float:
    """Displacement of the attitude, rad, by a steady motion of one mounting that begins with the averages and is not
    seen yet.

    Head k differs from the others by white noise of variance v_k in each frame, on one axis. The slope of the
    difference over N frames and a time T is known with the variance 12 v_k/(N T²), so that a motion which ends at the
    distance D has a mean χ² of D² N/(12 v_k). While it lasts, the constant alignments of the other heads take up its
    mean, D/2, so that an attitude from two heads is displaced by D (1 + 1/2)/2. Infinite before there are two heads.

    Parameters
    ----------
    windows : sequence of Window
        Those of the heads that have given attitudes.
    chi2 : float
        From which a motion counts as seen.
    """
    variance = np.array([float(np.sum(one.factor**2)) / 3.0 for one in windows])
    frames, worst = np.array([one.frames for one in windows]), 0.0
    for k in range(len(windows)):
        others = np.delete(np.arange(len(windows)), k)
        compared = min(int(frames[k]), int(frames[others].max(initial=0)))
        if not compared:
            return math.inf
        between = variance[k] + 1.0 / float(np.sum(1.0 / variance[others]))
        worst = max(worst, math.sqrt(12.0 * chi2 * between / compared))
    return _DISPLACED * worst


def _explained(present: Mapping[int, Window], scale: int, duration_s: float) -> Finding:
    """Which of several heads has moved, if it is one of them."""
    means = {k: one.factor @ one.mean[scale] for k, one in present.items()}
    weights = {k: np.linalg.inv(one.factor @ one.factor.T * _variance(one.frames)[scale]) for k, one in present.items()}

    def fit(heads: Sequence[int]) -> tuple[FloatArray, float]:
        """Common mean (3,) of some heads, and χ² of their differences from it."""
        total = sum((weights[k] for k in heads), np.zeros((3, 3)))
        common = np.linalg.solve(total, sum((weights[k] @ means[k] for k in heads), np.zeros(3)))
        return common, sum(float((means[k] - common) @ weights[k] @ (means[k] - common)) for k in heads)

    heads = tuple(present)
    if len(heads) < 2 or fit(heads)[1] <= chi_square_limit(3 * (len(heads) - 1), _ONE_HEAD):
        return Finding((), True, (), duration_s)
    if len(heads) > 2:
        without = sorted((fit([j for j in heads if j != k])[1], k) for k in heads)
        agreed = without[0][0] <= chi_square_limit(3 * (len(heads) - 2), _ONE_HEAD)
        if agreed and without[1][0] - without[0][0] > _CLEARLY:
            k = without[0][1]
            others = fit([j for j in heads if j != k])[0]
            return Finding((k,), True, (float(np.linalg.norm(means[k] - others)),), duration_s)
    shifts = []
    for k in heads:
        others = fit([j for j in heads if j != k])[0]
        shifts.append(float(np.linalg.norm(means[k] - others)))
    return Finding(heads, False, tuple(shifts), duration_s)
