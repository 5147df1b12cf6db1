"""A recording of a live mission: a scenario and a table of its motion, which ``boresight run --sequence`` reads.

The recorded sequence begins like any other: with frame 0, a tracker without an attitude, and its own jitter. Its
scenario names the table as ``sequence.recording``; the table is also one of ``pointing.attitude``.
"""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import numpy as np

from simulator.mission.motion import MotionState
from simulator.mission.parameters import Slew
from simulator.paths import make_folder, write_atomically
from simulator.scenario import Scenario
from simulator.scenario.schema_sequence import DropoutSection
from simulator.scenario.sequence_rules import MOST_FRAMES
from simulator.study.process_noise import process_noise
from simulator.study.sequence.true_motion import RECORDED_COLUMNS
from startracker._version import __version__
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, RateNoise

__all__ = ["Recording"]

_TABLE = "attitudes.csv"
_WIDTH = 7


class Recording:
    """Motion of a live mission from the beginning of a recording to its end.

    Parameters
    ----------
    scenario : Scenario
        The scenario with its present values.
    noise : RateNoise
        Process noise of the mission's filter.
    """

    def __init__(self, scenario: Scenario, noise: GyroNoise | RateNoise) -> None:
        walk = math.degrees(noise.acceleration)
        self._scenario = scenario.changed({"sequence.rate_walk_deg_s_sqrt_s": walk, "tracker.prior": False})
        self.noise = process_noise(self._scenario.sequence, [], [], scenario.detector.exposure_s)
        """The same process noise, as it is read from the recorded scenario."""
        self._values, self._missing = array("d"), array("b")
        self.scenario: Scenario | None = None
        """The recorded scenario, after `end`."""
        self._start_s = self._step_s = 0.0

    def __len__(self) -> int:
        return len(self._missing)

    @property
    def is_full(self) -> bool:
        """Whether a sequence has no more frames."""
        return len(self) >= MOST_FRAMES

    @staticmethod
    def exact(state: MotionState) -> MotionState:
        """A state as it is read from the table: a quaternion that was normalised once more."""
        return MotionState(state.t_s, Attitude(state.camera.quat.copy()), state.rate_camera_rad_s)

    def add(self, state: MotionState, missing: bool) -> None:
        """Add a frame's state, from `exact`."""
        self._values.extend([*state.camera.quat.tolist(), *state.rate_camera_rad_s.tolist()])
        self._missing.append(missing)

    def end(self, start_s: float, step_s: float) -> None:
        """End with the time of the first frame and the time between frames."""
        self._start_s, self._step_s = start_s, step_s
        values = {
            "sequence.recording": _TABLE,
            "sequence.frames": max(len(self), 1),
            "sequence.step_s": step_s,
            "sequence.start_s": start_s,
            "sequence.rates": (),
            "sequence.slew": Slew(),
            "sequence.dropouts": self._dropouts(),
        }
        files = {key: str(file.resolve()) for key, file in self._scenario.files().items()}
        self.scenario = self._scenario.changed(values | files)

    def _dropouts(self) -> tuple[DropoutSection, ...]:
        """Intervals of the missing frames, whose ends lie between frames."""
        flags = np.diff(np.concatenate([[0], np.array(self._missing, np.int8), [0]]))
        begins, ends = np.flatnonzero(flags == 1), np.flatnonzero(flags == -1)
        gaps = []
        for first, beyond in zip(begins.tolist(), ends.tolist(), strict=True):
            start_s = max(first - 0.5, 0.0) * self._step_s
            gaps.append(DropoutSection(start_s=start_s, duration_s=(beyond - 0.5) * self._step_s - start_s))
        return tuple(gaps)

    def write(self, folder: Path) -> None:
        """Write ``scenario.yaml`` and the table to a folder, after `end`."""
        assert self.scenario is not None
        make_folder(folder)
        rows = np.reshape(self._values, (-1, _WIDTH)).tolist()
        lines = [",".join(("t_s", *RECORDED_COLUMNS))]
        for k, row in enumerate(rows):
            lines.append(",".join(map(repr, (self._start_s + k * self._step_s, *row))))
        write_atomically(folder / _TABLE, ("\n".join(lines) + "\n").encode())
        heading = (
            f"# Recorded by boresight serve, boresight {__version__}; replay: boresight run scenario.yaml --sequence\n"
        )
        write_atomically(folder / "scenario.yaml", (heading + self.scenario.to_yaml()).encode())
