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

from simulator.detector.philox import Words, draw_key, fill_words, to_unit
from startracker.errors import InputError

FloatArray = NDArray[np.float64]

TABLE_LIMIT = 128
"""Means from here on are NumPy's to draw."""
STEPS = 16
"""Tables for each unit of the mean."""
SUPPORT = 256
"""Numbers 0 to 255 in each table: a mean of 128 exceeds 255 once in 10²² draws."""
LARGEST_MEAN = 1e18
"""Largest mean that can be counted in 64 bits with its noise."""

_BLOCK = 4096  # pixels at a time: their random words stay in the cache
_COLUMN_SHIFT, _BYTE, _BYTE_BITS = np.uint64(56), np.uint64(255), np.uint64(8)
_FRACTION_SHIFT = np.uint64(11)


def draw_poisson(mean: NDArray[np.float64], rng: np.random.Generator, *, in_place: bool = False) -> NDArray[np.float64]:
    """Poisson numbers of given means.

    Every pixel takes 128 random bits by its number, whatever its mean; the bright ones are drawn afterwards. So a star
    changes no other pixel's noise.

    Parameters
    ----------
    mean : (...) float64
        Means, 0 to `LARGEST_MEAN`.
    rng : numpy.random.Generator
        The stream.
    in_place : bool
        Put the numbers into `mean` itself, which then must be C-contiguous float64.

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
    if flat.size == 0:
        return flat.reshape(np.shape(mean))
    lowest, highest = flat.min(), flat.max()  # NaN passes through both
    if not (lowest >= 0.0 and highest <= LARGEST_MEAN):
        raise InputError(
            f"mean electrons run from {lowest:.6g} to {highest:.6g} a pixel; they must lie in 0 to {LARGEST_MEAN:g}"
        )
    if in_place and not np.shares_memory(flat, mean):
        raise ValueError("draw_poisson works in place on C-contiguous float64 arrays only")
    out = flat if in_place else np.empty_like(flat)
    bright = np.flatnonzero(flat >= TABLE_LIMIT) if highest >= TABLE_LIMIT else None
    key = draw_key(rng)
    bright_numbers = None if bright is None else rng.poisson(flat[bright])
    _poisson_image(flat, key, alias_tables(), out)
    if bright is not None:
        out[bright] = bright_numbers
    return out.reshape(np.shape(mean))


@numba.njit(cache=True, error_model="numpy")
def _poisson_image(mean: FloatArray, key: Words, table: Words, out: FloatArray) -> None:
    a = np.empty(_BLOCK, dtype=np.uint64)
    b = np.empty(_BLOCK, dtype=np.uint64)
    for start in range(0, mean.size, _BLOCK):
        stop = min(start + _BLOCK, mean.size)
        fill_words(key, np.uint64(start), np.uint64(0), a[: stop - start], b[: stop - start])
        poisson_from_words(mean[start:stop], a, b, table, out[start:stop])


@numba.njit(cache=True, error_model="numpy")
def poisson_from_words(mean: FloatArray, first: Words, second: Words, table: Words, out: FloatArray) -> None:
    """Poisson numbers of the means below `TABLE_LIMIT` from two random words each; other elements are left alone.

    Parameters
    ----------
    mean : (N,) float64
        Means, not negative.
    first, second : (≥ N,) uint64
        Random words. Of the first, 8 bits choose the column of the table and 53 whether it is kept; 53 of the second
        are the uniform number that the rest inverts.
    table : (TABLE_LIMIT × STEPS, SUPPORT) uint64
        From `alias_tables`.
    out : (N,) float64
        Takes the numbers; may be `mean`.
    """
    for i in range(mean.size):
        if not mean[i] < TABLE_LIMIT:
            continue
        row = int(mean[i] * STEPS)
        column = first[i] >> _COLUMN_SHIFT
        entry = table[row, column]
        kept = ((first[i] << _BYTE_BITS) >> _FRACTION_SHIFT) < (entry >> _BYTE_BITS)
        count = int(column if kept else entry & _BYTE)

        rest = mean[i] - row / STEPS
        v = to_unit(second[i])
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
def alias_tables() -> Words:
    """Alias tables of the Poisson distributions with mean 0, 1/STEPS, 2/STEPS, … below `TABLE_LIMIT`.

    Returns
    -------
    (TABLE_LIMIT × STEPS, SUPPORT) uint64
        For column k of a row: its probability of staying k, in units of 2⁻⁵³, above the lowest byte; there, what it
        becomes otherwise. In one word, so that a draw fetches one.
    """
    rate = np.arange(TABLE_LIMIT * STEPS)[:, None] / STEPS
    number = np.arange(SUPPORT)
    probability = np.exp(xlogy(number, rate) - rate - gammaln(number + 1.0))
    probability /= probability.sum(axis=1, keepdims=True)
    keep = np.ones(probability.shape)
    alias = np.zeros(probability.shape, dtype=np.uint8)
    _fill_alias_tables(probability, keep, alias)
    table: Words = (np.rint(keep * 2.0**53).astype(np.uint64) << _BYTE_BITS) | alias
    table.setflags(write=False)
    return table


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
