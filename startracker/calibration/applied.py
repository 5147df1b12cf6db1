"""The part of an estimated change of the lens that is applied to the camera.

An estimate of the lens with the standard deviation σ displaces the attitudes by its error, even if the lens has not
changed at all. The principal point does so most of all, because its shift is nearly a rotation of the camera. Each
parameter is therefore assumed either unchanged since the ground, or changed with its prior standard deviation; and
because changes have a common cause, a further one is more probable than the first. With the estimate p̂, its covariance
C and the prior variances Σ, the probability that the parameters R are unchanged and the others S changed is

    w(S) ∝ ρ(S) √(|Σ_RR| / |C_RR|) exp(−½ p̂_Rᵀ C_RR⁻¹ p̂_R)

with the prior odds ρ (ratio of posterior to prior density at p_R = 0; Dickey 1971, Ann. Math. Stat. 42, 204). The
estimate is then p̂_S − C_SR C_RR⁻¹ p̂_R. The applied change is the mean over all S. It has the smallest expected
squared error of the attitude, tr(G E[(p − p_applied)(p − p_applied)ᵀ] Gᵀ), whatever the derivative G of the attitude.
It is nearly zero until a change is three to four times its standard deviation, and the estimate itself beyond.
"""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.lens_fit import subsets

_FIRST, _FURTHER = 0.01, 0.1
"""Prior odds of the first change, and of each further one. The threshold depends on their logarithm: with 0.05 in place
of 0.01 it is lower by half a standard deviation."""


def applied_change(
    names: tuple[str, ...], change: FloatArray, covariance: FloatArray, prior_variance: FloatArray
) -> FloatArray:
    """The change (P,) that is applied.

    Parameters
    ----------
    names : tuple of str
        Parameters, of `startracker.geometry.lens.PARAMETERS`.
    change : array, shape (P,)
        Estimated change since the ground.
    covariance : array, shape (P, P)
        Its covariance, including the prior.
    prior_variance : array, shape (P,)
        Variance of each change in the absence of stars.
    """
    # In units of the prior standard deviations Σ is the unit matrix, and its determinant drops out of w(S).
    scale = np.sqrt(prior_variance)
    change, covariance = change / scale, covariance / np.outer(scale, scale)
    logs, means = [], []
    for kept in subsets(names, tuple((name,) for name in names if name[0] != "k")):
        changed = np.array([name in kept for name in names])
        mean, log_weight = np.where(changed, change, 0.0), _log_odds(len(kept))
        if not changed.all():
            fixed = covariance[np.ix_(~changed, ~changed)]
            # Conditional mean of the changed parameters, given that the others are zero.
            away = np.linalg.solve(fixed, change[~changed])
            mean[changed] -= covariance[np.ix_(changed, ~changed)] @ away
            log_weight -= 0.5 * (np.linalg.slogdet(fixed)[1] + change[~changed] @ away)
        logs.append(log_weight)
        means.append(mean)
    weight = np.exp(np.array(logs) - max(logs))
    return np.asarray(scale * (weight / weight.sum() @ np.array(means)))


def _log_odds(changes: int) -> float:
    """Logarithm of the prior odds of a number of changed parameters."""
    return math.log(_FIRST) + (changes - 1) * math.log(_FURTHER) if changes else 0.0
