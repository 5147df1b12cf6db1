"""True motion of a sequence, with jitter, and the process noise with which a filter follows it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simulator.build import sequence_motion
from simulator.mission.attitude_table import QUATERNION_COLUMNS, continuous
from simulator.mission.gyro import DEG_H, DEG_SQRT_H
from simulator.mission.motion import MotionState, motion
from simulator.mission.pointing import Pointing, hold, point, point_by, point_spinning
from simulator.mission.tables import read_rows
from simulator.optics.jitter_series import JitterMotion
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.scenario.schema import SequenceSection
from simulator.scene import SceneBuilder
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, RateNoise

RECORDED_COLUMNS = (*QUATERNION_COLUMNS, "rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
"""Columns of ``sequence.recording``: quaternion ICRS to camera and inertial rate in camera axes."""
_SAME_TIME_S = 1e-6

_LEAST_WALK = 1e-6
"""Minimum disturbance, rad/s/√s, assumed by the filter: a freely drifting body."""
_FEWEST_FOR_WALK = 8
_LAG_MARGIN = 3.0
"""Factor on a constant acceleration, which is not white noise, so that the lag of the filter is less than its σ."""


def start_pointing(scenario: Scenario, renderer: Renderer) -> Pointing:
    """Attitude at the first frame: that of trial 0 at this time, without jitter."""
    law, scenes = scenario.pointing, renderer.scenes
    rng, start_s = stream(scenario.seed, "pointing", 0), scenario.sequence.start_s
    if law.target is None and law.spin.rate_deg_s:
        return point_spinning(law, start_s, rng)
    if scenes.law is not None:
        return point_by(law, scenes.law, start_s, rng)
    if law.target is None:
        return point(law, *scenes.orbit.state(start_s), rng)
    nominal = renderer.scene(0, at_s=start_s).pointing.prior
    return hold(law, nominal, rng)


def states_at(scenario: Scenario, scenes: SceneBuilder, start: Pointing, since_s: Sequence[float]) -> list[MotionState]:
    """True states without jitter at times after the first frame, ascending, from 0."""
    return motion(scenario.pointing, sequence_motion(scenario.sequence), scenes.orbit, start, since_s, scenes.law)


def recorded_states(scenario: Scenario, scenes: SceneBuilder, since_s: Sequence[float]) -> list[MotionState]:
    """True states without jitter, on the actual mounting, of the table ``sequence.recording``.

    Raises
    ------
    InputError
        For a file that cannot be used, or whose times are not those of the frames.
    """
    section = scenario.sequence
    path = scenario.base_dir / str(section.recording)
    t_s, values, positions = read_rows(path, scenes.clock, RECORDED_COLUMNS)
    if len(t_s) < len(since_s):
        raise InputError(f"{path}: has {len(t_s)} of {len(since_s)} frames; sequence.frames may be {len(t_s)} at most")
    continuous(values[:, :4], positions)
    states = []
    for k, since in enumerate(since_s):
        at_s = section.start_s + since
        if abs(at_s - t_s[k]) > _SAME_TIME_S:
            raise InputError(
                f"{positions[k]}: t_s is {t_s[k]:.9g}, but frame {k} is at {at_s:.9g} s; sequence.start_s and step_s "
                "must be those of the recording"
            )
        states.append(MotionState(at_s, Attitude(values[k, :4].copy()), values[k, 4:]))
    return states


def jitter_at(scenario: Scenario, scenes: SceneBuilder, since_s: Sequence[float]) -> list[JitterMotion]:
    """Jitter relative to each time, one process for the whole sequence; empty without jitter."""
    path = scenes.sequence_jitter(stream(scenario.seed, "jitter", 0), scenario.sequence.start_s)
    return [path.shifted(t_s) for t_s in since_s] if path is not None else []


def process_noise(
    section: SequenceSection, states: Sequence[MotionState], shaking: Sequence[JitterMotion], exposure_s: float
) -> GyroNoise | RateNoise:
    """Process noise of the filter, from motion and jitter at the frames or from the gyro."""
    walk = section.rate_walk_deg_s_sqrt_s
    if walk == "auto":
        rates = np.array([state.rate_camera_rad_s for state in states])
        change = np.linalg.norm(np.diff(rates, axis=0), axis=1).max(initial=0.0) / section.step_s
        jitter = _jitter_walk(section, shaking, exposure_s)
        acceleration = max(_LEAST_WALK, _LAG_MARGIN * change * math.sqrt(section.step_s), jitter)
    else:
        acceleration = math.radians(walk)
    if not section.gyro.use:
        return RateNoise(acceleration, math.radians(section.rate_sigma_deg_s))
    gyro = section.gyro
    return GyroNoise(
        angle_random_walk=gyro.angle_random_walk_deg_sqrt_h * DEG_SQRT_H,
        rate_random_walk=gyro.bias_instability_deg_h * DEG_H * math.sqrt(2.0 / gyro.bias_time_s),
        bias_sigma_rad_s=max(math.hypot(gyro.bias_deg_h, gyro.bias_instability_deg_h) * DEG_H, 1e-9),
        acceleration=acceleration,
        scale_sigma=gyro.scale_factor_ppm * 1e-6,
    )


def _jitter_walk(section: SequenceSection, shaking: Sequence[JitterMotion], exposure_s: float) -> float:
    """White angular acceleration, rad/s/√s, equivalent to the second differences of the jitter angles.

    For an angle driven by a density q their variance is 2 q h³/3 at a step h.
    """
    angles = np.array([j.mean(exposure_s) for j in shaking])
    if len(angles) < _FEWEST_FOR_WALK:
        return 0.0
    variance = np.mean(np.diff(angles, 2, axis=0) ** 2, axis=0).max()
    return math.sqrt(1.5 * float(variance) / section.step_s**3)
