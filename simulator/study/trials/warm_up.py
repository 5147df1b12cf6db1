"""Compilation before worker processes start: once, instead of in each of them."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from startracker._compiled import is_on_disk
from startracker.errors import BoresightError

if TYPE_CHECKING:
    from simulator.scenario import Scenario


def warm_up(scenario: Scenario) -> None:
    """Compile the kernels needed by the trials of a scenario, and its flight build, unless compiled earlier."""
    from simulator.study.trials.bounds import fill_fisher
    from simulator.study.trials.trial import TrialRunner

    compiled = is_on_disk(fill_fisher)  # the last kernel of a trial
    if compiled and scenario.tracker.engine == "reference":
        return
    runner = TrialRunner(scenario)
    if not compiled:
        with contextlib.suppress(BoresightError):  # errors are reported by the trials themselves
            runner.run(0)
