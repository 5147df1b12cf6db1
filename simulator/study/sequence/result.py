"""The result of a sequence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.study.data_frames import Rows
from simulator.study.specification.measured import judge_frames
from simulator.study.specification.verdicts import Judgement
from simulator.study.trials.arrow import as_array
from startracker._version import __version__
from startracker.display import described


@dataclass(frozen=True, eq=False)
class Sequence(Rows):
    """Result of a sequence."""

    scenario: Scenario
    """The scenario."""
    frames: pa.Table
    """One row per frame."""
    summary: dict[str, Any]
    """What ``sequence.json`` holds."""
    folder: Path | None = None
    """Folder of the files."""
    files: tuple[str, ...] = ()
    """Names of the files."""

    def _table(self) -> pa.Table:
        return self.frames

    def _meta(self) -> dict[str, Any]:
        return {"name": self.scenario.name, "seed": self.scenario.seed, "version": __version__}

    def __repr__(self) -> str:
        solved = int(np.count_nonzero(as_array(self.frames["status"]) == "solved"))
        counts = f"{self.frames.num_rows} frames, {solved} solved"
        return described("Sequence", self.scenario.name, counts, str(self.folder or ""))

    @cached_property
    def judgement(self) -> Judgement:
        """Verdicts on the scenario's specification, with the effective number of independent frames."""
        return judge_frames(self.scenario, self.columns, self.scenario.sequence.step_s)

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Columns of the frames as arrays."""
        return {name: as_array(self.frames[name]) for name in self.frames.column_names}
