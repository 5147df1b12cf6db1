"""Columns of an attitude and its error in ``sequence.parquet``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.statistics import CAMERA_AXES
from startracker.attitude import Attitude

__all__ = ["attitude_columns", "camera_error_deg"]

FloatArray = NDArray[np.float64]


def camera_error_deg(row: dict[str, Any]) -> FloatArray:
    """Error about the camera's axes (3,), degrees, of a row."""
    return np.array([row[f"error_{axis}_deg"] for axis in CAMERA_AXES])


def attitude_columns(prefix: str, attitude: Attitude | None) -> dict[str, float]:
    """Right ascension, declination, roll and quaternion of an attitude; NaN without one."""
    values = [math.nan] * 7
    if attitude is not None:
        values = [attitude.ra_deg, attitude.dec_deg, attitude.roll_deg, *(float(v) for v in attitude.quat)]
    return dict(
        zip((f"{prefix}{n}" for n in ("ra_deg", "dec_deg", "roll_deg", "qx", "qy", "qz", "qw")), values, strict=True)
    )
