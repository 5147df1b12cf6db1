"""Bayes factor of an attitude: how much more likely the observed stars are under it than if they were at random.

Null hypothesis: each of the n observed stars is anywhere on the image, with the density 1/A. Hypothesis: the camera has
some attitude, uniform over SO(3). Each star is a distractor with probability d, of density 1/A, and otherwise one of
the K brightest guide stars of the field, with a Gaussian of width σ about its position and a magnitude near the guide
star's. σ, d, K and the scatter of the magnitudes are unknown, and averaged over a grid. The integral over the attitudes
near the given one is Laplace's, (2π)^(3/2) |N|^(−1/2) / (8π²) with N the normal matrix: the price of searching all
attitudes.

As an average of likelihood ratios, B has mean one under the null hypothesis, so that B ≥ t occurs by chance with
probability 1/t at most (Markov), whatever number of attitudes is tried. The actual probability is far lower: it is the
mean of 1/B over those skies under the hypothesis that have B ≥ t, and therefore at most p/t, where p is the largest
density of ln B over skies with n stars. One star more or less changes ln B by about ten, and any number of the n may be
true stars, which spreads ln B the more, the larger n is (`largest_density`).

Sources: Lang, Hogg, Mierle, Blanton & Roweis 2010, AJ 139, 1782, section 2.3 (the mixture); MacKay 2003, Information
Theory, Inference, and Learning Algorithms, ch. 27 (Laplace's method); the bound on chance is ours.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, IntArray
from startracker.geometry.linalg import log_determinant
from startracker.sorting import median, order_of

SCALES = np.array([0.4, 0.7, 1.25, 2.2, 4.0, 7.0, 12.5, 22.0])
"""Widths over which B is averaged, in units of the stated errors."""
SEEN = ((0.5, 0.1), (0.65, 0.15), (0.8, 0.25), (0.9, 0.3), (0.97, 0.2))
"""Probabilities that a guide star is observed, and their weights."""
DISTRACTORS = ((0.3, 0.2), (1.0, 0.2), (3.0, 0.2), (8.0, 0.15), (20.0, 0.1), (60.0, 0.1), (150.0, 0.05))
"""Mean numbers of distractors, and their weights."""
SCALE_LOG_PRIOR = np.log(np.array([0.1, 0.15, 0.2, 0.2, 0.15, 0.1, 0.06, 0.04]))
SCATTERS_MAG = np.array([0.12, 0.35])
"""Scatters of the magnitudes over which B is averaged: a calibrated instrument, and any other."""
_WIDE_MAG, _WIDE_SHARE, _FLOOR = 1.5, 0.2, 1e-3
WEIGHINGS = len(SCALES) + 3 * len(SCATTERS_MAG)
"""Number of times that `log_bayes_factor` loops over all depths and matches, for counting operations."""
_SAMPLE = 24
_USUAL_STARS = 250
_ROUNDING = 1e-6
"""Larger than the rounding errors of ln B."""
_LOST = -37.0
"""e^−37 is less than half the last digit of a number from 1 on, so that adding it changes nothing."""
_LOG_SPHERE_OF_ROTATIONS = math.log(8.0 * math.pi**2)
_ROOT_TWO_PI = math.sqrt(2.0 * math.pi)


def largest_density(n: int) -> float:
    """Bound on the density of ln B, per nat, over skies under the hypothesis that show `n` stars.

    0.2/n, at least 0.012: 1.5 times the density of skies drawn from the hypothesis
    (tests/statistical/test_false_alarms).
    """
    return max(0.2 / max(n, 3), 0.012)


@kernel
def log_magnitude_ratios(magnitude: FloatArray, matched: IntArray, field_v: FloatArray) -> FloatArray:
    """ln of the ratio (scatters, N) of the density of each magnitude for its guide star to that for the field.

    The density has a core of the given scatter and wide wings (colour, variability, saturation, blends). The zero point
    is the median over the matched stars; to account for this fitted parameter, the largest gain is subtracted. Zero for
    fewer than three stars.

    Parameters
    ----------
    magnitude : (N,)
        Observed magnitudes with the instrument's own zero point; NaN if unknown.
    matched : (N,)
        Index in `field_v` of each star's guide star, or −1.
    field_v : (K,)
        V magnitudes of the guide stars of the field.
    """
    out = np.zeros((len(SCATTERS_MAG), len(magnitude)))
    seen, difference, sorted_, count = (
        np.empty(len(matched), np.int64),
        np.empty(len(matched)),
        np.empty(len(matched)),
        0,
    )
    for star in range(len(matched)):
        if matched[star] >= 0:
            seen[count] = star
            difference[count] = sorted_[count] = magnitude[star] - field_v[matched[star]]
            count += 1
    if count < 3:
        return out
    seen = seen[:count]
    zero = median(sorted_[:count])
    if not math.isfinite(zero):
        return out
    # A sample of the field's magnitudes is sufficient for their density.
    stride = max(1, len(field_v) // _SAMPLE)
    by_chance, most = np.empty(len(SCATTERS_MAG)), np.zeros(len(SCATTERS_MAG))
    for k in range(len(seen)):
        by_chance[:] = 0.0
        count = 0
        for g in range(0, len(field_v), stride):
            d = magnitude[seen[k]] - zero - field_v[g]
            wide = _wide(d)
            for s in range(len(SCATTERS_MAG)):
                by_chance[s] += _core(d, SCATTERS_MAG[s]) + wide
            count += 1
        d = difference[k] - zero
        wide = _wide(d)
        for s in range(len(SCATTERS_MAG)):
            likely = _core(d, SCATTERS_MAG[s]) + wide
            out[s, seen[k]] = math.log((likely + _FLOOR) / (by_chance[s] / count + _FLOOR))
            most[s] = max(most[s], out[s, seen[k]])
    for s in range(len(SCATTERS_MAG)):
        out[s, seen[0]] -= most[s]
    return out


@kernel_part
def _core(difference: float, width: float) -> float:
    """Density of a magnitude difference in the core of the given scatter, without the share of the wings."""
    square = 0.5 * (difference / width) ** 2
    if square > 40.0:  # e^−40 is lost beside `_FLOOR`
        return 0.0
    return (1.0 - _WIDE_SHARE) / (width * _ROOT_TWO_PI) * math.exp(-square)


@kernel_part
def _wide(difference: float) -> float:
    """Density of a magnitude difference in the wings."""
    return _WIDE_SHARE / (_WIDE_MAG * _ROOT_TWO_PI) * math.exp(-0.5 * (difference / _WIDE_MAG) ** 2)


class CountTable(NamedTuple):
    """Probabilities of the numbers of stars, for n observed ones.

    Parameters
    ----------
    log_weight : (depths + 1, n + 1)
        ln of the probability that M given guide stars of the D within the depth are observed, as M given ones of the n,
        and that the others are distractors; −inf if M > D. Row D, column M.
    log_total : (depths + 1,)
        ln of the probability of n stars, summed over all depths up to each.
    """

    log_weight: FloatArray
    log_total: FloatArray


def count_table(n: int, depths: int) -> CountTable:
    """Table for `n` observed stars and up to `depths` guide stars of the field; cached.

    Each guide star within the depth D is observed with probability p, in addition to distractors with a Poisson
    distribution of mean λ; p and λ are averaged over `SEEN` and `DISTRACTORS`. An ordered list of n stars with M given
    matches has the weight e^(−λ) λ^(n−M) p^M (1 − p)^(D−M) / n!; its averages over p and λ are independent factors.
    """
    return (_usual_table if n <= _USUAL_STARS else _large_table)(n, depths)


def _count_table(n: int, depths: int) -> CountTable:
    m, d = np.arange(n + 1)[:, None], np.arange(depths + 1)[None, :]
    log_factorial = gammaln(np.arange(max(n, depths) + 1) + 1.0)
    among, unseen = m <= d, np.maximum(d - m, 0)
    distracting, seeing = np.full((n + 1, 1), -np.inf), np.full((n + 1, depths + 1), -np.inf)
    for distractors, weight in DISTRACTORS:
        term = math.log(weight) - distractors + (n - m) * math.log(distractors)
        distracting = np.logaddexp(distracting, term)
    for p, weight in SEEN:
        seeing = np.logaddexp(seeing, math.log(weight) + m * math.log(p) + unseen * math.log1p(-p))
    log_weight = np.where(among, distracting + seeing - log_factorial[n], -np.inf)
    ways = log_factorial[n] - log_factorial[n - m]  # ordered choices of M of the n observed stars
    choose = np.where(among, log_factorial[d] - log_factorial[m] - log_factorial[unseen], -np.inf)
    each = np.logaddexp.reduce(log_weight + choose + ways, axis=0)
    log_total = np.logaddexp.accumulate(np.where(d[0] > 0, each, -np.inf))
    return CountTable(np.ascontiguousarray(log_weight.T), log_total)


_usual_table = lru_cache(maxsize=128)(_count_table)
_large_table = lru_cache(maxsize=4)(_count_table)  # megabytes each


@kernel
def log_assignments(gain: FloatArray, rank: IntArray, in_field: int, counts: CountTable) -> float:
    """ln of the likelihood ratio of the matches, averaged over the depth of the image and the stars that are missing.

    For each depth, the best number of matches with guide stars within it is used; other selections would only add to B.

    Parameters
    ----------
    gain : (m,)
        ln of A times the density of each matched star's position and magnitude, in descending order.
    rank : (m,)
        Rank of its guide star in the field by brightness, from 0.
    in_field : int
        Number of guide stars of the field, K.
    counts : CountTable
    """
    highest, total = -math.inf, 0.0
    cumulative, matches = np.zeros(len(gain) + 1), 0  # sums of the largest gains within the depth
    for depth in range(1, in_field + 1):
        within = 0
        for k in range(len(gain)):
            within += rank[k] < depth
        if within > matches:
            matches, last = 0, 0.0
            for k in range(len(gain)):  # no branches: which of them are within cannot be predicted
                added, is_within = last + gain[k], rank[k] < depth
                cumulative[matches + 1] = added
                last = added if is_within else last
                matches += is_within
        log_weight = counts.log_weight[depth]
        value = log_weight[0]
        for m in range(1, matches + 1):
            value = max(value, cumulative[m] + log_weight[m])
        # log-sum-exp over the depths; terms below the last digit are skipped.
        if value > highest:
            total = total * math.exp(highest - value) + 1.0 if total > 0.0 else 1.0
            highest = value
        elif value > highest + _LOST:
            total += math.exp(value - highest)
    average: float = highest + math.log(total) - counts.log_total[in_field]
    return average


class Matched(NamedTuple):
    """Observed stars matched with guide stars.

    Parameters
    ----------
    distance : (N,)
        Distance from each observed star to its guide star, rad; inf if it has none.
    rank : (N,)
        Rank of that guide star in the field by brightness; arbitrary if there is none.
    sigma : (N,)
        Stated standard error on one axis, rad.
    log_ratio : (scatters, N)
        Result of `log_magnitude_ratios`.
    """

    distance: FloatArray
    rank: IntArray
    sigma: FloatArray
    log_ratio: FloatArray


@kernel_part
def _log_volume(information: FloatArray, scale: float, focal_sigma: float) -> float:
    """ln of the share of all attitudes (and focal lengths) that fit, for errors of `scale` times the stated ones."""
    unknowns = information.shape[0]
    normal = np.empty((unknowns, unknowns))
    for i in range(unknowns):
        for j in range(unknowns):
            normal[i, j] = information[i, j] / scale**2
    # The focal length has a Gaussian prior, which regularises the normal matrix and is divided out of the volume.
    if unknowns == 4:
        normal[3, 3] += 1.0 / focal_sigma**2
    volume = 0.5 * unknowns * math.log(2.0 * math.pi) - 0.5 * log_determinant(normal) - _LOG_SPHERE_OF_ROTATIONS
    if unknowns == 4:
        volume -= math.log(focal_sigma * _ROOT_TWO_PI)
    return float(volume)


@kernel_part
def _most_gained(matched: Matched, seen: IntArray, scale: float, other: float) -> float:
    """Upper bound on the increase of `_log_matches` without magnitudes, from errors of `scale` to `other` times σ.

    It is the sum over the stars whose density increases.
    """
    total, wider = 0.0, 2.0 * math.log(other / scale)
    for star in seen:
        square = 0.5 * (matched.distance[star] / matched.sigma[star]) ** 2
        total += max(square / scale**2 - square / other**2 - wider, 0.0)
    return total


@kernel
def _log_matches(
    matched: Matched, seen: IntArray, area: float, scale: float, scatter: int, in_field: int, counts: CountTable
) -> float:
    """`log_assignments` for errors of `scale` times the stated ones; `scatter` indexes that of the magnitudes, −1 for
    none."""
    gain, order = np.empty(len(seen)), np.empty(len(seen), np.int64)
    largest_first, ranks = np.empty(len(seen)), np.empty(len(seen), np.int64)
    spread, log_density = 0.0, 0.0
    for k in range(len(seen)):
        star = seen[k]
        if scale * matched.sigma[star] != spread:  # mostly that of the star before
            spread = scale * matched.sigma[star]
            log_density = math.log(area / (2.0 * math.pi * spread**2))
        gain[k] = 0.5 * (matched.distance[star] / spread) ** 2 - log_density
        if scatter >= 0:
            gain[k] -= matched.log_ratio[scatter, star]
    order_of(gain, order)
    for k in range(len(seen)):
        largest_first[k], ranks[k] = -gain[order[k]], matched.rank[seen[order[k]]]
    value: float = log_assignments(largest_first, ranks, in_field, counts)
    return value


@kernel
def log_bayes_factor(
    matched: Matched, information: FloatArray, in_field: int, area: float, focal_sigma: float, counts: CountTable
) -> tuple[float, float]:
    """ln B of an attitude, and the multiple of the stated errors that fits best.

    Parameters
    ----------
    matched : Matched
    information : (3, 3) or (4, 4)
        Normal matrix of attitude (and focal length) for the stated errors.
    in_field : int
        Number of guide stars of the field, K.
    area : float
        Solid angle of the image, sr.
    focal_sigma : float
        Prior standard deviation of ln of the focal length, if that is fitted too.
    counts : CountTable
        Table for N stars, and for at least as many guide stars as the field has.
    """
    seen, count = np.empty(len(matched.distance), np.int64), 0
    for star in range(len(matched.distance)):
        seen[count] = star
        count += matched.distance[star] < np.inf
    seen = seen[:count]
    if count < 3 or in_field < 1:
        return -math.inf, 1.0
    # The width that fits best is determined without magnitudes.
    volumes, best, highest = np.empty(len(SCALES)), 0, -math.inf
    for s in range(len(SCALES)):
        volumes[s] = _log_volume(information, SCALES[s], focal_sigma) + SCALE_LOG_PRIOR[s]
        # The sum of the largest gains of each match is an upper bound, which excludes most of the larger widths.
        gain = volumes[s] - volumes[best] + _most_gained(matched, seen, SCALES[best], SCALES[s])
        if s > 0 and gain < -_ROUNDING:
            continue
        value = volumes[s] + _log_matches(matched, seen, area, SCALES[s], np.int64(-1), in_field, counts)
        if value > highest:
            best, highest = s, value
    # Only the best width and its neighbours are summed; the others would only make B slightly larger.
    highest, total = -math.inf, 0.0
    for s in range(max(best - 1, 0), min(best + 2, len(SCALES))):
        for scatter in range(len(SCATTERS_MAG)):
            value = volumes[s] + _log_matches(matched, seen, area, SCALES[s], scatter, in_field, counts)
            if value > highest:
                total = total * math.exp(highest - value) + 1.0 if total > 0.0 else 1.0
                highest = value
            else:
                total += math.exp(value - highest)
    if not highest > -math.inf:
        return -math.inf, SCALES[best]
    return highest + math.log(total / len(SCATTERS_MAG)), SCALES[best]
