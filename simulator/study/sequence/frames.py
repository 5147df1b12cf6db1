"""Frames of a sequence: rendered along the true motion, tracked, and compared with the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from simulator.mission.gyro import gyro_samples
from simulator.mission.motion import MotionState, on_mounting
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.process_noise import process_noise
from simulator.study.sequence.calibration import CalibratedCamera
from simulator.study.sequence.camera import LEAST_PRIOR_DEG, Moment, SequenceCamera, TrackedFrame
from simulator.study.sequence.columns import NO_FRAME
from simulator.study.sequence.operation import OperatedCamera
from simulator.study.sequence.true_motion import jitter_at, recorded_states, start_pointing, states_at
from startracker.core import FloatArray

__all__ = ["LEAST_PRIOR_DEG", "MODES", "NO_FRAME", "SequenceRunner", "TrackedFrame"]

MODES = ("tracking", "prior", "lost_in_space", "coasting", "none")
"""Source of the attitude of a frame: windows; whole frame near the prediction; whole frame and whole sky; prediction
only; none."""


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
        self.renderer = Renderer(scenario)
        section = scenario.sequence
        self.start = start_pointing(scenario, self.renderer)
        self.camera = SequenceCamera(scenario, self.renderer, self.start, single=single)
        self.tracker = self.camera.tracker
        self.since_s = [k * section.step_s for k in range(section.frames)]
        self.states = self._states()
        self.renderer.scenes.plan([state.t_s for state in self.states])
        self.rotations_rad = [self.renderer.scenes.mounting_rotation_rad(state.t_s) for state in self.states]
        if section.recording is None:
            pairs = zip(self.states, self.rotations_rad, strict=True)
            self.states = [on_mounting(state, rotation_rad) for state, rotation_rad in pairs]
        self.shaking = jitter_at(scenario, self.renderer.scenes, self.since_s)
        moments, exposure_s = [self._moment(k) for k in range(section.frames)], self.renderer.exposure_s
        self.cameras = [moment.camera(exposure_s) for moment in moments]
        """True attitudes, including the mean jitter over the exposure."""
        self.rates = [moment.rate_rad_s(exposure_s) for moment in moments]
        self.gyro: FloatArray | None = None
        self.biases: FloatArray | None = None
        if section.gyro.use:
            turns = [a.rotation_vector_to(b) for a, b in pairwise(self.cameras)]
            self.gyro, self.biases, _ = gyro_samples(
                section.gyro, np.reshape(turns, (-1, 3)), section.step_s, stream(scenario.seed, "gyro")
            )
        self.noise = process_noise(section, self.states, self.shaking, exposure_s)

    def _states(self) -> list[MotionState]:
        """True states without jitter, and those of the scenario without the rotation of the mounting."""
        scenes = self.renderer.scenes
        if self.scenario.sequence.recording is not None:
            return recorded_states(self.scenario, scenes, self.since_s)
        return states_at(self.scenario, scenes, self.start, self.since_s)

    @property
    def operated(self) -> OperatedCamera | None:
        """The camera with its rules of operation, set by `frames`; None without rules."""
        return self.camera.operated

    @property
    def calibrated(self) -> CalibratedCamera | None:
        """The camera with its calibration in flight, set by `frames`; None without."""
        return self.camera.calibrated

    def _moment(self, k: int) -> Moment:
        """The camera at frame `k`."""
        since_s, jitter = self.since_s[k], self.shaking[k] if self.shaking else None
        return Moment(k, since_s, self.states[k], self.rotations_rad[k], jitter)

    def frames(self) -> Iterator[TrackedFrame]:
        """All frames in order; reproducible."""
        self.camera.begin(self.noise, self.start.prior)
        dropouts = self.scenario.sequence.dropouts
        for k, since_s in enumerate(self.since_s):
            missing = any(d.start_s <= since_s < d.start_s + d.duration_s for d in dropouts)
            gyro = self.gyro[k - 1] if self.gyro is not None and k else None
            bias = self.biases[k] if self.biases is not None else None
            yield self.camera.take(replace(self._moment(k), gyro_rad_s=gyro, bias_rad_s=bias, missing=missing))
