"""A mission that is stepped: one scenario, frame by frame, without a clock and without I/O."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from simulator.checks import as_scenario
from simulator.environment.transients import Transients
from simulator.live.answers import Parameter
from simulator.live.motion import Given, ScenarioMotion, turned_on
from simulator.live.parameters import RATE_PATHS, ParameterTable
from simulator.live.protocol import Refused
from simulator.live.recording import Recording
from simulator.mission.epochs import elapsed_s
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.process_noise import process_noise
from simulator.study.sequence.camera import Moment, SequenceCamera, TrackedFrame
from simulator.study.sequence.true_motion import jitter_at, start_pointing, states_at
from startracker.display import fields_repr
from startracker.errors import BoresightError, InputError
from startracker.tracking import GyroNoise, RateNoise

__all__ = ["LiveFrame", "LiveMission"]

_PLANNED_FRAMES = 64
"""Frames whose ephemerides are computed together."""
_SCAN_STEP_S, _SCAN_S = 30.0, 2.0 * 86_400.0
_GRID_S = 1e-6
"""Times in lockstep within this of a recording's steps are on them."""
_FOLLOWS_S = 10.0
"""Attitudes that are farther ahead of the mission's time move it."""
_SAA_SHARE = 0.1
"""A pass begins where the flux of trapped protons exceeds this share of its maximum over the next two days."""


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """One frame of a live mission."""

    index: int
    """Number since the start."""
    moment: Moment
    """The camera at its time."""
    tracked: TrackedFrame
    """Frame, solution, truth and row."""
    blinded: bool
    """Whether the camera was covered."""
    renderer: Renderer
    """The renderer that made it."""

    __repr__ = fields_repr


class LiveMission:
    """One camera of a scenario, stepped.

    Along the scenario's own motion its rows are the same, bit for bit, as those of ``boresight run --sequence``, and
    continue beyond its frames. Not safe for several threads: one thread owns it.

    Parameters
    ----------
    scenario : Scenario or path
        The scenario, with its ``sequence`` section, or the name of an included one or of a file.

    Raises
    ------
    InputError
        For several heads or a gyro, which live missions do not have, or invalid names or files in the scenario.
    """

    def __init__(self, scenario: Scenario | str | os.PathLike[str]) -> None:
        scenario = as_scenario(scenario)
        for path, used in (("heads", bool(scenario.heads)), ("sequence.gyro.use", scenario.sequence.gyro.use)):
            if used:
                raise InputError(f"{path}: a live mission has one camera and no gyro; use boresight run --sequence")
        self.scenario = scenario
        self.renderer = Renderer(scenario)
        self.start = start_pointing(scenario, self.renderer)
        self.camera = SequenceCamera(scenario, self.renderer, self.start)
        self.motion = ScenarioMotion(scenario, self.renderer.scenes, self.start)
        self.table = ParameterTable(self.renderer)
        self.index, self.t_s = -1, scenario.sequence.start_s
        """Number and time of the last frame; before the first, the time of the first."""
        self.blinded = False
        """Whether the camera is covered."""
        self.external = False
        """Whether attitudes come from outside."""
        self.recording: Recording | None = None
        self._noise_index = 0
        self._noise = self._scenario_noise()
        self._restart(scenario.sequence.start_s, scenario.sequence.step_s)
        self.camera.begin(self._noise, self.start.prior)

    def _scenario_noise(self) -> GyroNoise | RateNoise:
        """Process noise of the filter: that of the scenario's sequence."""
        section, scenes = self.scenario.sequence, self.renderer.scenes
        since_s = [k * section.step_s for k in range(section.frames)]
        states = states_at(self.scenario, scenes, self.start, since_s)
        scenes.plan([state.t_s for state in states])
        states = [self.motion.on_mounting(state)[0] for state in states]
        shaking = jitter_at(self.scenario, scenes, since_s)
        return process_noise(section, states, shaking, self.renderer.exposure_s)

    # ------------------------------------------------------------------ time
    def _restart(self, zero_s: float, step_s: float) -> None:
        """Begin the mission's times and its jitter at a time after the epoch."""
        self._zero_s, self._step_s, self._frames = zero_s, step_s, 0
        self._offset_s = zero_s - self.scenario.sequence.start_s
        self._last_s = -math.inf
        self._planned: set[float] = set()
        path = self.renderer.scenes.sequence_jitter(stream(self.scenario.seed, "jitter", 0), zero_s)
        self._jitter = path

    @property
    def step_s(self) -> float:
        """Time between frames."""
        return self._step_s

    def time_of(self, iso: str) -> float:
        """Seconds after the epoch of a date; `InputError` if it is not one."""
        return float(elapsed_s(self.renderer.scenes.clock, [iso], "UTC", ["time"])[0])

    def isot(self, t_s: float) -> str:
        """UTC, ISO 8601."""
        return self.renderer.scenes.clock.isot(t_s)

    def _plan(self, t_s: float, first: int) -> None:
        """Compute the ephemerides of a time, and of the following frames from number `first` on."""
        if t_s in self._planned:
            return
        times = [self._zero_s + k * self._step_s for k in range(first, first + _PLANNED_FRAMES)]
        times = times if t_s in times else [t_s]
        try:
            self.renderer.scenes.plan(times)
        except BoresightError:  # the end of an ephemeris is near
            times = [t_s]
            self.renderer.scenes.plan(times)
        self._planned = set(times)

    def _in_dropout(self, since_s: float) -> bool:
        gaps = self.scenario.sequence.dropouts
        return any(gap.start_s <= since_s < gap.start_s + gap.duration_s for gap in gaps)

    # ------------------------------------------------------------------ frames
    def step(self, given: Given | None = None, *, lockstep: bool = False) -> LiveFrame:
        """The next frame.

        Parameters
        ----------
        given : Given, optional
            Attitude from outside, instead of the scenario's.
        lockstep : bool
            The frame is at the time of `given`, instead of the mission's next time.

        Raises
        ------
        Refused
            In lockstep, if the time is not after that of the last frame, or not on the steps of a recording.
        BoresightError
            If the frame cannot be made, for example beyond the end of an ephemeris; the mission is unchanged.
        """
        if given is not None and not lockstep:
            self._follow(given)
        since_s = self._frames * self._step_s
        if given is not None and lockstep:
            since_s = self._lockstep_since_s(given.t_s)
        t_s = self._zero_s + since_s
        self._plan(t_s, self._frames)
        if given is None:
            at_step = replace(self.motion.at(self._offset_s + since_s), t_s=t_s)
            state, rotation_rad = self.motion.on_mounting(at_step)
        else:
            state, rotation_rad = turned_on(given.state, t_s), self.renderer.scenes.mounting_rotation_rad(t_s)
        missing = self.blinded or self._in_dropout(self._offset_s + since_s)
        if self.recording is not None:
            state = self.recording.exact(state)
        jitter = None if self._jitter is None else self._jitter.shifted(since_s)
        moment = Moment(self._noise_index, since_s, state, rotation_rad, jitter, missing=missing)
        tracked = self.camera.take(moment)
        if self.recording is not None:
            self.recording.add(state, missing)
        self.index, self.t_s, self._last_s = self.index + 1, t_s, t_s
        self._noise_index, self._frames = self._noise_index + 1, self._frames + 1
        return LiveFrame(self.index, moment, tracked, self.blinded, self.renderer)

    def _follow(self, given: Given) -> None:
        """Move the mission's time to that of the first attitude, and of one that is far ahead."""
        ahead_s = given.t_s - self._zero_s - self._frames * self._step_s
        if self._frames == 0 or (ahead_s > _FOLLOWS_S and self.recording is None):
            self._restart(given.t_s, self._step_s)
            self.camera.begin(self.camera.session.noise, None)

    def _lockstep_since_s(self, t_s: float) -> float:
        """Time of a frame in lockstep after the first one."""
        if self._frames == 0:
            self._restart(t_s, self._step_s)
            return 0.0
        if t_s <= self._last_s:
            raise Refused("state", f"t_s: {t_s:.9g} s is not after {self._last_s:.9g} s, the time of the last frame")
        if self.recording is None:
            return t_s - self._zero_s
        if self._frames == 1:
            self._step_s = t_s - self._zero_s
        since_s = self._frames * self._step_s
        if abs(self._zero_s + since_s - t_s) > _GRID_S:
            raise Refused("state", f"t_s: {t_s:.9g} s is not on the recording's steps of {self._step_s:.9g} s; "
                          f"the next is {self._zero_s + since_s:.9g} s, or end the recording")  # fmt: skip
        return since_s

    # ------------------------------------------------------------------ what a client may do
    def parameters(self) -> list[Parameter]:
        """What may be changed, with ranges and present values."""
        return self.table.described(self.renderer, self.motion.rate_deg_s)

    def values(self) -> dict[str, float]:
        """Present values of the parameters by path."""
        return self.table.values(self.renderer, self.motion.rate_deg_s)

    def set(self, values: Mapping[str, float]) -> None:
        """Change parameters from the next frame on; `Refused` with the reason if one is not valid: nothing changes."""
        for path, value in values.items():
            self.table.check(path, value)
        ours = {path: value for path, value in values.items() if path not in RATE_PATHS}
        rates = {path: value for path, value in values.items() if path in RATE_PATHS}
        if rates and self.external:
            raise Refused("state", f"{next(iter(rates))}: the motion comes from outside")
        if ours and self.recording is not None:
            raise Refused("state", f"{next(iter(ours))}: a recording has one camera; end it first")
        if ours:
            try:
                renderer = self.renderer.changed(self.table.changes(self.renderer, ours))
            except (BoresightError, ValueError) as error:  # pydantic's errors are ValueErrors
                raise Refused("invalid", _reason(error)) from None
            self._use(renderer)
        if rates:
            now = self.motion.rate_deg_s
            self.motion.add_rate(np.array([rates.get(p, v) - v for p, v in zip(RATE_PATHS, now, strict=True)]))

    def _use(self, renderer: Renderer) -> None:
        self.renderer, self.scenario = renderer, renderer.scenario
        self.camera.use(renderer)

    def kick(self, rate_deg_s: tuple[float, float, float]) -> None:
        """Add a rate to the body's, body axes, °/s."""
        if self.external:
            raise Refused("state", "kick: the motion comes from outside")
        self.motion.add_rate(np.array(rate_deg_s))

    def seek(self, t_s: float) -> None:
        """Jump to a time, seconds after the epoch: the next frame is there, and the tracker starts again."""
        start_s = self.scenario.sequence.start_s
        if self.external:
            raise Refused("state", "seek: the times come from outside")
        if self.recording is not None:
            raise Refused("state", "seek: end the recording first")
        if t_s < start_s:
            raise Refused("invalid", f"t_s: {t_s:.9g} s is before the first frame at {start_s:.9g} s")
        try:
            self.renderer.scenes.instant_at(t_s)
            self.motion.jump(t_s - start_s)
        except BoresightError as error:
            raise Refused("invalid", f"t_s: {_reason(error)}") from None
        self._restart(t_s, self._step_s)
        self.t_s = t_s
        self.camera.begin(self._noise, None)

    def use_source(self, *, external: bool) -> None:
        """Take attitudes from outside, or from the scenario at the time of the last frame; the tracker starts again."""
        if self.recording is not None:
            raise Refused("state", "source: end the recording first")
        if external == self.external:
            return
        self.external = external
        if not external:
            self.seek(max(self.t_s + self._step_s, self.scenario.sequence.start_s))
        else:
            self._restart(self.t_s, self._step_s)
            self.camera.begin(self._noise, None)

    def next_anomaly_s(self) -> float:
        """Start of the next pass through the South Atlantic Anomaly, seconds after the epoch.

        Where the flux of trapped protons behind the scenario's shield (AP-8) rises above a tenth of its maximum over
        the next two days.
        """
        if find_spec("aep8") is None:
            raise Refused(
                "state", "saa: needs the package of the trapped particles: pip install 'boresight[environment]'"
            )
        scenes = self.renderer.scenes
        times = np.arange(self.t_s, min(self.t_s + _SCAN_S, scenes.span_s[1]), _SCAN_STEP_S)
        if self.external:
            raise Refused("state", "saa: the times come from outside")
        try:
            environment = replace(self.scenario.environment, trapped="ap8")
            r_km = np.array([scenes.orbit.state(t)[0] for t in times.tolist()])
            flux = Transients(environment, scenes.clock).flux(times, r_km).trapped_protons.sum(axis=1)
        except BoresightError as error:
            raise Refused("state", f"saa: {_reason(error)}") from None
        inside = flux > _SAA_SHARE * flux.max(initial=0.0)
        begins = np.flatnonzero(inside[1:] & ~inside[:-1])
        if not len(begins):
            raise Refused("state", "saa: no pass through the anomaly within two days on this orbit")
        return float(times[begins[0] + 1])

    def seek_anomaly(self) -> float:
        """Jump to the next pass through the South Atlantic Anomaly, with trapped particles; returns its time."""
        t_s = self.next_anomaly_s()
        self.seek(t_s)
        environment = self.scenario.environment
        if environment.trapped == "none" or not environment.transients:
            self._use(self.renderer.changed({"environment.trapped": "ap8", "environment.transients": True}))
        return t_s

    # ------------------------------------------------------------------ recording
    def record(self) -> None:
        """Begin a recording with the next frame: the tracker, the noise and the jitter start again, as in ``run``."""
        if self.recording is not None:
            raise Refused("state", "record: there is a recording; end it first")
        following_s = self.t_s if self.index < 0 else self._zero_s + self._frames * self._step_s
        self.recording = Recording(self.scenario, self._noise)
        self._restart(following_s, self._step_s)
        self._noise_index = 0
        self.camera.begin(self.recording.noise, None)

    def stop_recording(self) -> Recording:
        """End the recording and return it."""
        if self.recording is None:
            raise Refused("state", "stop_recording: there is no recording")
        recording, self.recording = self.recording, None
        recording.end(self._zero_s, self._step_s)
        return recording


def _reason(error: Exception) -> str:
    """Reason of an invalid scenario without pydantic's heading."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    causes = [line for line in lines if line.startswith("Value error, ")]
    return (causes[0].removeprefix("Value error, ") if causes else lines[0]).partition(" [type=")[0]
