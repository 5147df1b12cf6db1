"""One camera of a sequence: a frame at one instant, rendered, tracked, and compared with the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.frame import Frame, FrameTruth
from simulator.mission.gyro import DEG_H, DEG_SQRT_H
from simulator.mission.motion import MotionState
from simulator.mission.pointing import Pointing, deformed
from simulator.optics.jitter_series import JitterMotion
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.axes import BODY_AXES, CAMERA_AXES
from simulator.study.sequence.calibration import CalibratedCamera
from simulator.study.sequence.columns import (
    NO_FRAME,
    compared_columns,
    is_beyond,
    opening_columns,
    row_errors_deg,
    three_columns,
)
from simulator.study.sequence.operation import OperatedCamera
from simulator.study.specification.requirements import specification_of
from simulator.study.trackers import Session, session_of, tracker_of
from simulator.study.trials.causes import NO_OUTCOME_COLUMNS, outcome_columns
from simulator.study.trials.trial import attitude_errors_deg, in_field, misidentified, normalised_error_squared
from startracker._compiled import clock
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.geometry.attitude import Attitude
from startracker.solution import Solution
from startracker.tracker import StarTracker
from startracker.tracking import GyroNoise, RateNoise

LEAST_PRIOR_DEG = 0.1
_NO_WINDOWS: FloatArray = np.empty((0, 2))


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """One frame of a sequence."""

    row: dict[str, Any]
    """Row of ``sequence.parquet``."""
    frame: Frame | None
    """The image; None for a missing frame."""
    solution: Solution
    """Result of the session."""
    window_xy: FloatArray
    window_half_px: int
    """(M, 2): Centres of the windows."""
    truth: FrameTruth | None = None
    """Truth of the frame; None for a missing frame."""

    __repr__ = fields_repr


@dataclass(frozen=True, eq=False)
class Moment:
    """The camera at one time of a sequence."""

    index: int
    """Number of the frame, which determines its noise."""
    since_s: float
    """Seconds after the first frame."""
    state: MotionState
    """On its mounting, without jitter."""
    rotation_rad: FloatArray | None = None
    """(3,): Thermo-elastic rotation of the mounting, camera axes."""
    jitter: JitterMotion | None = None
    """Relative to this time."""
    gyro_rad_s: FloatArray | None = None
    """(3,): Mean measured rate since the last frame; None without a gyro, or before the second frame."""
    bias_rad_s: FloatArray | None = None
    """(3,): True bias of the gyro; None without one."""
    missing: bool = False
    """No frame is taken."""

    def camera(self, exposure_s: float) -> Attitude:
        """True attitude, including the mean jitter over an exposure."""
        if self.jitter is None:
            return self.state.camera
        return Attitude.from_rotation_vector(self.jitter.mean(exposure_s), "camera", "camera") @ self.state.camera

    def rate_rad_s(self, exposure_s: float) -> FloatArray:
        """True rate (3,), including the mean rate of the jitter over an exposure, camera axes."""
        rate = self.state.rate_camera_rad_s
        return rate if self.jitter is None else rate + self.jitter.rate(exposure_s)


class SequenceCamera:
    """Renders and tracks one frame after the other.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    renderer : Renderer
        Its renderer.
    start : Pointing
        Attitude at the first frame, without jitter.
    single : bool
        Also solve every frame on its own, without a prior.
    """

    def __init__(self, scenario: Scenario, renderer: Renderer, start: Pointing, *, single: bool = False) -> None:
        self.scenario, self.renderer, self.start, self.single = scenario, renderer, start, single
        self.tracker = tracker_of(scenario, renderer)
        self.same_catalog = scenario.sky.catalog == scenario.tracker.catalog
        self.specification = specification_of(scenario)
        self.session: Session = session_of(self.tracker)
        """Replaced by `begin`."""
        self.operated: OperatedCamera | None = None
        """The camera with its rules of operation; None without rules."""
        self.calibrated: CalibratedCamera | None = None
        """The camera with its calibration in flight; None without."""

    def begin(self, noise: GyroNoise | RateNoise, prior: Attitude | None) -> None:
        """Begin a pass with a new session, from the attitude of the other sensors if the scenario has them."""
        scenario = self.scenario
        self.calibrated = None
        if scenario.tracker.in_flight_calibration.use:
            assert isinstance(self.tracker, StarTracker)  # a rule of the scenario
            self.calibrated = CalibratedCamera(scenario, self.renderer, self.tracker)
            self.session = self.calibrated.session(noise)
        else:
            self.session = session_of(self.tracker, noise, self.renderer.exposure_s)
        if scenario.tracker.prior and prior is not None:  # uniform within the half width about each axis
            half_width_deg = max(scenario.pointing.error_deg, LEAST_PRIOR_DEG)
            self.session.reset(prior, half_width_deg / math.sqrt(3.0))
        rules = scenario.sequence.operation
        self.operated = OperatedCamera(scenario, self.renderer, self.tracker) if rules.use else None

    def use(self, renderer: Renderer) -> None:
        """Take the following frames with another renderer, of a camera with the same geometry."""
        self.renderer, self.scenario = renderer, renderer.scenario
        self.session.exposure_s = renderer.exposure_s
        for part in (self.operated, self.calibrated):
            if part is not None:
                part.renderer, part.scenario = renderer, renderer.scenario

    def take(self, moment: Moment) -> TrackedFrame:
        """The next frame; after `begin`."""
        session, operated = self.session, self.operated
        if moment.missing:
            row, solution = self._without_image(moment, self._true_camera(moment), math.nan)
            row |= {"status": NO_FRAME, "reason": "no frame"} | self._alone(None, None)
            row |= operated.dropped(solution, session) if operated else {}
            return TrackedFrame(row, None, solution, _NO_WINDOWS, 0)
        started = clock()
        taken = self._expose(moment)
        rendered = clock()
        if taken is None:
            return self._refused(moment, taken, (rendered - started) * 1e3)
        frame, truth = taken
        image: NDArray[Any] | None = frame.image if operated is None else operated.verdict.image
        if image is None:
            return self._refused(moment, taken, (rendered - started) * 1e3)
        known: dict[str, Any] = {n: getattr(frame, n) for n in ("observer", "saturation_dn", "gain_e_per_dn")}
        at_s = moment.since_s + truth.time_tag_error_s
        solution = session.update(image, at_s, gyro_rad_s=moment.gyro_rad_s, **known)
        tracked = clock()
        times = (rendered - started) * 1e3, (tracked - rendered) * 1e3
        row = self._row(moment, truth.attitude_at_tag, solution, *times)
        row |= self._counts(frame, truth, solution)
        misnamed, errors = row["stars_misidentified"], row_errors_deg(row)
        row |= outcome_columns(self.renderer, truth, solution, misnamed, row["nees"], errors, self.specification)
        if self.single:
            row |= self._alone(self.tracker.solve(image, **known), truth)
        row |= operated.columns(frame, solution, session) if operated else {}
        windows, half = session.state.window_xy, session.state.window_half_px
        return TrackedFrame(row, frame, solution, _NO_WINDOWS if windows is None else windows, half, truth)

    def _true_camera(self, moment: Moment) -> Attitude:
        return moment.camera(self.renderer.exposure_s)

    def _expose(self, moment: Moment) -> tuple[Frame, FrameTruth] | None:
        """Frame and truth; None while operation is suspended."""
        state = moment.state
        if self.operated is not None:
            return self.operated.expose(moment.index, state, moment.since_s, self.session, moment.jitter)
        return self.renderer.frame(
            moment.index,
            at_s=state.t_s,
            attitude=state.camera,
            rate_camera_rad_s=state.rate_camera_rad_s,
            jitter=moment.jitter,
        )

    def _without_image(self, moment: Moment, true: Attitude, render_ms: float) -> tuple[dict[str, Any], Solution]:
        """Row and prediction of a frame that the tracker is not given."""
        empty = np.empty((0, 2))
        solution = self.session.update_centroids(empty, None, moment.since_s, gyro_rad_s=moment.gyro_rad_s)
        return self._row(moment, true, solution, render_ms, 0.0), solution

    def _refused(self, moment: Moment, taken: tuple[Frame, FrameTruth] | None, render_ms: float) -> TrackedFrame:
        """A frame that is discarded by the rules of operation, or was not taken."""
        assert self.operated is not None
        true = self._true_camera(moment) if taken is None else taken[1].attitude
        row, solution = self._without_image(moment, true, math.nan if taken is None else render_ms)
        if taken is not None:
            row |= self._counts(*taken, solution)
        frame, truth = taken or (None, None)
        row |= self._alone(None, None) | self.operated.columns(frame, solution, self.session)
        return TrackedFrame(row | self.operated.refused(), frame, solution, _NO_WINDOWS, 0, truth)

    def _row(
        self, moment: Moment, true: Attitude, solution: Solution, render_ms: float, track_ms: float
    ) -> dict[str, Any]:
        rotation_rad, session, t_s = moment.rotation_rad, self.session, moment.state.t_s
        mounting = deformed(self.start, rotation_rad).mounting
        estimate, covariance = session.filter_attitude, session.covariance
        mode = session.state.mode if solution.solved else "none" if estimate is None else "coasting"
        innovation = session.state.innovation
        row = opening_columns(moment.index, moment.since_s, t_s, self.renderer.scenes.clock.isot(t_s))
        row |= {"mode": mode, "status": str(solution.status), "reason": solution.reason}
        known = None if covariance is None else covariance[:3, :3]
        row |= compared_columns(true, estimate, known, mounting, rotation_rad)
        row["beyond_specification"] = solution.solved and is_beyond(row, self.specification)
        row |= self._rates(moment)
        row |= {
            "innovation_distance2": innovation.distance2 if innovation else math.nan,
            "innovation_freedom": innovation.freedom if innovation else 0,
            "restarted": session.state.restarted,
            "distrusted": session.state.distrusted,
            "windows": session.state.windows,
            "stars_expected": session.state.expected,
            "stars_in_field": 0,
            "bodies_in_field": 0,
            "satellites_in_field": 0,
            "excluded": "",
            "stars_detected": len(solution.centroids),
            "stars_matched": session.state.matched,
            "stars_misidentified": 0,
            "render_ms": render_ms,
            "track_ms": track_ms,
        }
        if self.calibrated is not None:
            row |= self.calibrated.columns(t_s, tracked=solution.solved)
        return row

    def _rates(self, moment: Moment) -> dict[str, float]:
        """True and estimated rate, and with a gyro its bias, camera axes."""
        section, session = self.scenario.sequence, self.session
        rate, covariance = session.rate_rad_s, session.covariance
        spread = None if covariance is None else np.sqrt(np.diag(covariance)[3:])
        sigma = spread
        if rate is None or covariance is None or (section.gyro.use and moment.gyro_rad_s is None):
            rate = sigma = None
        elif section.gyro.use:
            white = (section.gyro.angle_random_walk_deg_sqrt_h * DEG_SQRT_H) ** 2 / section.step_s
            sigma = np.sqrt(np.diag(covariance)[3:] + white)
        true = moment.rate_rad_s(self.renderer.exposure_s)
        row = three_columns("rate", "deg_s", true, rate, sigma, math.degrees(1.0))
        if moment.bias_rad_s is not None:
            bias = None if session.bias_rad_s is None else session.bias_rad_s / DEG_H
            spread = None if spread is None else spread / DEG_H
            row |= three_columns("bias", "deg_h", moment.bias_rad_s / DEG_H, bias, spread, 1.0)
        return row

    def _counts(self, frame: Frame, truth: FrameTruth, solution: Solution) -> dict[str, int | str]:
        return {
            **in_field(frame.camera, truth.sources, self.scenario.tracker.magnitude_limit),
            "excluded": ", ".join(truth.excluded),
            "stars_misidentified": misidentified(truth, solution) if self.same_catalog else 0,
        }

    def _alone(self, solution: Solution | None, truth: FrameTruth | None) -> dict[str, Any]:
        """Columns of the frame solved on its own; empty values without a frame."""
        if not self.single:
            return {}
        row: dict[str, Any] = {
            "single_status": str(solution.status) if solution else NO_FRAME,
            "single_matched": solution.matched if solution else 0,
        }
        outcome = NO_OUTCOME_COLUMNS
        errors = dict.fromkeys((*BODY_AXES, *CAMERA_AXES), math.nan)
        if solution is not None and truth is not None and solution.attitude is not None:
            true = truth.attitude_at_tag
            errors = attitude_errors_deg(true, solution.attitude, truth.mounting, truth.mounting_rotation_rad)
            error_deg = np.array([errors[axis] for axis in CAMERA_AXES])
            nees = normalised_error_squared(error_deg, solution.covariance)
            wrong_stars = misidentified(truth, solution) if self.same_catalog else 0
            outcome = outcome_columns(self.renderer, truth, solution, wrong_stars, nees, errors, self.specification)
        row |= {f"single_{name}": value for name, value in outcome.items()}
        row |= {f"single_error_{axis}_deg": errors[axis] for axis in (*BODY_AXES, *CAMERA_AXES)}
        row["single_ms"] = sum(solution.times_ms.values()) if solution else math.nan
        return row
