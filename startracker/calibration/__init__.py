"""Calibration of focal length, principal point and distortion from photographs of the sky."""

from __future__ import annotations

from startracker.calibration.field import StarField
from startracker.calibration.procedure import calibrate
from startracker.calibration.result import CalibratedField, Calibration

__all__ = ["CalibratedField", "Calibration", "StarField", "calibrate"]


def __dir__() -> list[str]:
    return sorted(__all__)
