"""Checks of what is given to a filter, so that a wrong value is refused before it changes anything.

A filter keeps what it was given in its state: one value that is not finite, or a covariance that is not one, would
spoil all later estimates.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from startracker.arguments import of_kind, real_array, real_number
from startracker.core import FloatArray
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


def checked_rate(values: ArrayLike, what: str) -> FloatArray:
    """A rate (3,) in rad/s.

    Raises
    ------
    InputError
        If it is not three finite real numbers, or faster than `FASTEST_RAD_S`.
    """
    rate = real_array(what, values, (3,), unit="rad/s")
    if float(np.abs(rate).max()) > FASTEST_RAD_S:
        raise InputError(f"{what} must be below {FASTEST_RAD_S:g} rad/s; got {rate.tolist()}")
    return rate.copy()


def checked_covariance(values: ArrayLike) -> FloatArray:
    """The covariance (3, 3) of an attitude's error, rad², exactly symmetric.

    Raises
    ------
    InputError
        If it is not 3×3, real, finite, symmetric and positive definite.
    """
    p = real_array("an attitude's covariance", values, (3, 3))
    largest = float(np.abs(p).max())
    if not float(np.abs(p - p.T).max()) <= _SYMMETRIC * largest:
        raise InputError(f"an attitude's covariance must be symmetric; got {p.tolist()}")
    p = 0.5 * (p + p.T)
    if largest > _LARGEST_VARIANCE or not float(np.linalg.eigvalsh(p)[0]) >= _LEAST_VARIANCE:
        raise InputError(f"an attitude's covariance must be positive definite, in rad²; got {p.tolist()}")
    return p


def checked_attitude(given: Any, source: str, target: str) -> Attitude:
    """An attitude between two frames.

    Raises
    ------
    InputError
        For another object, or other frames.
    """
    attitude: Attitude = of_kind("attitude", given, Attitude)
    if (attitude.source, attitude.target) != (source, target):
        raise InputError(f"attitude must be from {source} to {target}; got {attitude.source} → {attitude.target}")
    return attitude


def checked_time(t_s: Any, what: str) -> float:
    """A time in seconds.

    Raises
    ------
    InputError
        If it is not a finite number, or beyond `LATEST_S`.
    """
    return real_number(what, t_s, least=-LATEST_S, most=LATEST_S)
