"""One trial: a frame rendered, solved, and its error measured; one row of ``trials.parquet``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from simulator.frame import Frame, FrameTruth, TrueSources
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.sky.celestial_frames import GALACTIC
from simulator.study.axes import BODY_AXES, CAMERA_AXES
from simulator.study.specification.requirements import specification_of
from simulator.study.statistics import beyond_specification
from simulator.study.trackers import Tracker, tracker_of
from simulator.study.trials.bounds import SAME_STAR_PX, attitude_bound_deg, matched_sources
from simulator.study.trials.causes import NO_OUTCOME_COLUMNS, outcome_columns
from startracker._compiled import clock
from startracker.core import FloatArray
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.solution import Solution

STAGES = ("background", "detection", "centroid", "identification", "attitude")
"""Stages of the tracker with a column of their times; these, ``render_ms`` and ``solve_ms`` are the only columns that
may differ between runs of the same scenario and seed."""

_SAME_STAR_SIGMAS = 5.0
_ERRORS = (*CAMERA_AXES, *BODY_AXES)
_ERROR_COLUMNS = tuple(f"error_{axis}_deg" for axis in _ERRORS)
_SIGMA = tuple(f"sigma_{axis}_deg" for axis in CAMERA_AXES)
_BOUND = tuple(f"bound_{axis}_deg" for axis in CAMERA_AXES)


def solve_frame(tracker: Tracker, frame: Frame) -> Solution:
    """Solve a frame with all data known on board."""
    return tracker.solve(frame)


def attitude_errors_deg(
    truth: Attitude, estimate: Attitude, mounting: Attitude, mounting_rotation_rad: FloatArray | None = None
) -> dict[str, float]:
    """Rotation vector from the true to the estimated attitude of the camera in camera axes, and of the body in body
    axes, degrees.

    The attitude of the body is estimated with the nominal mounting: a rotation of the true `mounting` from it, in
    camera axes, is an error of the body's attitude alone.
    """
    camera = np.degrees(truth.rotation_vector_to(estimate))
    body = camera @ mounting.as_matrix()  # to body axes
    if mounting_rotation_rad is not None:
        turn = Attitude.from_rotation_vector(mounting_rotation_rad, "camera", "camera")
        nominal = turn.inverse @ mounting
        body = np.degrees((turn.inverse @ truth).rotation_vector_to(estimate)) @ nominal.as_matrix()
    return dict(zip(_ERRORS, camera.tolist() + body.tolist(), strict=True))


def attitude_columns(prefix: str, attitude: Attitude | None) -> dict[str, float]:
    """Columns of direction and quaternion of an attitude; NaN for None."""
    values = [math.nan] * 7
    if attitude is not None:
        values = [attitude.ra_deg, attitude.dec_deg, attitude.roll_deg, *attitude.quat.tolist()]
    names = ("ra_deg", "dec_deg", "roll_deg", "qx", "qy", "qz", "qw")
    return dict(zip((f"{prefix}{name}" for name in names), values, strict=True))


def mounting_columns(rotation_rad: FloatArray | None) -> dict[str, float]:
    """Columns of the thermo-elastic rotation of the mounting; none without one."""
    if rotation_rad is None:
        return {}
    return {f"mounting_{axis}_deg": math.degrees(value) for axis, value in zip("xyz", rotation_rad, strict=True)}


def misidentified(truth: FrameTruth, solution: Solution) -> int:
    """Number of matched stars without a true star of the same catalogue number near the centroid.

    Near is within `SAME_STAR_PX`, or within 5 σ of the centroid: along a trail, the error is √2 times the mean of both
    axes that `MatchedStars.sigma_px` states, and pixels long for faint stars. A merged double has the number of its
    brighter star, whose true position is within the camera's resolution.
    """
    sources, stars = truth.sources, solution.stars
    star, source = np.nonzero((stars.catalog_id[:, None] == sources.id) & sources.is_star)
    offset = sources.image_xy[source] - stars.xy[star]
    near_px = np.fmax(SAME_STAR_PX, _SAME_STAR_SIGMAS * math.sqrt(2.0) * stars.sigma_px[star])
    known = star[np.hypot(offset[:, 0], offset[:, 1]) <= near_px]
    return len(stars.xy) - len(set(known.tolist()))


def in_field(camera: Camera, sources: TrueSources, limit: float) -> dict[str, int]:
    """Columns of the numbers of stars down to a magnitude, of bodies and of satellites in the image."""
    inside = camera.contains(sources.xy)
    star, satellite = inside & sources.is_star, inside & (sources.kind == "satellite")
    return {
        "stars_in_field": int((star & (sources.v_mag <= limit)).sum()),
        "bodies_in_field": int(inside.sum() - star.sum() - satellite.sum()),
        "satellites_in_field": int(satellite.sum()),
    }


def normalised_error_squared(error_deg: FloatArray, covariance_rad2: FloatArray | None) -> float:
    """Error squared normalised by the stated covariance, eᵀ P⁻¹ e of the rotation vector (3,): χ² of 3 degrees of
    freedom for a correct covariance (Bar-Shalom, Li & Kirubarajan 2001, section 5.4). NaN without a covariance."""
    if covariance_rad2 is None or not np.isfinite(error_deg).all():
        return math.nan
    error = np.radians(error_deg)
    return float(error @ np.linalg.solve(covariance_rad2, error))


def galactic_latitude_deg(attitude: Attitude) -> float:
    """Galactic latitude of the boresight, degrees."""
    x, y, z = (GALACTIC @ attitude.boresight).tolist()
    return math.degrees(math.atan2(z, math.hypot(x, y)))


class TrialRunner:
    """Renders and solves trials of one scenario; common data is built once."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.renderer = Renderer(scenario)
        self.tracker = tracker_of(scenario, self.renderer)
        self.same_catalog = scenario.sky.catalog == scenario.tracker.catalog
        self.specification = specification_of(scenario)

    def run(self, index: int) -> dict[str, Any]:
        """Row of trial `index`."""
        started = clock()
        frame, truth = self.renderer.frame(index)
        rendered = clock()
        solution = solve_frame(self.tracker, frame)
        solved = clock()
        row = self.row(index, frame, truth, solution)
        row["render_ms"] = (rendered - started) * 1e3
        row["solve_ms"] = (solved - rendered) * 1e3
        for stage in STAGES:
            row[f"{stage}_ms"] = float(solution.times_ms.get(stage, math.nan))
        return row

    def row(self, index: int, frame: Frame, truth: FrameTruth, solution: Solution) -> dict[str, Any]:
        """Row of a frame that was solved, without its times."""
        scenario, sources, true = self.scenario, truth.sources, truth.attitude_at_tag
        block, k = self.renderer.scenes.block(index)
        row: dict[str, Any] = {
            "index": index,
            "t_s": truth.t_s,
            "utc": frame.utc,
            "status": str(solution.status),
            "reason": solution.reason,
            **NO_OUTCOME_COLUMNS,
            "beyond_specification": False,
        }
        row |= attitude_columns("true_", true) | {
            "galactic_latitude_deg": galactic_latitude_deg(true),
            "orbit_argument_deg": float(block.orbit_argument_deg[k]),
            "latitude_deg": float(block.latitude_deg[k]),
            "longitude_deg": float(block.longitude_deg[k]),
            "sunlit": bool(block.sunlit[k]),
            "temperature_c": scenario.detector.temperature_c,
            "particles_cm2_s": truth.particles_cm2_s,
        }
        row |= mounting_columns(truth.mounting_rotation_rad)
        errors = dict.fromkeys(_ERRORS, math.nan)
        sigma = [math.nan] * 3
        if solution.attitude is not None:
            errors = attitude_errors_deg(true, solution.attitude, truth.mounting, truth.mounting_rotation_rad)
            row["beyond_specification"] = beyond_specification(errors, self.specification)
            if solution.covariance is not None:
                sigma = [math.degrees(math.sqrt(variance)) for variance in solution.covariance.diagonal().tolist()]
        row |= attitude_columns("", solution.attitude)
        row |= zip(_ERROR_COLUMNS, errors.values(), strict=True)
        row |= zip(_SIGMA, sigma, strict=True)
        fitted = solution.stars.fitted
        matched = matched_sources(truth, fitted.xy)
        bound_deg = attitude_bound_deg(self.renderer, truth, matched)
        row |= zip(_BOUND, bound_deg.tolist(), strict=True)
        error_deg = np.array([errors[axis] for axis in CAMERA_AXES])
        row["nees"] = normalised_error_squared(error_deg, solution.covariance)
        wrong_stars = misidentified(truth, solution) if self.same_catalog else 0
        row |= outcome_columns(self.renderer, truth, solution, wrong_stars, row["nees"], errors, self.specification)
        row["limit_mag"] = float(solution.stars.v_mag.max()) if solution.matched else math.nan
        residuals = fitted.residual_px.ravel()
        row |= in_field(frame.camera, sources, scenario.tracker.magnitude_limit)
        row |= {
            "stars_detected": len(solution.centroids),
            "stars_matched": solution.matched,
            "stars_used": len(fitted),
            "stars_misidentified": wrong_stars,
            "residual_rms_px": math.sqrt(float(residuals @ residuals) / len(residuals)) if len(residuals) else math.nan,
            "rate_deg_s": math.degrees(math.hypot(*truth.rate_camera_rad_s.tolist())),
        }
        return row
