"""Attitude of a body from several star trackers and a gyro.

Takes attitudes of single frames with their covariances, and rotations of a gyro, in any order; gives attitude, gyro
errors and the alignments of the heads.
"""

from __future__ import annotations

from startracker.fusion.alignments import AlignedMekf, Head
from startracker.fusion.filter import FusionFilter, Measurement, Update

__all__ = ["AlignedMekf", "FusionFilter", "Head", "Measurement", "Update"]


def __dir__() -> list[str]:
    return sorted(__all__)
