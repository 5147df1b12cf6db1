"""True motion of a sequence, with jitter."""

from __future__ import annotations

from collections.abc import Sequence

from simulator.build import sequence_motion
from simulator.mission.attitude_table import QUATERNION_COLUMNS, continuous
from simulator.mission.motion import MotionState, motion
from simulator.mission.pointing import Pointing, hold, point, point_by, point_spinning
from simulator.mission.tables import read_rows
from simulator.optics.jitter_series import JitterMotion
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.scene import SceneBuilder
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

RECORDED_COLUMNS = (*QUATERNION_COLUMNS, "rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
"""Columns of ``sequence.recording``: quaternion ICRS to camera and inertial rate in camera axes."""
_SAME_TIME_S = 1e-6


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
