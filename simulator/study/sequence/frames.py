"""Frames of a sequence: rendered along the true motion, tracked, and compared with the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.frame import Frame, FrameTruth
from simulator.mission.gyro import DEG_H, DEG_SQRT_H, gyro_samples
from simulator.mission.motion import MotionState, on_mounting
from simulator.mission.pointing import deformed
from simulator.optics.jitter_series import JitterMotion
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.sequence.calibration import CalibratedCamera
from simulator.study.sequence.columns import (
    NO_FRAME,
    camera_error_deg,
    compared_columns,
    is_beyond,
    is_wrong_attitude,
    opening_columns,
    three_columns,
)
from simulator.study.sequence.operation import OperatedCamera
from simulator.study.sequence.true_motion import jitter_at, process_noise, start_pointing, states_at
from simulator.study.specification.requirements import specification_of
from simulator.study.statistics import BODY_AXES, CAMERA_AXES
from simulator.study.trials.trial import (
    attitude_errors_deg,
    build_tracker,
    in_field,
    misidentified,
    normalised_error_squared,
)
from startracker.arrays import FloatArray
from startracker.attitude import Attitude
from startracker.display import fields_repr
from startracker.kernels import clock
from startracker.solution import Solution
from startracker.tracking import TrackingSession

__all__ = ["LEAST_PRIOR_DEG", "MODES", "NO_FRAME", "SequenceRunner", "TrackedFrame"]

MODES = ("tracking", "prior", "lost_in_space", "coasting", "none")
"""Source of the attitude of a frame: windows; whole frame near the prediction; whole frame and whole sky; prediction
only; none."""
LEAST_PRIOR_DEG = 0.1


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

    __repr__ = fields_repr


class SequenceRunner:
    """Renders and tracks the frames of one scenario's ``sequence``.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    single : bool
        Also solve every frame on its own, without a prior.
    """

    def __init__(self, scenario: Scenario, *, single: bool = False) -> None:
        self.scenario = scenario
        self.single = single
        self.renderer = Renderer(scenario)
        self.tracker = build_tracker(scenario, self.renderer.camera)
        self.same_catalog = scenario.sky.catalog == scenario.tracker.catalog
        self.specification = specification_of(scenario)
        section = scenario.sequence
        self.start = start_pointing(scenario, self.renderer)
        since_s = [k * section.step_s for k in range(section.frames)]
        self.states = states_at(scenario, self.renderer.scenes, self.start, since_s)
        self.renderer.scenes.plan([state.t_s for state in self.states])
        self.rotations_rad = [self.renderer.scenes.mounting_rotation_rad(state.t_s) for state in self.states]
        self.states = [on_mounting(state, turn) for state, turn in zip(self.states, self.rotations_rad, strict=True)]
        self.shaking = jitter_at(scenario, self.renderer.scenes, since_s)
        self.cameras = [state.camera for state in self.states]
        """True attitudes, including the mean jitter over the exposure."""
        self.rates = [state.rate_camera_rad_s for state in self.states]
        if self.shaking:
            exposure_s = self.renderer.exposure_s
            means = [Attitude.from_rotation_vector(j.mean(exposure_s), "camera", "camera") for j in self.shaking]
            self.cameras = [mean @ camera for mean, camera in zip(means, self.cameras, strict=True)]
            self.rates = [rate + j.rate(exposure_s) for rate, j in zip(self.rates, self.shaking, strict=True)]
        self.gyro: FloatArray | None = None
        self.biases: FloatArray | None = None
        if section.gyro.use:
            turns = [a.rotation_vector_to(b) for a, b in pairwise(self.cameras)]
            self.gyro, self.biases, _ = gyro_samples(
                section.gyro, np.reshape(turns, (-1, 3)), section.step_s, stream(scenario.seed, "gyro")
            )
        self.noise = process_noise(section, self.states, self.shaking, self.renderer.exposure_s)
        self.operated: OperatedCamera | None = None
        """The camera with its rules of operation, set by `frames`; None without rules."""
        self.calibrated: CalibratedCamera | None = None
        """The camera with its calibration in flight, set by `frames`; None without."""

    def _jitter(self, k: int) -> JitterMotion | None:
        return self.shaking[k] if self.shaking else None

    # ------------------------------------------------------------------ the frames
    def frames(self) -> Iterator[TrackedFrame]:
        """All frames in order; reproducible."""
        scenario, section = self.scenario, self.scenario.sequence
        session = self._session()
        if scenario.tracker.prior:  # uniform within the half width about each axis
            half_width_deg = max(scenario.pointing.error_deg, LEAST_PRIOR_DEG)
            session.reset(self.start.prior, half_width_deg / math.sqrt(3.0))
        self.operated = OperatedCamera(scenario, self.renderer, self.tracker) if section.operation.use else None
        for k, state in enumerate(self.states):
            since_s = k * section.step_s
            gyro = self.gyro[k - 1] if self.gyro is not None and k else None
            if any(d.start_s <= since_s < d.start_s + d.duration_s for d in section.dropouts):
                solution = session.update_centroids(np.empty((0, 2)), None, since_s, gyro_rad_s=gyro)
                row = self._row(k, state, self.cameras[k], session, solution, math.nan, 0.0)
                row |= {"status": NO_FRAME, "reason": "no frame"} | self._alone(None, None)
                row |= self.operated.dropped(solution, session) if self.operated else {}
                yield TrackedFrame(row, None, solution, np.empty((0, 2)), 0)
                continue
            started = clock()
            taken = self._take(k, state, since_s, session)
            rendered = clock()
            if self.operated is not None and self.operated.verdict.image is None:
                yield self._refused(k, state, since_s, session, gyro, taken, (rendered - started) * 1e3)
                continue
            assert taken is not None
            frame, truth = taken
            image: NDArray[Any] = frame.image
            if self.operated is not None and self.operated.verdict.image is not None:
                image = self.operated.verdict.image
            known: dict[str, Any] = {n: getattr(frame, n) for n in ("observer", "saturation_dn", "gain_e_per_dn")}
            solution = session.update(image, since_s + truth.time_tag_error_s, gyro_rad_s=gyro, **known)
            tracked = clock()
            times = (rendered - started) * 1e3, (tracked - rendered) * 1e3
            row = self._row(k, state, truth.attitude_at_tag, session, solution, *times)
            row |= self._counts(frame, truth, solution)
            misnamed, error_deg = row["stars_misidentified"], camera_error_deg(row)
            row["wrong"] = is_wrong_attitude(self.renderer, truth, solution, misnamed, row["nees"], error_deg)
            if self.single:
                row |= self._alone(self.tracker.solve(image, **known), truth)
            row |= self.operated.columns(frame, solution, session) if self.operated else {}
            windows = session.state.window_xy
            half = session.state.window_half_px
            yield TrackedFrame(row, frame, solution, np.empty((0, 2)) if windows is None else windows, half)

    def _session(self) -> TrackingSession:
        """A new session, with calibration in flight if the scenario has it."""
        if not self.scenario.tracker.in_flight_calibration.use:
            return TrackingSession(self.tracker, self.noise, exposure_s=self.renderer.exposure_s)
        self.calibrated = CalibratedCamera(self.scenario, self.renderer, self.tracker)
        return self.calibrated.session(self.noise)

    def _take(
        self, k: int, state: MotionState, since_s: float, session: TrackingSession
    ) -> tuple[Frame, FrameTruth] | None:
        """Frame and truth; None while operation is suspended."""
        if self.operated is not None:
            return self.operated.expose(k, state, since_s, session, self._jitter(k))
        return self.renderer.frame(
            k,
            at_s=state.t_s,
            attitude=state.camera,
            rate_camera_rad_s=state.rate_camera_rad_s,
            jitter=self._jitter(k),
        )

    def _refused(
        self,
        k: int,
        state: MotionState,
        since_s: float,
        session: TrackingSession,
        gyro: FloatArray | None,
        taken: tuple[Frame, FrameTruth] | None,
        render_ms: float,
    ) -> TrackedFrame:
        """A frame that is discarded by the rules of operation, or was not taken."""
        assert self.operated is not None
        solution = session.update_centroids(np.empty((0, 2)), None, since_s, gyro_rad_s=gyro)
        frame, truth = taken if taken is not None else (None, None)
        true = truth.attitude if truth is not None else self.cameras[k]
        row = self._row(k, state, true, session, solution, math.nan if frame is None else render_ms, 0.0)
        if frame is not None and truth is not None:
            row |= self._counts(frame, truth, solution)
        row |= self._alone(None, None) | self.operated.columns(frame, solution, session) | self.operated.refused()
        return TrackedFrame(row, frame, solution, np.empty((0, 2)), 0)

    def _row(
        self,
        k: int,
        state: MotionState,
        true: Attitude,
        session: TrackingSession,
        solution: Solution,
        render_ms: float,
        track_ms: float,
    ) -> dict[str, Any]:
        rotation_rad = self.rotations_rad[k]
        mounting = deformed(self.start, rotation_rad).mounting
        estimate, covariance = session.filter_attitude, session.covariance
        mode = session.state.mode if solution.solved else "none" if estimate is None else "coasting"
        innovation = session.state.innovation
        elapsed_s = k * self.scenario.sequence.step_s
        row = opening_columns(k, elapsed_s, state.t_s, self.renderer.scenes.clock.isot(state.t_s))
        row |= {"mode": mode, "status": str(solution.status), "reason": solution.reason}
        known = None if covariance is None else covariance[:3, :3]
        row |= compared_columns(true, estimate, known, mounting, rotation_rad)
        row["beyond_specification"] = solution.solved and is_beyond(row, self.specification)
        row |= self._rates(k, session)
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
            row |= self.calibrated.columns(state.t_s, tracked=solution.solved)
        return row

    def _rates(self, k: int, session: TrackingSession) -> dict[str, float]:
        """True and estimated rate, and with a gyro its bias, camera axes."""
        section = self.scenario.sequence
        rate, covariance = session.rate_rad_s, session.covariance
        if rate is None or covariance is None or (section.gyro.use and k == 0):
            rate, variance = np.full(3, math.nan), np.full(3, math.nan)
        else:
            variance = np.diag(covariance)[3:]
            if section.gyro.use:
                variance = variance + (section.gyro.angle_random_walk_deg_sqrt_h * DEG_SQRT_H) ** 2 / section.step_s
        row = three_columns("rate", "deg_s", self.rates[k], rate, np.sqrt(variance), math.degrees(1.0))
        if self.biases is not None:
            bias = session.bias_rad_s if session.bias_rad_s is not None else np.full(3, math.nan)
            spread = np.sqrt(np.diag(covariance)[3:]) if covariance is not None else np.full(3, math.nan)
            row |= three_columns("bias", "deg_h", self.biases[k] / DEG_H, bias / DEG_H, spread / DEG_H, 1.0)
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
            "single_wrong": False,
        }
        errors = dict.fromkeys((*BODY_AXES, *CAMERA_AXES), math.nan)
        if solution is not None and truth is not None and solution.attitude is not None:
            true = truth.attitude_at_tag
            errors = attitude_errors_deg(true, solution.attitude, truth.mounting, truth.mounting_rotation_rad)
            error_deg = np.array([errors[axis] for axis in CAMERA_AXES])
            nees = normalised_error_squared(error_deg, solution.covariance)
            wrong_stars = misidentified(truth, solution) if self.same_catalog else 0
            row["single_wrong"] = is_wrong_attitude(self.renderer, truth, solution, wrong_stars, nees, error_deg)
        row |= {f"single_error_{axis}_deg": errors[axis] for axis in (*BODY_AXES, *CAMERA_AXES)}
        row["single_ms"] = sum(solution.times_ms.values()) if solution else math.nan
        return row
