"""Tracking: attitudes over time, from one frame to the next."""

from __future__ import annotations

from startracker.settings import TrackingSettings
from startracker.tracking.calibrated import CalibratedSession
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise
from startracker.tracking.session import TrackingSession
from startracker.tracking.state import TrackingState

__all__ = [
    "CalibratedSession",
    "GyroNoise",
    "Innovation",
    "Mekf",
    "RateNoise",
    "TrackingSession",
    "TrackingSettings",
    "TrackingState",
]


def __dir__() -> list[str]:
    return sorted(__all__)
