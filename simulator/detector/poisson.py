"""Exact Poisson numbers for an image of means, fast where the mean is low, as it is over most of the sky.

A mean below `TABLE_LIMIT` is split into the next lower multiple of 1/`STEPS` and a rest: a Poisson number of the sum is
the sum of two Poisson numbers. The first comes from an alias table of its rate (Walker 1977; Vose 1991) at one look-up,
the second, which is nearly always zero, by inversion. Both are exact to the rounding of a double. Higher means go to
NumPy's generator (PTRS, Hörmann 1993), exact as well. Nowhere is a normal distribution taken for a Poisson one.
"""

from __future__ import annotations

import math
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, xlogy

from startracker.errors import InputError

FloatArray = NDArray[np.float64]

TABLE_LIMIT = 64
"""Means from here on are NumPy's to draw."""
STEPS = 8
"""Tables for each unit of the mean."""
SUPPORT = 256
"""Numbers 0 to 255 in each table: a mean of 64 exceeds 255 once in 10⁶⁹ draws."""
LARGEST_MEAN = 1e18
"""Largest mean that can be counted in 64 bits with its noise."""

_BLOCK = 16384  # pixels at a time: their uniform numbers stay in the cache


def draw_poisson(mean: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Poisson numbers of given means.

    Every pixel takes two uniform numbers of the stream, in order, whatever its mean; the bright ones are drawn
    afterwards. So a star changes no other pixel's noise.

    Parameters
    ----------
    mean : (...) float64
        Means, 0 to `LARGEST_MEAN`.
    rng : numpy.random.Generator
        The stream.

    Returns
    -------
    (...) float64
        Whole numbers.

    Raises
    ------
    InputError
        When a mean is negative, not a number or beyond `LARGEST_MEAN`.
    """
    flat = np.ascontiguousarray(mean, dtype=np.float64).ravel()
    out = np.empty_like(flat)
    if flat.size == 0:
        return out.reshape(np.shape(mean))
    lowest, highest = flat.min(), flat.max()  # NaN passes through both
    if not (lowest >= 0.0 and highest <= LARGEST_MEAN):
        raise InputError(
            f"mean electrons run from {lowest:.6g} to {highest:.6g} a pixel; they must lie in 0 to {LARGEST_MEAN:g}"
        )
    keep, alias = alias_tables()
    uniform = np.empty((min(_BLOCK, flat.size), 2))
    for start in range(0, flat.size, _BLOCK):
        part = slice(start, min(start + _BLOCK, flat.size))
        drawn = uniform[: part.stop - part.start]
        rng.random(out=drawn)
        poisson_from_uniform(flat[part], drawn, keep, alias, out[part])
    if highest >= TABLE_LIMIT:
        bright = np.flatnonzero(flat >= TABLE_LIMIT)
        out[bright] = rng.poisson(flat[bright])
    return out.reshape(np.shape(mean))


@numba.njit(cache=True, error_model="numpy")
def poisson_from_uniform(
    mean: FloatArray, uniform: FloatArray, keep: FloatArray, alias: NDArray[np.uint8], out: FloatArray
) -> None:
    """Poisson numbers of the means below `TABLE_LIMIT` from two uniform numbers each; other elements are left alone.

    Parameters
    ----------
    mean : (N,) float64
        Means, not negative.
    uniform : (N, 2) float64
        Uniform numbers in [0, 1).
    keep, alias : (TABLE_LIMIT × STEPS, SUPPORT) float64, uint8
        From `alias_tables`.
    out : (N,) float64
        Takes the numbers.
    """
    for i in range(mean.size):
        if not mean[i] < TABLE_LIMIT:
            continue
        row = int(mean[i] * STEPS)
        scaled = uniform[i, 0] * SUPPORT
        column = int(scaled)
        count = column if scaled - column < keep[row, column] else int(alias[row, column])

        rest = mean[i] - row / STEPS
        v = uniform[i, 1]
        if v >= 1.0 - rest:  # 1 − r ≤ exp(−r): below it the number is zero, and the exponential is spared
            probability = math.exp(-rest)
            cumulative = probability
            more = 0
            while v >= cumulative and more < 20:  # P(more ≥ 20) < 10⁻³⁶: a guard against rounding near v = 1
                more += 1
                probability *= rest / more
                cumulative += probability
            count += more
        out[i] = count


@cache
def alias_tables() -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Alias tables of the Poisson distributions with mean 0, 1/STEPS, 2/STEPS, … below `TABLE_LIMIT`.

    Returns
    -------
    keep : (TABLE_LIMIT × STEPS, SUPPORT) float64
        Probability that column k of a row stays k.
    alias : the same shape, uint8
        What it becomes otherwise.
    """
    rate = np.arange(TABLE_LIMIT * STEPS)[:, None] / STEPS
    number = np.arange(SUPPORT)
    probability = np.exp(xlogy(number, rate) - rate - gammaln(number + 1.0))
    probability /= probability.sum(axis=1, keepdims=True)
    keep = np.ones(probability.shape)
    alias = np.zeros(probability.shape, dtype=np.uint8)
    _fill_alias_tables(probability, keep, alias)
    keep.setflags(write=False)
    alias.setflags(write=False)
    return keep, alias


@numba.njit(cache=True, error_model="numpy")
def _fill_alias_tables(probability: FloatArray, keep: FloatArray, alias: NDArray[np.uint8]) -> None:
    rows, columns = probability.shape
    small = np.empty(columns, dtype=np.int64)
    large = np.empty(columns, dtype=np.int64)
    for row in range(rows):
        share = probability[row] * columns
        n_small = n_large = 0
        for column in range(columns):
            if share[column] < 1.0:
                small[n_small] = column
                n_small += 1
            else:
                large[n_large] = column
                n_large += 1
        while n_small > 0 and n_large > 0:
            n_small -= 1
            lack, give = small[n_small], large[n_large - 1]
            keep[row, lack] = share[lack]
            alias[row, lack] = give
            share[give] -= 1.0 - share[lack]
            if share[give] < 1.0:
                n_large -= 1
                small[n_small] = give
                n_small += 1
