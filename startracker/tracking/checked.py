"""Checks of what is given to a filter, so that a wrong value is refused before it changes anything.

A filter keeps what it was given in its state: one value that is not finite, or a covariance that is not one, would
spoil all later estimates.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from startracker.arrays import FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

FASTEST_RAD_S = 1e3
"""Largest rate of a body, rad/s: 160 turns per second, far beyond the range of a gyro."""
LATEST_S = 1e11
"""Largest time, s (3,000 years), above which a double does not resolve 10 µs."""
_LARGEST_VARIANCE = 1e6
"""Largest variance, rad²: an attitude of which nothing is known has 10."""
_LEAST_VARIANCE = 1e-28
"""Least variance, rad²: a quaternion resolves 1e-16."""
_SYMMETRIC = 1e-6
"""Largest relative difference between opposite elements; the rounding of single precision is 1e-7."""


def real_array(values: ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    """A copy of an array of real numbers, which must have a shape.

    Raises
    ------
    InputError
        For another shape, or elements that are not finite real numbers; `what` says what they must be.
    """
    try:
        given = np.asarray(values)
        array = np.array(given, dtype=float) if given.dtype.kind in "iuf" else None
    except (TypeError, ValueError, OverflowError):
        array = None
    if array is None or array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{what}; got {_short(values)}")
    return array


def checked_rate(values: ArrayLike, what: str) -> FloatArray:
    """A rate (3,) in rad/s.

    Raises
    ------
    InputError
        If it is not three finite real numbers, or faster than `FASTEST_RAD_S`.
    """
    rate = real_array(values, (3,), f"{what} must be three finite numbers in rad/s")
    if float(np.abs(rate).max()) > FASTEST_RAD_S:
        raise InputError(f"{what} must be below {FASTEST_RAD_S:g} rad/s; got {_short(values)}")
    return rate


def checked_covariance(values: ArrayLike) -> FloatArray:
    """The covariance (3, 3) of an attitude's error, rad², exactly symmetric.

    Raises
    ------
    InputError
        If it is not 3×3, real, finite, symmetric and positive definite.
    """
    what = "an attitude's covariance must be 3×3, finite and positive definite, in rad²"
    p = real_array(values, (3, 3), what)
    largest = float(np.abs(p).max())
    if not float(np.abs(p - p.T).max()) <= _SYMMETRIC * largest:
        raise InputError(f"an attitude's covariance must be symmetric; got {_short(values)}")
    p = 0.5 * (p + p.T)
    if largest > _LARGEST_VARIANCE or not float(np.linalg.eigvalsh(p)[0]) >= _LEAST_VARIANCE:
        raise InputError(f"{what}; got {_short(values)}")
    return p


def checked_attitude(attitude: Any, source: str, target: str) -> Attitude:
    """An attitude between two frames.

    Raises
    ------
    InputError
        For another object, or other frames.
    """
    if not isinstance(attitude, Attitude):
        raise InputError(f"an attitude must be an Attitude from {source} to {target}; got {_short(attitude)}")
    if (attitude.source, attitude.target) != (source, target):
        raise InputError(
            f"an attitude must be from {source} to {target}; this one is from {attitude.source} to {attitude.target}"
        )
    return attitude


def checked_time(t_s: Any, what: str) -> float:
    """A time in seconds.

    Raises
    ------
    InputError
        If it is not a finite number, or beyond `LATEST_S`.
    """
    number = finite_number(t_s, what)
    if not abs(number) <= LATEST_S:
        raise InputError(f"{what} must be within ±{LATEST_S:g} s; got {t_s!r}")
    return number


def finite_number(value: Any, what: str) -> float:
    """A finite real number as a float.

    Raises
    ------
    InputError
        For anything else, text and truth values included.
    """
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not real and isinstance(value, np.ndarray) and value.shape == () and value.dtype.kind in "iuf":
        real = True
    try:
        number = float(value) if real else math.nan
    except OverflowError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{what} must be a finite number; got {_short(value)}")
    return number


def _short(value: Any) -> str:
    """One line of limited length about a value."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}…"
