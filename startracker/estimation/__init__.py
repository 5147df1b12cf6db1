"""Attitude from identified stars: estimators by name in `METHODS`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from startracker.arrays import FloatArray
from startracker.estimation.plate import Plate, plate_constants, solve_plate
from startracker.estimation.result import Estimate
from startracker.estimation.star_pair import pitch_error_deg, star_pair
from startracker.estimation.triad import triad
from startracker.estimation.wahba import davenport, esoq2, quest, wahba_svd

__all__ = [
    "METHODS",
    "OPTIMAL",
    "Estimate",
    "Estimator",
    "Plate",
    "davenport",
    "esoq2",
    "pitch_error_deg",
    "plate_constants",
    "quest",
    "solve_plate",
    "star_pair",
    "triad",
    "wahba_svd",
]

Estimator: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], Estimate]
"""Signature of an estimator: observed (M, 3), reference (M, 3), sigma_rad (M,)."""

METHODS: dict[str, Estimator] = {
    "svd": wahba_svd,
    "davenport": davenport,
    "quest": quest,
    "esoq2": esoq2,
    "triad": triad,
    "star_pair": star_pair,
    "plate_constants": plate_constants,
}
"""Estimators by name; packages add theirs in the entry-point group ``boresight.estimators``.

``svd``, ``davenport``, ``quest`` and ``esoq2`` are optimal and agree; ``triad`` and ``star_pair`` use two stars;
``plate_constants`` leaves the scale free.
"""

OPTIMAL: frozenset[Estimator] = frozenset({wahba_svd, davenport, quest, esoq2})
"""Estimators that minimise the weighted squares: they give the same attitude as the fit of
`startracker.estimation.pose`."""


def __dir__() -> list[str]:
    return sorted(__all__)
