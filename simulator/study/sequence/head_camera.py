"""One head of several: its camera at its actual mounting, its frames, and their solutions."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from simulator.frame import Frame, FrameTruth
from simulator.mission.motion import MotionState, on_mounting
from simulator.mission.pointing import mounting_of
from simulator.optics.jitter_series import JitterMotion
from simulator.randomness import seed_of, stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.scenario.heads import head_values
from simulator.scenario.schema import HeadSection
from simulator.study.sequence.columns import NO_FRAME, error_columns, row_errors_deg
from simulator.study.specification.requirements import specification_of
from simulator.study.trackers import tracker_of
from simulator.study.trials.causes import NO_OUTCOME_COLUMNS, outcome_columns
from simulator.study.trials.trial import in_field, misidentified
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.fusion import Head
from startracker.geometry.attitude import Attitude
from startracker.solution import Solution


def scenario_of_head(scenario: Scenario, head: HeadSection) -> Scenario:
    """The scenario of one head alone: its mounting and its values of lens, detector and tracker, and no heads."""
    return scenario.changed(head_values(head) | {"pointing.mounting": head.mounting, "heads": ()})


class BodyState(NamedTuple):
    """The body at one time."""

    since_s: float
    t_s: float
    """Seconds after the first frame, and after the scenario's epoch."""
    body: Attitude
    """ICRS to body, without jitter."""
    rate_rad_s: FloatArray
    """(3,): Inertial angular velocity without jitter, body axes."""
    jitter: JitterMotion | None
    """Relative to this time, body axes."""

    def jittered(self, exposure_s: float) -> Attitude:
        """ICRS to body, including the mean jitter over an exposure."""
        if self.jitter is None:
            return self.body
        return Attitude.from_rotation_vector(self.jitter.mean(exposure_s), "body", "body") @ self.body

    def jittered_rate_rad_s(self, exposure_s: float) -> FloatArray:
        """Rate (3,) including the mean of the jitter over an exposure, body axes."""
        return self.rate_rad_s if self.jitter is None else self.rate_rad_s + self.jitter.rate(exposure_s)


class HeadCamera:
    """A camera of several on one body.

    Parameters
    ----------
    scenario : Scenario
        The scenario of all heads.
    head : HeadSection
        This one, of its ``heads``.

    Notes
    -----
    The camera's own properties (fixed pattern, calibration residual) and the noise of its frames have the seed of its
    name; sky, catalogue errors and motion have that of the scenario.
    """

    def __init__(self, scenario: Scenario, head: HeadSection) -> None:
        self.head, self.name = head, head.name
        camera_seed = seed_of(scenario.seed, "head", head.name)
        own = scenario_of_head(scenario, head)
        known = mounting_of(own.pointing)
        self.misalignment_rad = self._misalignment_rad(camera_seed)
        turn = Attitude.from_rotation_vector(self.misalignment_rad, "camera", "camera")
        self.mounting = turn @ known
        """Actual mounting, body to camera."""
        self.scenario = own.changed({"pointing.mounting": self.mounting.quat.tolist()})
        self.renderer = Renderer(self.scenario, camera_seed)
        self.tracker = tracker_of(self.scenario, self.renderer)
        x, y, z = (value * ARCSEC_RAD for value in head.correlated_arcsec)
        sigma_rad = head.alignment_sigma_arcsec * ARCSEC_RAD
        bending_rad = self._bending_arcsec() * ARCSEC_RAD
        self.filter_head = Head(head.name, known, sigma_rad, (x, y, z), head.correlation_s, bending_rad, head.bending_s)
        """What the filter knows of it."""
        self.same_catalog = scenario.sky.catalog == self.scenario.tracker.catalog
        self.specification = specification_of(self.scenario)

    def _misalignment_rad(self, seed: int) -> FloatArray:
        """Actual rotation from the known to the actual mounting (3,)."""
        given = self.head.misalignment_arcsec
        if given is None:
            drawn = stream(seed, "misalignment").standard_normal(3)
            return np.asarray(self.head.alignment_sigma_arcsec * ARCSEC_RAD * drawn)
        return np.array(given) * ARCSEC_RAD

    def _bending_arcsec(self) -> float:
        """Standard deviation of the motion of the mounting, as the filter assumes it; by default the rms of a sine."""
        given = self.head.bending_arcsec
        if given is not None:
            return given
        return max(map(abs, self.scenario.pointing.thermo_elastic.amplitude_arcsec)) / math.sqrt(2.0)

    def sees(self, since_s: float) -> bool:
        """Whether there is a frame at a time after the first of the sequence."""
        gaps = (*self.scenario.sequence.dropouts, *self.head.dropouts)
        return not any(gap.start_s <= since_s < gap.start_s + gap.duration_s for gap in gaps)

    def rotation_rad(self, state: BodyState) -> FloatArray | None:
        """Thermo-elastic rotation of the mounting (3,), camera axes; None if there is none."""
        return self.renderer.scenes.mounting_rotation_rad(state.t_s)

    def motion(self, state: BodyState) -> MotionState:
        """The camera at its actual mounting, without jitter."""
        rigid = MotionState(state.t_s, self.mounting @ state.body, self.mounting.apply(state.rate_rad_s))
        return on_mounting(rigid, self.rotation_rad(state))

    def take(self, index: int, state: BodyState) -> tuple[Frame, FrameTruth]:
        """Frame number `index` and its truth."""
        seen, jitter = self.motion(state), state.jitter
        return self.renderer.frame(
            index,
            at_s=state.t_s,
            attitude=seen.camera,
            rate_camera_rad_s=seen.rate_camera_rad_s,
            jitter=None if jitter is None else jitter.in_axes(self.mounting.as_matrix()),
        )

    def solve(self, frame: Frame, prior: Attitude | None, prior_deg: float) -> Solution:
        """Attitude of a frame from its own stars; the prior only helps to identify them."""
        return self.tracker.solve(
            frame.image,
            prior=prior,
            prior_deg=prior_deg,
            observer=frame.observer,
            saturation_dn=frame.saturation_dn,
            gain_e_per_dn=frame.gain_e_per_dn,
        )

    def columns(self, frame: Frame, truth: FrameTruth, solution: Solution) -> dict[str, Any]:
        """Columns of a frame, without the name of the head."""
        wrong_stars = misidentified(truth, solution) if self.same_catalog else 0
        columns: dict[str, Any] = {
            "status": str(solution.status),
            "reason": solution.reason,
            **in_field(frame.camera, truth.sources, self.scenario.tracker.magnitude_limit),
            "excluded": ", ".join(truth.excluded),
            "stars_detected": len(solution.centroids),
            "stars_matched": solution.matched,
            "stars_misidentified": wrong_stars,
        }
        columns |= error_columns(
            truth.attitude_at_tag,
            solution.attitude,
            solution.covariance,
            truth.mounting,
            truth.mounting_rotation_rad,
        )
        errors = row_errors_deg(columns)
        return columns | outcome_columns(
            self.renderer, truth, solution, wrong_stars, columns["nees"], errors, self.specification
        )

    def missing(self) -> dict[str, Any]:
        """Columns of a missing frame."""
        fields = dict.fromkeys(("stars_in_field", "bodies_in_field", "satellites_in_field"), 0)
        counts = dict.fromkeys(("stars_detected", "stars_matched", "stars_misidentified"), 0)
        said = {"status": NO_FRAME, "reason": "no frame", **fields, "excluded": ""}
        identity = Attitude(np.array([0.0, 0.0, 0.0, 1.0]))
        return said | counts | error_columns(identity, None, None, self.mounting) | NO_OUTCOME_COLUMNS
