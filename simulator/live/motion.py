"""True motion of a live mission: along the scenario with rates added on the way, or as given from outside."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from simulator.build import sequence_motion
from simulator.mission.motion import BodyMotion, MotionState, on_mounting
from simulator.mission.pointing import Pointing
from simulator.scenario import Scenario
from simulator.scene import SceneBuilder
from startracker.core import FloatArray
from startracker.geometry.attitude import Attitude

__all__ = ["Given", "ScenarioMotion", "turned_on"]


class Given(NamedTuple):
    """An attitude from outside."""

    t_s: float
    """Seconds after the scenario's epoch."""
    quaternion: tuple[float, float, float, float]
    """ICRS to camera, scalar last."""
    rate_deg_s: tuple[float, float, float]
    """Inertial rate, camera axes."""
    received_s: float = math.nan
    """When it arrived, by `time.perf_counter`."""

    @property
    def state(self) -> MotionState:
        """The camera at its time."""
        return MotionState(self.t_s, Attitude(np.array(self.quaternion)), np.radians(self.rate_deg_s))


def turned_on(state: MotionState, t_s: float) -> MotionState:
    """The camera at another time, turned on with its rate, which is taken as constant."""
    if t_s == state.t_s:
        return state
    turn = Attitude.from_rotation_vector(state.rate_camera_rad_s * (t_s - state.t_s), "camera", "camera")
    return MotionState(t_s, turn @ state.camera, state.rate_camera_rad_s)


class ScenarioMotion:
    """The body along the scenario's own motion, with rates that are added on the way.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    scenes : SceneBuilder
        Its scenes.
    start : Pointing
        Attitude at the first frame, without jitter.
    """

    def __init__(self, scenario: Scenario, scenes: SceneBuilder, start: Pointing) -> None:
        self._scenario, self._scenes, self._start = scenario, scenes, start
        self._start_s = scenario.sequence.start_s
        self._body = self._begin()
        self._added_deg_s = np.zeros(3)

    def _begin(self) -> BodyMotion:
        given, scenes = self._scenario, self._scenes
        return BodyMotion(given.pointing, sequence_motion(given.sequence), scenes.orbit, self._start, scenes.law)

    @property
    def rate_deg_s(self) -> tuple[float, ...]:
        """Constant rate relative to the reference: the scenario's and what was added; roll, pitch, yaw."""
        return tuple((np.array(self._scenario.pointing.rate_deg_s) + self._added_deg_s).tolist())

    def at(self, since_s: float) -> MotionState:
        """The camera on its nominal mounting, seconds after the scenario's first frame, not before the last time."""
        return self._body.at(since_s)

    def on_mounting(self, state: MotionState) -> tuple[MotionState, FloatArray | None]:
        """The same motion on the actual mounting, and the thermo-elastic rotation of that."""
        rotation_rad = self._scenes.mounting_rotation_rad(state.t_s)
        return on_mounting(state, rotation_rad), rotation_rad

    def add_rate(self, rate_deg_s: FloatArray) -> None:
        """Add a rate (3,), body axes, °/s."""
        self._added_deg_s = self._added_deg_s + rate_deg_s
        self._body.add_rate(np.radians(rate_deg_s))

    def jump(self, since_s: float) -> None:
        """Begin again at a time: where the scenario's own motion is then, with the rates that were added."""
        self._body = self._begin()
        if since_s > 0.0:
            self._body.at(since_s)
        self._body.add_rate(np.radians(self._added_deg_s))
