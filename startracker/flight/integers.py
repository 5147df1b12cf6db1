"""Integers of a flight build: the functions of `c/tracker_integers.h`, for arrays of vectors of 2.30."""

from __future__ import annotations

import math

import numpy as np

from startracker.arrays import IntArray
from startracker.fixed_point.vectors import quotient

_ONE = 1 << 30


def rooted(n: IntArray) -> IntArray:
    """⌊√n⌋ of integers from 0 to below 2⁶³."""
    flat = np.asarray(n, dtype=np.int64)
    root = np.sqrt(flat.astype(float)).astype(np.int64)
    root -= root * root > flat
    return np.asarray(root + ((root + 1) * (root + 1) <= flat))


def shifted(value: int, power: int) -> int:
    """value × 2^power, rounded down."""
    return value << power if power >= 0 else value >> -power


def cross(a: IntArray, b: IntArray) -> IntArray:
    """Vector products (…, 3) of 2.30, rounded down."""
    i, j = [1, 2, 0], [2, 0, 1]
    return np.asarray((a[..., i] * b[..., j] - a[..., j] * b[..., i]) >> 30)


def normalized(v: IntArray, least: int) -> IntArray | None:
    """Unit vector (3,) of 2.30 of components below 2³⁶; None if all are below `least`."""
    largest = int(np.abs(v).max())
    if largest < least:
        return None
    while largest >= _ONE:
        v, largest = v >> 1, largest >> 1
    length = math.isqrt(int(v @ v))
    return np.array([quotient(int(c) * _ONE, length) for c in v], dtype=np.int64)
