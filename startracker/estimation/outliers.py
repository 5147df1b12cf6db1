"""Displaced stars among few: the hypotheses of which star is displaced are weighted by their evidence."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from startracker.core import BoolArray, FloatArray, IntArray
from startracker.estimation.pose import Linearised, Pose, displacements

MOST_STARS = 12
"""Maximum number of stars for which hypotheses are compared; the residuals of more show one displaced star."""
FEWEST_STARS = 4
"""Minimum number of stars: of three, two remain, which any displacement fits."""
_DISPLACED = 0.05
"""Prior probability ε that a star is displaced."""
_LOG_ODDS = math.log(_DISPLACED / (1.0 - _DISPLACED))
_LOG_RANGE = 3.5
"""ln(d_max/d_min), for displacements from 4 standard errors of 0.02 px to 2.5 px."""
_LEAST_SIGMAS = 2.0
"""Width w of the density, in standard errors."""
_SUSPICIOUS = 0.05
"""Probability of larger residuals below which hypotheses are compared."""
_NEGLIGIBLE = 0.05
"""Weight of a hypothesis relative to the best, below which it is left out of the average (Occam's window; Madigan &
Raftery 1994, J. Am. Stat. Assoc. 89, 1535)."""

Fitted = Callable[[IntArray], Pose]
"""Fit of some rows of the stars."""


class Average(NamedTuple):
    """Fit of few stars, averaged over hypotheses."""

    pose: Pose
    """The most probable fit, with the rotation vector and covariance of the average."""
    used: BoolArray
    """Stars that are not displaced in the most probable fit, (M,)."""


class _Hypothesis(NamedTuple):
    """Logarithm of the weight, indices of the stars that are not displaced, and their fit."""

    log_weight: float
    rows: IntArray
    pose: Pose


@lru_cache(maxsize=64)
def _largest_chi2(freedom: int) -> float:
    return float(chdtri(float(freedom), _SUSPICIOUS))


def is_suspicious(pose: Pose, stars: int) -> bool:
    """Whether the residuals of so few stars are larger than their stated errors explain."""
    return FEWEST_STARS <= stars <= MOST_STARS and pose.chi2 > _largest_chi2(2 * stars - 3)


def rows_of(stars: Linearised, rows: IntArray) -> Linearised:
    """Some rows (K,) of linearised stars."""
    residual, slopes, offset, covariance, extra = (column[rows] for column in stars[:5])
    return stars._replace(residual=residual, slopes=slopes, offset=offset, covariance=covariance, extra=extra)


def average(stars: Linearised, fit: Fitted) -> Average:
    """Mean of the fits of all stars, and of those without one, weighted by evidence.

    Stars are excluded one by one, as long as that is the most probable hypothesis.

    Parameters
    ----------
    stars : Linearised
        M stars, linearised about one attitude.
    fit : callable
        Fit of some rows (K,) of them about the same attitude.
    """
    rows = np.arange(len(stars.residual))
    best = _Hypothesis(0.0, rows, fit(rows))
    best = best._replace(log_weight=best.pose.log_evidence)
    tried = [best]
    while len(best.rows) >= FEWEST_STARS:
        others = _without_each(best, stars, fit)
        # The alternatives to the last star that was excluded remain part of the average.
        tried = [h for h in tried if len(h.rows) <= len(best.rows) + 1] + others
        likeliest = max(others, key=lambda hypothesis: hypothesis.log_weight)
        if likeliest.log_weight <= best.log_weight:
            break
        best = likeliest
    used = np.zeros(len(rows), np.bool_)
    used[best.rows] = True
    return Average(_mean(tried, best), used)


def log_weight(stars: Linearised, used: BoolArray, pose: Pose) -> float:
    """ln of the posterior weight of the hypothesis that exactly the stars that are not used (M,) are displaced.

    The others have this fit; `Pose.turn` is the correction of the attitude about which the stars are linearised.
    """
    displaced = np.flatnonzero(~used)
    return pose.log_evidence + sum(_log_price(stars, int(row), pose) for row in displaced)


def _without_each(of: _Hypothesis, stars: Linearised, fit: Fitted) -> list[_Hypothesis]:
    """Hypotheses that one more star is displaced."""
    before = of.log_weight - of.pose.log_evidence
    found = []
    for k in range(len(of.rows)):
        rows = np.delete(of.rows, k)
        pose = fit(rows)
        price = _log_price(stars, int(of.rows[k]), pose)
        found.append(_Hypothesis(pose.log_evidence + before + price, rows, pose))
    return found


def _log_price(stars: Linearised, row: int, pose: Pose) -> float:
    """ln ε q for the residual of a star relative to the fit of others."""
    one = slice(row, row + 1)
    moved = displacements(stars.offset[one], stars.extra[one], pose.unknowns)[0]
    slopes = stars.slopes[row]
    away = stars.residual[row] - slopes @ pose.turn - moved
    spread = slopes @ pose.covariance @ slopes.T + pose.factor * stars.covariance[row]
    spread = spread + pose.systematic_px2 * np.eye(2)
    square = float(away @ np.linalg.solve(spread, away))
    scale = 2.0 * math.pi * math.sqrt(float(np.linalg.det(spread))) * _LOG_RANGE
    return _LOG_ODDS - math.log(scale * (square + _LEAST_SIGMAS**2))


def _mean(tried: list[_Hypothesis], best: _Hypothesis) -> Pose:
    """Moments of the mixture of all hypotheses; the other columns are those of the best."""
    weight = np.exp(np.array([h.log_weight for h in tried]) - max(h.log_weight for h in tried))
    weight = np.where(weight < _NEGLIGIBLE, 0.0, weight)
    weight /= weight.sum()
    turns: FloatArray = np.array([h.pose.turn for h in tried])
    turn = weight @ turns
    away = turns - turn
    covariance = np.tensordot(weight, np.array([h.pose.covariance for h in tried]), 1)
    # Variance of a mixture: the mean of the variances, plus the variance of the means.
    covariance = covariance + (away * weight[:, None]).T @ away
    camera_part = best.pose.camera_part + (covariance - best.pose.covariance)
    return best.pose._replace(turn=turn, covariance=covariance, camera_part=camera_part)
