"""Columns of the errors of an attitude, as in ``sequence.parquet``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from simulator.study.axes import AXES
from simulator.study.specification.requirements import Specification
from simulator.study.statistics import beyond_specification
from simulator.study.trials.causes import NO_OUTCOME_COLUMNS
from simulator.study.trials.trial import attitude_columns, attitude_errors_deg, mounting_columns
from startracker.core import FloatArray
from startracker.geometry.attitude import Attitude

NO_FRAME = "no_frame"
"""Status of a missing frame."""


def error_columns(
    true: Attitude,
    estimate: Attitude | None,
    covariance: FloatArray | None,
    mounting: Attitude,
    rotation_rad: FloatArray | None = None,
) -> dict[str, float]:
    """Errors about body and camera axes with their standard deviations, and the NEES; NaN without an estimate.

    Parameters
    ----------
    true, estimate : Attitude
        ICRS to camera.
    covariance : array, shape (3, 3)
        Of the error of the estimate, camera axes, rad².
    mounting : Attitude
        Body to camera.
    rotation_rad : array, shape (3,), optional
        Thermo-elastic rotation that is contained in `true` and `mounting`.
    """
    errors, sigma, nees = dict.fromkeys(AXES, math.nan), np.full(6, math.nan), math.nan
    if estimate is not None and covariance is not None:
        errors = attitude_errors_deg(true, estimate, mounting, rotation_rad)
        to_body = mounting.inverse.as_matrix()
        sigma = np.degrees(np.sqrt([*np.diag(to_body @ covariance @ to_body.T), *np.diag(covariance)]))
        vector = true.rotation_vector_to(estimate)
        nees = float(vector @ np.linalg.solve(covariance, vector))
    columns = {f"error_{axis}_deg": errors[axis] for axis in AXES}
    columns |= {f"sigma_{axis}_deg": float(value) for axis, value in zip(AXES, sigma, strict=True)}
    return columns | {"nees": nees}


def opening_columns(index: int, elapsed_s: float, t_s: float, utc: str) -> dict[str, Any]:
    """First columns of a row, without an attitude."""
    when = {"index": index, "elapsed_s": elapsed_s, "t_s": t_s, "utc": utc}
    return when | {"mode": "none", "status": "", "reason": "", **NO_OUTCOME_COLUMNS, "beyond_specification": False}


def compared_columns(
    true: Attitude,
    estimate: Attitude | None,
    covariance: FloatArray | None,
    mounting: Attitude,
    rotation_rad: FloatArray | None = None,
) -> dict[str, float]:
    """True and estimated attitude, the rotation of the mounting, and `error_columns`; parameters as there."""
    columns = attitude_columns("true_", true) | attitude_columns("", estimate) | mounting_columns(rotation_rad)
    return columns | error_columns(true, estimate, covariance, mounting, rotation_rad)


def is_beyond(row: Mapping[str, Any], specification: Specification) -> bool:
    """`beyond_specification` of the errors of a row."""
    return beyond_specification(row_errors_deg(row), specification)


def row_errors_deg(row: Mapping[str, Any]) -> dict[str, float]:
    """Errors by axis, degrees, of a row."""
    return {axis: row[f"error_{axis}_deg"] for axis in AXES}


def three_columns(
    name: str, unit: str, true: FloatArray, found: FloatArray | None, sigma: FloatArray | None, factor: float
) -> dict[str, float]:
    """True and estimated values about three axes and their standard deviations, in a unit; NaN for None."""
    columns: dict[str, float] = {}
    for i, axis in enumerate("xyz"):
        for prefix, values in (("true_", true), ("", found), ("sigma_", sigma)):
            columns[f"{prefix}{name}_{axis}_{unit}"] = math.nan if values is None else float(values[i]) * factor
    return columns
