"""Attitude of a body from several star trackers and a gyro.

Takes attitudes of single frames with their covariances, and rotations of a gyro, in any order; gives attitude, gyro
errors and the alignments of the heads.
"""

from __future__ import annotations

from startracker.fusion.alignments import AlignedMekf
from startracker.fusion.filter import FusionFilter
from startracker.fusion.head import Head
from startracker.fusion.state import FusionStatus, HeadStatus, Measurement, Update

__all__ = ["AlignedMekf", "FusionFilter", "FusionStatus", "Head", "HeadStatus", "Measurement", "Update"]


def __dir__() -> list[str]:
    return sorted(__all__)
