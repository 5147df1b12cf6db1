"""Calibration of focal length, principal point and distortion: from photographs of the sky, and in flight."""

from __future__ import annotations

from startracker.calibration.field import IdentifiedStars, StarField
from startracker.calibration.in_flight import InFlightCalibration
from startracker.calibration.lens_filter import LensFilter, LensUpdate
from startracker.calibration.procedure import calibrate
from startracker.calibration.psf_width import WidthFilter
from startracker.calibration.result import CalibratedField, Calibration
from startracker.settings import InFlightSettings

__all__ = [
    "CalibratedField",
    "Calibration",
    "IdentifiedStars",
    "InFlightCalibration",
    "InFlightSettings",
    "LensFilter",
    "LensUpdate",
    "StarField",
    "WidthFilter",
    "calibrate",
]


def __dir__() -> list[str]:
    return sorted(__all__)
