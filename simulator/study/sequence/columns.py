"""Columns of the errors of an attitude, as in ``sequence.parquet``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from simulator.frame import FrameTruth
from simulator.renderer import Renderer
from simulator.study.specification.requirements import Specification
from simulator.study.statistics import AXES, CAMERA_AXES, WRONG_NEES, beyond_specification, is_wrong
from simulator.study.trials.bounds import attitude_bound_deg, matched_sources
from simulator.study.trials.trial import attitude_columns, attitude_errors_deg, explained_deg, mounting_columns
from startracker.arrays import FloatArray
from startracker.geometry.attitude import Attitude
from startracker.solution import Solution

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
    return when | {"mode": "none", "status": "", "reason": "", "wrong": False, "beyond_specification": False}


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
    return beyond_specification({axis: row[f"error_{axis}_deg"] for axis in AXES}, specification)


def camera_error_deg(row: dict[str, Any]) -> FloatArray:
    """Error about the camera's axes (3,), degrees, of a row."""
    return np.array([row[f"error_{axis}_deg"] for axis in CAMERA_AXES])


def is_wrong_attitude(
    renderer: Renderer, truth: FrameTruth, solution: Solution, misidentified: int, nees: float, error_deg: FloatArray
) -> bool:
    """Whether the attitude of a solved frame is wrong (`simulator.study.statistics.is_wrong`), with the noise of this
    frame alone. The bound is computed only for the few attitudes for which it matters."""
    if not solution.solved:
        return False
    bound_deg = np.full(3, math.nan)
    if nees > WRONG_NEES:
        stars = matched_sources(truth, solution.stars.fitted.xy)
        bound_deg = explained_deg(renderer, truth, stars, attitude_bound_deg(renderer, truth, stars))
    return is_wrong(misidentified, nees, error_deg, bound_deg)


def three_columns(
    name: str, unit: str, true: FloatArray, found: FloatArray, sigma: FloatArray, factor: float
) -> dict[str, float]:
    """True and estimated values about three axes and their standard deviations, in a unit."""
    columns: dict[str, float] = {}
    for i, axis in enumerate("xyz"):
        columns[f"true_{name}_{axis}_{unit}"] = float(true[i]) * factor
        columns[f"{name}_{axis}_{unit}"] = float(found[i]) * factor
        columns[f"sigma_{name}_{axis}_{unit}"] = float(sigma[i]) * factor
    return columns
