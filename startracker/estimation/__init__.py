"""Attitude from identified stars: estimators by name in `METHODS`."""

from __future__ import annotations

from startracker.estimation.field_fit import Estimator, FieldFit, field_fit
from startracker.estimation.plate import Plate, plate_constants, solve_plate
from startracker.estimation.result import Estimate
from startracker.estimation.two_directions import pitch_error_deg, star_pair, triad
from startracker.estimation.wahba import davenport, esoq2, quest, wahba_svd

__all__ = [
    "METHODS",
    "Estimate",
    "Estimator",
    "FieldFit",
    "Plate",
    "davenport",
    "esoq2",
    "field_fit",
    "pitch_error_deg",
    "plate_constants",
    "quest",
    "solve_plate",
    "star_pair",
    "triad",
    "wahba_svd",
]

METHODS: dict[str, Estimator] = {
    "field_fit": field_fit,
    "svd": wahba_svd,
    "davenport": davenport,
    "quest": quest,
    "esoq2": esoq2,
    "triad": triad,
    "star_pair": star_pair,
    "plate_constants": plate_constants,
}
"""Estimators by name; packages register their own in the entry-point group ``boresight.estimators``.

``field_fit`` is the weighted fit in pixels with which the tracker matches the stars of a field, its default. The others
receive the matched stars as directions, corrected for the deviations of the camera that this fit found, with the
estimated error of each: ``svd``, ``davenport``, ``quest`` and ``esoq2`` solve Wahba's problem and differ by rounding
only; ``triad`` and ``star_pair`` use two stars; ``plate_constants`` leaves the scale free. An estimator with a fourth
parameter, ``field``, receives the fit itself (`FieldFit`).
"""


def __dir__() -> list[str]:
    return sorted(__all__)
