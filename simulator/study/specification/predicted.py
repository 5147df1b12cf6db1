"""Predicted covariances as evidence on a specification: percentiles of a mixture of normal distributions.

The error at each attitude is normal with its own covariance; over many attitudes of equal weight the errors are a
mixture, whose tails are longer than those of a normal distribution with the same rms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import erf

from simulator.study.axes import BODY_AXES, CAMERA_AXES
from simulator.study.specification.measured import RATE_BAND, untested_rate
from simulator.study.specification.requirements import AVAILABILITY, Requirement, Specification
from simulator.study.specification.verdicts import Estimate
from startracker.core import FloatArray

_ANGLES = 64
"""Directions of the average over the ellipse of each attitude; the trapezium rule of a periodic function converges
exponentially (16 give 1e-6 for an axis ratio of 2)."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """Covariances of a camera at many attitudes as evidence."""

    covariance_rad2: FloatArray
    """(m, 3, 3): Of the attitude error in camera axes, at the attitudes with enough stars."""
    to_body: FloatArray
    """(3, 3): Camera axes → body axes."""
    attitudes: int
    """All attitudes that count."""
    specification: Specification
    """Its rate is compared with that of the prediction."""
    rate_deg_s: float
    """Angular rate of the prediction."""

    basis = "predicted"
    unit = "attitudes"
    wrong = misidentified = gross = 0

    @property
    def untested(self) -> tuple[str, ...]:
        """The specified rate, if the prediction has another."""
        rate = self.specification.rate_deg_s
        if self.attitudes == 0:
            return ("every attitude is excluded",)
        if rate is None or RATE_BAND[0] * rate <= self.rate_deg_s <= RATE_BAND[1] * rate:
            return ()
        return (untested_rate(rate, self.rate_deg_s, self.rate_deg_s),)

    def estimate(self, requirement: Requirement) -> Estimate:
        """Predicted value; no interval, as the attitudes cover sky or path evenly."""
        enough = len(self.covariance_rad2)
        if self.attitudes == 0:
            return Estimate(None, None, None, 0, "every attitude is excluded")
        if requirement.name == AVAILABILITY:
            share = enough / self.attitudes
            return Estimate(share, share, share, self.attitudes)
        if not requirement.axis:
            return Estimate(None, None, None, 0, "not predicted")
        if enough == 0:
            return Estimate(None, None, None, 0)
        assert requirement.percent is not None
        value = self.percentile_deg(requirement.axis, requirement.percent)
        return Estimate(value, value, value, enough)

    def percentile_deg(self, axis: str, percent: float) -> float:
        """Percentile of the magnitude of the error about an axis, degrees."""
        if axis == "across":
            return math.degrees(across_percentile(self.covariance_rad2[:, :2, :2], percent))
        return math.degrees(axis_percentile(self._variance(axis), percent))

    def rms_deg(self, axis: str) -> float:
        """Root mean square of the error about an axis, degrees."""
        if axis == "across":
            return math.hypot(self.rms_deg("cross_x"), self.rms_deg("cross_y"))
        return math.degrees(math.sqrt(float(self._variance(axis).mean())))

    def _variance(self, axis: str) -> FloatArray:
        if axis in CAMERA_AXES:
            k = CAMERA_AXES.index(axis)
            return np.asarray(self.covariance_rad2[:, k, k])
        row = self.to_body[BODY_AXES.index(axis)]
        return np.asarray(np.einsum("i,nij,j->n", row, self.covariance_rad2, row))


def axis_percentile(variance: FloatArray, percent: float) -> float:
    """Percentile of |e| of an equal mixture of normal distributions about zero: mean erf(q / √(2 σᵢ²)) = p.

    Parameters
    ----------
    variance : (m,) array
        σᵢ², positive.
    percent : float
        Percentile, 0 to 100.
    """
    scale = 1.0 / np.sqrt(2.0 * variance)
    return _solved(lambda q: float(np.mean(erf(q * scale))), percent, float(np.sqrt(variance.max())))


def across_percentile(covariance: FloatArray, percent: float) -> float:
    """Percentile of the length of a two-dimensional normal error, over an equal mixture of covariances.

    With e = (a ρ cos θ, b ρ sin θ), a² and b² the eigenvalues, θ uniform and ρ² of the χ² distribution of two degrees
    of freedom, P(|e| ≤ q) is the mean over θ of 1 − exp(−q² / 2 (a² cos² θ + b² sin² θ)).

    Parameters
    ----------
    covariance : (m, 2, 2) array
        Positive definite.
    percent : float
        Percentile, 0 to 100.
    """
    low, high = np.linalg.eigvalsh(covariance).T
    theta = math.pi / 2 * (np.arange(_ANGLES) + 0.5) / _ANGLES
    along = high[:, None] * np.cos(theta) ** 2 + low[:, None] * np.sin(theta) ** 2
    return _solved(lambda q: float(np.mean(-np.expm1(-q * q / (2.0 * along)))), percent, math.sqrt(float(high.max())))


def _solved(share_within: Callable[[float], float], percent: float, largest_sigma: float) -> float:
    """The q with this percentage within; `largest_sigma` bounds it, since no part of the mixture is wider."""
    share = percent / 100.0
    top = largest_sigma * math.sqrt(-2.0 * math.log1p(-share)) + largest_sigma
    return float(brentq(lambda q: share_within(q) - share, 0.0, top, xtol=1e-9 * largest_sigma, rtol=1e-9))
