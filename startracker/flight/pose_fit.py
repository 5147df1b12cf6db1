"""Fit of matched stars in integers: rotation, focal length and shears, averaged over models of their errors.

The model, its priors and the average are those of `startracker.estimation.pose`: a factor of all variances, a
systematic error τ equal for all stars, and the camera as calibrated, with a free focal length, or with shears as well.
Left out are unequal axes of the systematic error and errors that depend on the sub-pixel position.

Sums over stars are exact in 64 bits; small systems of equations are solved in real numbers (`Real`). The C source
(`c/tracker_pose_fit.c`) performs the same operations in the same order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.estimation.pose import FOCAL_SIGMA, FREE_FOCAL_SIGMA, SHEAR_SIGMA, SYSTEMATIC, TRUSTED
from startracker.fixed_point.formats import Integers
from startracker.flight.linear import factorised, solved
from startracker.flight.real import ONE, ZERO, Real, log2, power_of_2

UNKNOWNS = 6
COLUMN_BITS, RESIDUAL_BITS, VARIANCE_BITS = 14, 16, 36
"""Fraction bits of the columns, of residuals in pixels and of variances in square pixels."""
PRIOR_BITS = 24
GRID = len(SYSTEMATIC)
_MODELS = (0.6, 0.3, 0.1)
_WEIGHT_BITS = 20
_SIZES = (3, 4, 6)
_SYSTEMATIC_SHARE = 41943  # 0.04, the square of the first τ, of 20 fraction bits
_LONGEST = 1 << 42
_LEAST_CHI2 = Real(1, -40)
_NEGLIGIBLE = 60 << PRIOR_BITS


class FitPriors(NamedTuple):
    """Priors in the units of the columns."""

    information: Integers
    """1/σ² of focal length and shears in each model, 24 fraction bits, (3, 3)."""
    model: Integers
    """log₂ of the prior of each model and of the densities at the centre of its unknowns' priors, 24 fraction bits."""
    systematic: Integers
    """log₂ of the prior of each systematic error, 24 fraction bits, (20,)."""


class Stars(NamedTuple):
    """Matched stars, linearised about an attitude."""

    columns: Integers
    """Derivatives of (x, y), (M, 2, 6), 14 fraction bits."""
    residual: Integers
    """Measured minus predicted, pixels of 16 fraction bits, below 8 px, (M, 2)."""
    variance: Integers
    """On one axis, square pixels of 36 fraction bits, (M,)."""


class Fit(NamedTuple):
    """Result of a fit, in the units of the columns."""

    step: list[Real]
    """Unknowns, (6,)."""
    covariance: list[list[Real]]
    """Of the first three, (3, 3)."""
    factor: Real
    """Mean factor of the stated variances."""
    systematic: Real
    """Mean systematic variance, square pixels."""


def fit_priors(radius_px: float) -> FitPriors:
    """Priors for columns in units of a radius."""
    sigma = np.array(
        [[FOCAL_SIGMA] + [SHEAR_SIGMA] * 2, [FOCAL_SIGMA] + [SHEAR_SIGMA] * 2, [FREE_FOCAL_SIGMA] + [SHEAR_SIGMA] * 2]
    )
    information = 1.0 / (sigma * radius_px) ** 2
    model = [
        math.log2(share) + 0.5 * float(np.log2(information[m, : size - 3]).sum())
        for m, (share, size) in enumerate(zip(_MODELS, _SIZES, strict=True))
    ]
    falling = 0.75 ** (0.5 * np.arange(GRID - 1))
    systematic = np.log2(np.concatenate([[1.0], falling / falling.sum()]))
    one = float(1 << PRIOR_BITS)
    return FitPriors(*(np.rint(values * one).astype(np.int64) for values in (information, np.array(model), systematic)))


def fit(stars: Stars, priors: FitPriors, plain: bool) -> Fit | None:
    """Average of all models weighted by evidence; `plain`: only the camera as calibrated, without systematic errors.

    None if the stars do not determine an attitude.
    """
    unit = median(stars.variance.tolist())
    average = _Average()
    for t in range(1 if plain else GRID):
        added = 0 if t == 0 else ((unit * _SYSTEMATIC_SHARE) >> 20) << (t - 1)
        sums = _sums(stars, added)
        for m in range(1 if plain else 3):
            _add_model(average, sums, priors, t, m)
    return average.result()


class _Sums(NamedTuple):
    """Weighted sums over the stars, with weights relative to the best star's."""

    normal: list[list[Real]]
    right: list[Real]
    total: Real
    log_weights: Real
    """log₂ of the product of the weights."""
    best: Real
    """Variance of the best star, with the systematic part, square pixels."""
    systematic: Real
    stars: int


def _sums(stars: Stars, added: int) -> _Sums:
    count = len(stars.variance)
    best = int(stars.variance.min()) + added
    shift = 0
    while best >> shift >= _LONGEST:
        shift += 1
    c = (stars.variance + added) >> shift
    weight = (((best >> shift) << _WEIGHT_BITS) + (c >> 1)) // c
    weight = np.maximum(weight, 1)
    normal = np.einsum("n,nai,naj->ij", weight, stars.columns, stars.columns)
    right = np.einsum("n,nai,na->i", weight, stars.columns, stars.residual)
    total = int((weight * ((stars.residual**2).sum(axis=1) >> 8)).sum())
    log_weights, product = ZERO, ONE
    for n, w in enumerate(weight.tolist()):
        product = product * Real(w, -_WEIGHT_BITS)
        if n % 4 == 3 or n == count - 1:
            log_weights, product = log_weights + log2(product), ONE
    scale = -_WEIGHT_BITS - 2 * COLUMN_BITS
    return _Sums(
        [[Real(int(value), scale) for value in row] for row in normal],
        [Real(int(value), -_WEIGHT_BITS - COLUMN_BITS - RESIDUAL_BITS) for value in right],
        Real(total, 8 - _WEIGHT_BITS - 2 * RESIDUAL_BITS),
        log_weights,
        Real(best, -VARIANCE_BITS),
        Real(added, -VARIANCE_BITS),
        count,
    )


def _add_model(average: _Average, sums: _Sums, priors: FitPriors, t: int, m: int) -> None:
    """Add one model to the average."""
    size = _SIZES[m]
    normal = [row[:size] for row in sums.normal[:size]]
    for k in range(3, size):
        normal[k][k] = normal[k][k] + sums.best * Real(int(priors.information[m, k - 3]), -PRIOR_BITS)
    pivots = factorised(normal)
    if pivots is None:
        return
    mean = solved(normal, sums.right[:size])
    chi2 = sums.total
    for k in range(size):
        chi2 = chi2 - mean[k] * sums.right[k]
    chi2 = chi2 / sums.best
    chi2 = max(chi2, _LEAST_CHI2)
    power = round(TRUSTED) + 2 * sums.stars - 3
    spread = Real(round(TRUSTED)) + chi2
    log_data = Real(2 * sums.stars - size) * log2(sums.best) - sums.log_weights.scaled(1) + pivots
    log_data = log_data + Real(power) * log2(spread)
    prior = Real(int(priors.model[m] + priors.systematic[t]), -PRIOR_BITS)
    average.add(prior - log_data.scaled(-1), normal, mean, spread / Real(power - 2), sums)


class _Average:
    """Moments of the models, with weights relative to the largest one so far.

    The mean and the sum of the squares about it are updated by each model (West 1979, Communications of the ACM 22,
    532), so that there is no difference of large numbers.
    """

    def __init__(self) -> None:
        self.highest: Real | None = None
        self.weight = self.factor = self.systematic = self.shear2 = ZERO
        self.mean = [ZERO] * UNKNOWNS
        self.square = [[ZERO] * 3 for _ in range(3)]

    def add(self, log_weight: Real, normal: list[list[Real]], mean: list[Real], scale: Real, sums: _Sums) -> None:
        """Add a model of a weight, its factorised normal matrix, its mean and the factor of its variances."""
        share = ONE
        if self.highest is None:
            self.highest = log_weight
        else:
            apart = log_weight - self.highest
            if apart.integer(PRIOR_BITS) < -_NEGLIGIBLE:
                return
            if apart > ZERO:
                self._fade(apart)
                self.highest = log_weight
            else:
                share = power_of_2(apart)
        before, self.weight = self.weight, self.weight + share
        part = share / self.weight
        away = [(mean[k] if k < len(mean) else ZERO) - self.mean[k] for k in range(UNKNOWNS)]
        self.mean = [value + part * change for value, change in zip(self.mean, away, strict=True)]
        part = before * part
        scaled = share * scale
        spread = scaled * sums.best
        for i in range(3):
            column = solved(normal, [ONE if k == i else ZERO for k in range(len(mean))])
            for j in range(3):
                self.square[i][j] = self.square[i][j] + (spread * column[j] + part * (away[i] * away[j]))
        self.factor = self.factor + scaled
        self.systematic = self.systematic + scaled * sums.systematic
        if len(mean) == UNKNOWNS:
            self.shear2 = self.shear2 + share * (mean[5] * mean[5])

    def _fade(self, apart: Real) -> None:
        """Reduce everything to the weight of a model that is 2^`apart` times as probable."""
        by = ZERO if apart.integer(PRIOR_BITS) > _NEGLIGIBLE else power_of_2(-apart)
        self.weight, self.factor = self.weight * by, self.factor * by
        self.systematic, self.shear2 = self.systematic * by, self.shear2 * by
        self.square = [[value * by for value in row] for row in self.square]

    def result(self) -> Fit | None:
        """The fit; None without a model."""
        if self.highest is None:
            return None
        share = ONE / self.weight
        covariance = [[self.square[i][j] * share for j in range(3)] for i in range(3)]
        # a shear is also half a rotation, which residuals do not show
        covariance[2][2] = covariance[2][2] + self.shear2 * share
        return Fit(self.mean, covariance, self.factor * share, self.systematic * share)


def median(values: list[int]) -> int:
    """Median, of an even number the mean of the middle two, rounded down."""
    ordered = sorted(values)
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) >> 1
