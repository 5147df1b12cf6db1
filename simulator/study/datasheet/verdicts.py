"""Verdict on the specification, by the same function as every other study."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.scenario import Scenario
from simulator.study.datasheet.tasks import Columns
from simulator.study.statistics import BODY_AXES, axis_statistics, error_intervals
from simulator.study.verdict import Verdict, overall_verdict

__all__ = ["verdicts"]


def verdicts(scenario: Scenario, columns: Columns) -> dict[str, Any]:
    """Verdict on each axis and on all together, from the trials."""
    errors = {axis: columns[f"error_{axis}_deg"][columns["solved"]] for axis in BODY_AXES}
    intervals = error_intervals(errors, scenario.seed)
    judged = {}
    for axis, values in errors.items():
        statistics = axis_statistics(values)
        specified = getattr(scenario.specification, f"{axis}_deg")
        verdict = Verdict(axis, statistics["p997"], intervals[axis]["p997_interval95"], specified)
        judged[axis] = verdict.to_dict(statistics["three_sigma"])
    wrong = int(np.sum(columns["wrong"]))
    overall = overall_verdict((found["verdict"] for found in judged.values()), wrong)
    return {"verdict": overall, "wrong": wrong, "trials": len(columns["wrong"]), "axes": judged}
