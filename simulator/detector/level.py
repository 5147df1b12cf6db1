"""Numbers of pixels that hold the background alone, each drawn at once from the distribution of what is read.

Under an even sky most pixels have the same mean, the level. Where every effect treats all pixels alike and a converter
ends their row, what such a pixel reads has one distribution for all of them,

    P(≤ v) = Σₙ p(n) Φ((v + ½ − s(n))/σ),

with n counted electrons, p(n) of Poisson's distribution, s(n) what becomes of them on the way to the converter and σ
the normal noise there; one word a pixel draws from it, where the steps take two words and two quantiles.

The number is the least v with P(≤ v) > u for u = (w + f)/2³². A guide (Chen & Asau 1974) sorts the words w of 32 bits
by their first `_GUIDE_BITS` into buckets: one that has no edge P(≤ v) 2³² within it, or one, is settled by a comparison
in whole numbers. Where several edges share a bucket, in the tails, or w itself holds an edge, 53 further bits f of the
pixel decide in double precision, on either side of the middle by the probability of the tail. What is left out of the
sum is less likely than the least u, so that the numbers are exact to the rounding of a double.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.detector.exposure import clip, collect
from simulator.detector.few import BLOCK, outside
from simulator.detector.normal import WORD, tail_words
from simulator.detector.philox import Key, Words, further_bits
from simulator.detector.poisson import LARGEST_MEAN, probability
from simulator.detector.readout import amplify, bend, convert
from simulator.detector.steps import (
    AMPLIFY,
    BEND,
    CLIP,
    CONVERT,
    NORMAL_NOISE,
    SHOT_NOISE,
    Collection,
    Step,
)

FloatArray = NDArray[np.float64]
Guide = NDArray[np.uint64]
Numbers = NDArray[np.int32]

_GUIDE_BITS = 11
_SHIFT, _HALF = np.uint32(32 - _GUIDE_BITS), np.int64(32)
_SEVERAL, _LAST, _MIDDLE = np.uint64(2**63), np.uint32(2**32 - 1), np.uint32(2**31)
_OPEN, _ZERO, _MOST = np.int32(-1), np.int32(0), np.int32(2**31 - 1)
_UNLIKELY = 60.0
"""Numbers beyond bounds that are passed with less than exp(−60) = 0.7 × 2⁻⁸⁶ are left out; 2⁻⁸⁶ is the least u."""
_SIGMAS = 10.7
"""1 − Φ(10.7) is less than that too."""
_PIXELS_A_TERM = 12
"""A term of the sum takes as long as the table saves on so many pixels."""
_MOST_OPEN = 2**_GUIDE_BITS // 64
"""With more open buckets than these the pixels that they leave to further bits are no longer few."""


class LevelTable(NamedTuple):
    """Distribution of the number that a pixel of the level reads.

    Parameters
    ----------
    lowest : int
        Least number.
    below, above : (M,) float64
        P(≤ lowest + i) and P(> lowest + i) for all but the highest number.
    guide : (2^`_GUIDE_BITS`,) uint64
        Of each bucket: in the higher half the number at its start, or 2³¹ where several edges lie within it; in the
        lower what carries into the higher when a word is added that has passed the edge.
    """

    lowest: int
    below: FloatArray
    above: FloatArray
    guide: Guide


def level_table(level: float, how: Collection, steps: Sequence[Step], pixels: int) -> LevelTable | None:
    """Distribution of the numbers that a row of steps makes of a level, None where there is none or it does not
    pay: a map, no chance or no converter; a level so bright that its sum takes longer than drawing all pixels.

    Parameters
    ----------
    level : float
        Signal before the row.
    how, steps : Collection, sequence of Step
        How the row begins, and what is left of it.
    pixels : int
        Of the image.
    """
    if how.responses.size or how.darks_e.size or all(step.rng is None for step in steps):
        return None
    mean = np.empty(1)
    if not (collect(mean, np.array([float(level)]), how, 0) and math.isfinite(mean[0])):
        return None
    row = tuple((step.kernel, step.values) for step in steps)
    return _tabulated(float(mean[0]), row, pixels // _PIXELS_A_TERM)


@functools.lru_cache(maxsize=4)
def _tabulated(mean_e: float, steps: tuple[tuple[int, tuple[float, ...]], ...], most_terms: int) -> LevelTable | None:
    """A mean becomes counts with their shares, and these, with a normal distribution about each, numbers."""
    signal, share, sigma = np.array([mean_e]), np.ones(1), 0.0
    for kernel, values in steps[:-1]:
        if kernel == AMPLIFY:
            amplify(signal, *values)
            sigma /= values[0]
        elif kernel == NORMAL_NOISE:
            sigma = math.hypot(sigma, *values)
        elif sigma > 0.0:
            return None
        elif kernel == SHOT_NOISE:
            mean = float(signal[0])
            if len(signal) > 1 or not 0.0 <= mean <= LARGEST_MEAN or 8.0 * _UNLIKELY * mean > most_terms**2:
                return None
            signal, share = _poisson(mean)
        elif kernel == CLIP:
            clip(signal, *values)
        elif kernel == BEND:
            bend(signal, *values)
        else:
            return None
    if steps[-1][0] != CONVERT:
        return None
    ends = np.array([signal.min() - _SIGMAS * sigma, signal.max() + _SIGMAS * sigma])
    convert(ends, *steps[-1][1])
    lowest, edges = int(ends[0]), int(ends[1] - ends[0])
    if len(signal) * min(edges, 2.0 * _SIGMAS * sigma + 1.0) > most_terms:
        return None
    below, above = np.zeros(edges), np.zeros(edges)
    if sigma > 0.0:
        _add_blurred(signal, share, sigma, lowest + 0.5, below, above)
    else:
        convert(signal, *steps[-1][1])
        _add_sharp(signal, share, lowest, below, above)
    guide, several = _guide(lowest, below, above)
    return LevelTable(lowest, below, above, guide) if several <= _MOST_OPEN else None


def _poisson(mean: float) -> tuple[FloatArray, FloatArray]:
    """Counts and their probabilities, all but those beyond the bounds of Chernoff:
    P(N ≥ λ + t) ≤ exp(−t²/(2λ + 2t/3)), P(N ≤ λ − t) ≤ exp(−t²/2λ)."""
    high = mean + _UNLIKELY / 3.0 + math.sqrt(_UNLIKELY**2 / 9.0 + 2.0 * _UNLIKELY * mean)
    low = max(mean - math.sqrt(2.0 * _UNLIKELY * mean), 0.0)
    count = np.arange(math.floor(low), math.ceil(high) + 1, dtype=np.float64)
    return count, _probabilities(count, mean)


@numba.njit(cache=True, error_model="numpy")
def _probabilities(count: FloatArray, mean: float) -> FloatArray:
    out = np.empty(count.size)
    for i in range(count.size):
        out[i] = probability(count[i], mean) if mean > 0.0 else np.float64(count[i] == 0.0)
    return out


@numba.njit(cache=True, error_model="numpy")
def _add_blurred(
    signal: FloatArray, share: FloatArray, sigma: float, first: float, below: FloatArray, above: FloatArray
) -> None:
    """Add the shares below and above the edges first, first + 1, … of normal distributions about each signal."""
    for k in range(signal.size):
        for i in range(below.size):
            z = (first + i - signal[k]) / sigma
            tail = 0.5 * math.erfc(abs(z) * math.sqrt(0.5)) if abs(z) < _SIGMAS else 0.0
            below[i] += share[k] * (tail if z < 0.0 else 1.0 - tail)
            above[i] += share[k] * (1.0 - tail if z < 0.0 else tail)


@numba.njit(cache=True, error_model="numpy")
def _add_sharp(number: FloatArray, share: FloatArray, lowest: int, below: FloatArray, above: FloatArray) -> None:
    """Add the shares of numbers up to and beyond each of lowest, lowest + 1, …"""
    for k in range(number.size):
        for i in range(below.size):
            if number[k] <= lowest + i:
                below[i] += share[k]
            else:
                above[i] += share[k]


def _guide(lowest: int, below: FloatArray, above: FloatArray) -> tuple[Guide, int]:
    """Guide, and how many of its buckets several edges share."""
    last = float(_LAST)
    edge = np.minimum(np.floor(np.where(below < 0.5, below, 1.0 - above) / WORD), last).astype(np.int64)
    start = np.arange(2**_GUIDE_BITS + 1, dtype=np.int64) << int(_SHIFT)
    passed = np.searchsorted(edge, start)  # edges before the start of each bucket, and of the one after
    within, passed = np.diff(passed), passed[:-1]
    carries = np.where(within == 1, int(_LAST) - np.append(edge, 0)[passed], 0).astype(np.uint64)
    guide = ((passed + lowest).astype(np.uint64) << np.uint64(_HALF)) + carries
    guide[within > 1] = _SEVERAL
    return guide, int((within > 1).sum())


@numba.njit(cache=True, error_model="numpy")
def draw_level(table: LevelTable, key: Key, first: int, words: Words, number: Numbers) -> None:
    """Numbers (N,) of the pixels first, first + 1, … of the level, from their words (N,) and further bits."""
    guide = table.guide
    for i in range(number.size):
        total = guide[words[i] >> _SHIFT] + np.uint64(words[i])
        number[i] = np.int32(np.int64(total) >> _HALF) if np.uint32(total) != _LAST else _OPEN
    for start in range(0, number.size, BLOCK):
        if outside(number[start : start + BLOCK], _ZERO, _MOST) > 0:
            for i in range(start, min(start + BLOCK, number.size)):
                if number[i] < 0:
                    number[i] = level_number(table, words[i], further_bits(key, first + i))


@numba.njit(cache=True, error_model="numpy")
def level_number(table: LevelTable, word: np.uint32, fraction: float) -> int:
    """Least v with P(≤ v) > u, u = (word + fraction)/2³², by the distribution function itself."""
    lower = word < _MIDDLE
    tail = (tail_words(word) + (fraction if lower else 1.0 - fraction)) * WORD
    low, high = 0, table.below.size
    while low < high:
        middle = (low + high) // 2
        if (table.below[middle] > tail) if lower else (table.above[middle] < tail):
            high = middle
        else:
            low = middle + 1
    return table.lowest + low
