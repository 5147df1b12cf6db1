"""Result of an attitude estimator, and checks of its input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.estimation.rotations import normalised

_DISTINCT_RAD = 1e-9
"""Minimum angle (0.2 mas) from the axis of the first direction; closer ones do not determine the rotation about it in
double precision."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Attitude estimate."""

    matrix: FloatArray
    """Proper rotation, ``observed = matrix @ reference``, (3, 3)."""
    covariance: FloatArray
    """Covariance of the rotation vector of the error, rad², in the axes of the observed vectors, (3, 3)."""

    __repr__ = fields_repr


def check_directions(
    observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors (M, 3), unit vectors (M, 3) and standard deviations (M,) that determine an attitude.

    Raises
    ------
    InputError
        For inconsistent shapes, values that are not finite, a vector of length zero, a standard deviation that is not
        positive, or fewer than two distinct directions (a direction and its opposite are one axis).
    """
    b = np.ascontiguousarray(observed, dtype=np.float64)
    r = np.ascontiguousarray(reference, dtype=np.float64)
    if b.ndim != 2 or b.shape[1] != 3 or b.shape != r.shape:
        raise InputError(f"observed and reference directions must both be (M, 3); got {b.shape} and {r.shape}")
    sigma = np.ascontiguousarray(sigma_rad, dtype=np.float64)
    if np.ndim(sigma_rad) == 0:
        sigma = np.full(len(b), sigma.item())
    if sigma.shape != (len(b),):
        raise InputError(f"{len(b)} directions need as many standard deviations; got the shape {sigma.shape}")
    if len(sigma) and not 0.0 < sigma.min() <= sigma.max() < np.inf:
        raise InputError("standard deviations of directions must be positive and finite")
    return _unit("observed", b), _unit("reference", r), sigma


def _unit(name: str, vectors: FloatArray) -> FloatArray:
    largest = np.abs(vectors).max(axis=1, keepdims=True, initial=0.0)
    if not ((largest > 0.0) & np.isfinite(largest)).all():
        raise InputError(f"{name} directions must be finite and not zero")
    if len(vectors) < 2:
        raise InputError(f"an attitude needs two {name} directions; got {len(vectors)}")
    unit = normalised(vectors / largest)
    if np.linalg.norm(np.cross(unit[0], unit), axis=1).max() < _DISTINCT_RAD:
        raise InputError(f"an attitude needs two distinct {name} directions; the {len(unit)} given lie along one axis")
    return unit
