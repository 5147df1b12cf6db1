"""Evidence of an attitude in integers: the Bayes factor of `startracker.identification.bayes_factor`, never too large.

log₂ B has 12 fraction bits. Every star has its own stated variance; the widths, magnitudes, missing and false stars are
averaged over as in floating point, and the crowding of the observed stars (`clustering_null`) lowers the evidence. Each
table, logarithm and sum is rounded to the side on which B is smaller.

The C (`c/tracker_evidence.c`) performs the same operations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.core import IntArray
from startracker.fixed_point.evidence import LOG_BITS, NEVER
from startracker.flight.search_tables import (
    COUNT_BITS,
    CROWD_BITS,
    CROWD_FROM,
    CROWD_STEP_BITS,
    DENSITY_BITS,
    EVEN_SHARE_LOG,
    FLOOR,
    SPREAD_SHARE_LOG,
    SearchTables,
)
from startracker.flight.stars import StarList

LOG_UP = 24
"""Largest error of `log_down`: 4096 log₂(1 + 1/256), rounded up."""
CROWD_WIDTHS = 8
"""Of the crowding, each half of the one before."""
STATED_VARIANCE, FLOOR_VARIANCE, WORST_VARIANCE = 1475, 656, 25 << 16
"""Squares of 0.15, 0.1 and 5 pixels, 16 fraction bits: of centroids without a stated error; added to the stated ones;
beyond which a centroid is not used (`startracker.tracker`, `startracker.identification.observed`)."""
LOG_TWO_PI = 10861
"""log₂ 2π, rounded up."""
LARGEST_VARIANCE = 1 << 46
"""Of a direction on one axis, 2⁻⁶⁰ rad²: the square of half a degree."""
_SUM_STEP, _EXTENT_SHIFT = 6, 4
_MAGNITUDE_FACTOR, _MAGNITUDE_SHIFT = 24660, 21
"""2.5 log₁₀ 2, in units of 2⁻⁶ magnitudes per 2⁻¹² of log₂ of the flux."""
_SAMPLE = 24
_FLOOR_DOWN, _FLOOR_UP = int(FLOOR * (1 << DENSITY_BITS)), int(FLOOR * (1 << DENSITY_BITS)) + 1
_ONE = 1 << LOG_BITS


class Sight(NamedTuple):
    """The observed stars that are used, brightest first, at most 60.

    Parameters
    ----------
    listed : (N,)
        Number of each in the list.
    direction : (N, 3)
        Camera axes, 2.30.
    variance : (N,)
        Of the direction on one axis, 2⁻⁶⁰ rad².
    magnitude : (N,)
        −2.5 log₁₀ of the flux, 6 fraction bits.
    brightness : bool
        Whether the fluxes of all are known.
    excess : (9, N)
        log₂ of the crowding at each star, by width; the last row is that of the mean over the widths.
    """

    listed: IntArray
    direction: IntArray
    variance: IntArray
    magnitude: IntArray
    brightness: bool
    excess: IntArray

    def __len__(self) -> int:
        return len(self.listed)


def sight(stars: StarList, direction: IntArray, seen: NDArray[np.bool_], t: SearchTables) -> Sight:
    """Stars with a direction and a usable error.

    Parameters
    ----------
    stars : StarList
    direction : (N, 3)
        Unit vectors of 2.30, camera axes.
    seen : bool (N,)
        Stars that have a direction.
    t : SearchTables
    """
    stated = stars.variance >> 10
    usable = np.flatnonzero(seen & (stated < WORST_VARIANCE))
    stated = np.where(stars.variance == 0, STATED_VARIANCE, stated + FLOOR_VARIANCE)[usable]
    flux = stars.flux[usable]
    brightness = bool(len(flux)) and bool((flux > 0).all())
    magnitude = np.zeros(len(usable), np.int64)
    if brightness:
        magnitude = -((log_down(flux, t) * _MAGNITUDE_FACTOR) >> _MAGNITUDE_SHIFT)
    vectors = direction[usable]
    variance = np.minimum((stated * (t.pixel2 >> 4)) >> 12, LARGEST_VARIANCE)
    return Sight(usable, vectors, variance, magnitude, brightness, crowding(vectors, t))


def log_down(n: ArrayLike, t: SearchTables) -> IntArray:
    """log₂ of n ≥ 1, rounded down."""
    n = np.asarray(n, dtype=np.int64)
    large = n >= 1 << 40  # beyond 2⁵³ a double is not exact
    bits = np.frexp(np.where(large, n >> 10, n).astype(float))[1] - 1 + np.where(large, 10, 0)
    top = np.where(bits >= 8, n >> np.maximum(bits - 8, 0), n << np.maximum(8 - bits, 0))
    return np.asarray((bits << LOG_BITS) + t.log_table[top - 256])


def log_sum(a: ArrayLike, b: ArrayLike, t: SearchTables) -> IntArray:
    """log₂(2ᵃ + 2ᵇ), rounded down."""
    high = np.maximum(a, b)
    k = (high - np.minimum(a, b)) >> _SUM_STEP
    return np.asarray(high + np.where(k < len(t.sum_table), t.sum_table[np.minimum(k, len(t.sum_table) - 1)], 0))


def log_sum_up(a: ArrayLike, b: ArrayLike, t: SearchTables) -> IntArray:
    """log₂(2ᵃ + 2ᵇ), rounded up."""
    high, last = np.maximum(a, b), len(t.sum_table) - 1
    k = (high - np.minimum(a, b)) >> _SUM_STEP
    return np.asarray(high + np.where(k == 0, _ONE, t.sum_table[np.clip(k - 1, 0, last)] + 1))


def crowding(points: IntArray, t: SearchTables) -> IntArray:
    """log₂ (9, N) of the density of the other stars at each, times the area: `log_excess_density`, rounded up."""
    n = len(points)
    none = np.zeros((CROWD_WIDTHS + 1, n), np.int64)
    if n < 2:
        return none
    mean = points.sum(axis=0) // n
    extent2 = int((((points - mean) >> _EXTENT_SHIFT) ** 2).sum()) // n
    if extent2 < 1:
        return none
    apart = points[:, None] - points[None]
    d2 = np.maximum((apart * apart).sum(axis=-1), 1)
    log_extent = int(log_down(extent2, t)) + 2 * _EXTENT_SHIFT * _ONE
    x = log_down(d2, t) - log_extent - LOG_UP  # 1/(1 + x)² is the larger the smaller x
    widths = np.arange(CROWD_WIDTHS)
    entry = (x + (2 * widths[:, None, None] - CROWD_FROM) * _ONE) >> CROWD_STEP_BITS
    value = np.where(entry < 0, 1 << CROWD_BITS, t.crowd_table[np.clip(entry, 0, len(t.crowd_table) - 1)])
    value[:, np.arange(n), np.arange(n)] = 0
    sums = value.sum(axis=2)
    scale = SPREAD_SHARE_LOG + t.log_area_up - CROWD_BITS * _ONE - int(log_down(np.array(n - 1), t)) - log_extent
    rows = [log_down(sums[w], t) + LOG_UP + 2 * w * _ONE + scale for w in range(CROWD_WIDTHS)]
    total = (sums << (2 * widths[:, None])).sum(axis=0)
    rows.append(log_down(total, t) + LOG_UP - 3 * _ONE + scale)
    return np.asarray(log_sum_up(np.array(rows), np.array(EVEN_SHARE_LOG), t))


class Match(NamedTuple):
    """Matched stars of an attitude.

    Parameters
    ----------
    star, rank : (M,)
        Stars, ascending, and the ranks of their guide stars in the field.
    square : (M,)
        Squared residuals in units of the stated variance, 8 fraction bits.
    log_normal : int
        log₂ of the determinant of the normal matrix, 2⁻¹⁸⁰ rad⁶, rounded up.
    """

    star: IntArray
    rank: IntArray
    square: IntArray
    log_normal: int


def magnitude_ratios(seen: Sight, match: Match, field_magnitude: IntArray, t: SearchTables) -> IntArray:
    """log₂ (2, M) of how much better each magnitude fits its guide star than any of the field, rounded down."""
    m, depth = len(match.star), len(field_magnitude)
    scatters = len(t.density_table)
    if not seen.brightness or m < 3:
        return np.zeros((scatters, m), np.int64)
    magnitude = seen.magnitude[match.star]
    difference = magnitude - field_magnitude[match.rank]
    ordered = np.sort(difference)
    zero = (int(ordered[(m - 1) // 2]) + int(ordered[m // 2])) >> 1
    sample = field_magnitude[:: max(1, depth // _SAMPLE)]
    entries = t.density_table.shape[1]
    far = np.abs(magnitude[:, None] - zero - sample[None])
    anyhow = np.where(far < entries, t.density_table[:, np.minimum(far, entries - 1)], 0) + 1
    anyhow = anyhow.sum(axis=2) // len(sample) + 1 + _FLOOR_UP
    near = np.abs(difference - zero)
    likely = np.where(near < entries, t.density_table[:, np.minimum(near, entries - 1)], 0) + _FLOOR_DOWN
    out = log_down(likely, t) - log_down(anyhow, t) - LOG_UP
    out[:, 0] -= np.maximum(out.max(axis=1), 0)
    return out


def weigh(seen: Sight, match: Match, field_magnitude: IntArray, t: SearchTables) -> tuple[int, int]:
    """log₂ of the Bayes factor of a match, rounded down, and the width that fits best.

    Parameters
    ----------
    seen : Sight
    match : Match
        At least three stars.
    field_magnitude : (K,)
        V of the guide stars of the field, brightest first.
    t : SearchTables
    """
    depth, ratios = len(field_magnitude), magnitude_ratios(seen, match, field_magnitude, t)
    half = (match.log_normal + 180 * _ONE + 1) >> 1
    volume = t.log_volume - half
    base = t.log_area - LOG_TWO_PI - log_down(seen.variance[match.star], t) - LOG_UP
    plain = base[None] - t.log_scale2[:, None] - ((match.square[None] * t.quadratic[:, None]) >> 16) - 1
    alone = volume + _assignments(plain, match.rank, len(seen), depth, t)
    best = int(np.argmax(alone))
    near = range(max(best - 1, 0), min(best + 2, len(plain)))
    rows = np.concatenate([plain[s] + ratios for s in near])
    values = _assignments(rows, match.rank, len(seen), depth, t).reshape(-1, len(ratios))
    everything = np.array(NEVER)
    for value in (values + volume[list(near)][:, None]).ravel():
        everything = log_sum(everything, value, t)
    price = int(np.maximum(seen.excess[:, match.star].sum(axis=1).max(), 0))
    return int(everything) - _ONE - price, best


def _assignments(gain: IntArray, rank: IntArray, n: int, depth: int, t: SearchTables) -> IntArray:
    """log₂ (R,) of the likelihood ratios of rows of gains (R, M), averaged over depths and missing stars."""
    order = np.argsort(-gain, axis=1, kind="stable")
    ordered, ranks = np.take_along_axis(gain, order, axis=1), rank[order]
    depths = np.arange(1, depth + 1)
    within = ranks[:, None, :] < depths[None, :, None]
    m = np.cumsum(within, axis=2)
    cumulative = np.cumsum(ordered[:, None, :] * within, axis=2)
    up = LOG_BITS - COUNT_BITS
    weight = (t.distracting[n - m] << up) + (t.seeing[m, depths[None, :, None] - m] << up)
    value = np.where(within, cumulative + weight, NEVER).max(axis=2)
    none = (int(t.distracting[n]) << up) + (t.seeing[0, depths] << up)
    value = np.maximum(value, none)
    out = np.full(len(gain), NEVER, np.int64)
    for k in range(depth):
        out = log_sum(out, value[:, k], t)
    return out - (int(t.total[n, depth]) << up)
