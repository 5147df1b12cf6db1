"""Covariances of few stars, whose residuals hardly determine their errors."""

from __future__ import annotations

import math
from functools import lru_cache

from scipy.special import chdtrc, chdtri, fdtri

from startracker.estimation.pose import Pose


@lru_cache(maxsize=1024)
def few_stars_factor(freedom: int, quantile: float = 0.999) -> float:
    """Factor on a covariance χ²/ν · P after which it contains 99.9 % of the errors: 3 F₀.₉₉₉(3, ν)/χ²₀.₉₉₉(3).

    If errors are known from the residuals only, eᵀP⁻¹e/(3 χ²/ν) has the distribution F(3, ν) rather than χ²/3: for
    three stars (ν = 3) its 99.9 % quantile is larger by a factor of 26, for twelve by 1.5. `quantile` selects another
    one.
    """
    return float(3.0 * fdtri(3.0, float(freedom), quantile) / chdtri(3.0, 1.0 - quantile))


def doubt_of_stated_errors(chi2: float, freedom: int) -> float:
    """How strongly residuals contradict the stated errors, from 0 to 1: 1 − 2 α(p) for a probability p of a larger χ².

    α = [1 + (−e p ln p)⁻¹]⁻¹ is the lowest probability that the errors are as stated, for even prior odds, whatever the
    alternative; 1/2 for p > 1/e (Sellke, Bayarri & Berger 2001, The American Statistician 55, 62, equation 3).
    """
    p = float(chdtrc(float(freedom), chi2))
    if p >= math.exp(-1.0):
        return 0.0
    odds = -math.e * p * math.log(p) if p > 0.0 else 0.0
    return (1.0 - odds) / (1.0 + odds)


def of_unknown_errors(pose: Pose, stars: int) -> Pose:
    """Fit of `stars` stars without stated errors, with covariances that contain 99.9 % of the errors."""
    return _widened(pose, few_stars_factor(_freedom(stars)))


def with_doubt(pose: Pose, stars: int) -> Pose:
    """Fit of few stars, with covariances increased as far as the residuals contradict the stated errors.

    The factor for a complete contradiction is that for 99 % of the errors. With five stars (ν = 7) no rule contains
    99.9 % both of errors as stated and of errors twice as large, unless it doubles the covariance of all fields of five
    stars.
    """
    freedom = _freedom(stars)
    doubt = doubt_of_stated_errors(pose.chi2, freedom)
    return pose if doubt == 0.0 else _widened(pose, 1.0 + doubt * (few_stars_factor(freedom, 0.99) - 1.0))


def _freedom(stars: int) -> int:
    # Two residuals per star, less three rotation angles.
    return max(2 * stars - 3, 1)


def _widened(pose: Pose, factor: float) -> Pose:
    sigma_px = math.sqrt(factor) * pose.sigma_px
    covariance, camera_part = factor * pose.covariance, factor * pose.camera_part
    return pose._replace(covariance=covariance, camera_part=camera_part, sigma_px=sigma_px)
