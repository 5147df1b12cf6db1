"""How much more likely the observed stars are at a given attitude than anywhere else: a likelihood ratio.

Null hypothesis: each observed star lies anywhere on the image, density 1/A. Hypothesis: with probability d it is a
distractor, density 1/A; otherwise it is one of the K guide stars of the field, each with a Gaussian of width σ around
its predicted place, and with a magnitude near the guide star's. With Λ the product of the ratios over the stars, the
chance under the null that Λ exceeds t is at most 1/t (Markov's inequality, as E[Λ] = 1), so that of H hypotheses
tried one reaches H/ε by chance at most with probability ε. That bound needs no assumption on how Λ is distributed.

Source of the model: Lang, Hogg, Mierle, Blanton & Roweis 2010, AJ 139, 1782, section 2.3; the bound is ours.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DISTRACTORS = (0.1, 0.3, 0.6, 0.9)
"""Shares of observed stars that are no guide stars; the best is taken and the choice paid for."""
_CORE_MAG, _WIDE_MAG, _WIDE_SHARE = 0.3, 1.5, 0.3


def magnitude_density(difference: FloatArray) -> FloatArray:
    """Density (…,) per magnitude of observed minus catalogued.

    A core of 0.3 mag and wide wings (colour, variability, saturation, blends): one discordant star costs little.
    """
    core = np.exp(-0.5 * (difference / _CORE_MAG) ** 2) / (_CORE_MAG * math.sqrt(2.0 * math.pi))
    wide = np.exp(-0.5 * (difference / _WIDE_MAG) ** 2) / (_WIDE_MAG * math.sqrt(2.0 * math.pi))
    return np.asarray((1.0 - _WIDE_SHARE) * core + _WIDE_SHARE * wide + 1e-3)


def magnitude_ratio(magnitude: FloatArray, matched_v: FloatArray, field_v: FloatArray) -> FloatArray:
    """Likelihood ratio (N,) of the observed magnitudes: the matched guide star against any of the field.

    Parameters
    ----------
    magnitude : (N,)
        Observed, on the instrument's own zero point.
    matched_v : (N,)
        V of the matched guide star; NaN where there is none.
    field_v : (K,)
        V of the guide stars of the field.
    """
    ratio = np.ones(len(magnitude))
    matched = np.isfinite(matched_v)
    if matched.sum() < 3:  # one star sets the zero point, and two say too little
        return ratio
    calibrated = magnitude - np.median(magnitude[matched] - matched_v[matched])
    likely = magnitude_density(calibrated[matched] - matched_v[matched])
    anyhow = magnitude_density(calibrated[matched, None] - field_v[None, :]).mean(axis=1)
    ratio[matched] = likely / anyhow
    return ratio


def log_evidence(
    distance: FloatArray,
    sigma: FloatArray,
    area: float,
    guides: int,
    ratio: FloatArray,
    anchors: int = 2,
) -> float:
    """ln Λ of an attitude, without the stars that made it.

    Parameters
    ----------
    distance : (N,)
        From each observed star to its guide star, any unit; inf where it has none.
    sigma : (N,)
        Standard error on one axis, same unit.
    area : float
        Of the image, same unit squared.
    guides : int
        Guide stars of the field, K.
    ratio : (N,)
        Factor from the magnitudes.
    anchors : int
        Stars that determined the attitude; the most telling ones are left out, so that none is counted twice.

    Returns
    -------
    float
        Larger of ln Λ over `DISTRACTORS`, less ln(their number).
    """
    if guides == 0:
        return -math.inf
    gain = ratio * area / (2.0 * math.pi * sigma**2 * guides) * np.exp(-0.5 * (distance / sigma) ** 2)
    best = -math.inf
    for share in DISTRACTORS:
        terms = np.sort(np.log(share + (1.0 - share) * gain))
        best = max(best, float(terms[: len(terms) - anchors].sum()))
    return best - math.log(len(DISTRACTORS))
