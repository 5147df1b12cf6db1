"""Statistics of a point of a sweep or of a compared run: rates and errors with their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.axes import AXES
from simulator.study.intervals import moment_intervals, plain, wilson_interval
from simulator.study.specification.outcome import identified, outcome_counts
from simulator.study.specification.verdicts import Judgement
from simulator.study.statistics import axis_statistics, median

TRIAL_COLUMNS = (
    "index",
    "status",
    "wrong",
    "stars_matched",
    *(f"error_{axis}_deg" for axis in AXES),
    "render_ms",
    "solve_ms",
)
"""Columns of the trials used by `point_statistics`."""

OUTCOME_COLUMNS = ("misidentified", "inconsistent", "inconsistent_cause", "stars_misidentified", "nees")
"""More of them, of which files of earlier versions have only the last two."""

TIMINGS = ("median_render_ms", "median_solve_ms")
"""Timings, the only statistics that differ between runs of the same point."""


def point_statistics(
    columns: Mapping[str, NDArray[Any]], seed: int, judgement: Judgement | None = None
) -> dict[str, Any]:
    """Rates and errors of a set of trials, by flat names suitable as column names.

    For each axis `mean_deg`, `rms_deg`, `three_sigma_deg` (three times the rms), `p997_deg` (99.7th percentile of the
    magnitude), and the 95 % bootstrap interval of the rms as `rms_low_deg` and `rms_high_deg`. Errors are those of the
    solved trials. The identification rate is the fraction of trials solved with the right stars, with Wilson's 95 %
    interval.

    Parameters
    ----------
    columns : mapping of arrays
        Those of `TRIAL_COLUMNS`, and of `OUTCOME_COLUMNS` as far as there are.
    seed : int
        Seed of the bootstrap.
    judgement : Judgement, optional
        Verdicts on the specification of the trials: adds ``verdict``, and by requirement ``<name>_verdict``.

    Returns
    -------
    dict
        None for statistics that need more trials.
    """
    n = len(columns["index"])
    solved = np.asarray(columns["status"] == "solved", dtype=bool)
    right = int(identified(columns).sum())
    low, high = wilson_interval(right, n)
    found: dict[str, Any] = {
        "trials": n,
        "solved": int(solved.sum()),
        **outcome_counts(columns),
        "identification_rate": right / n if n else None,
        "identification_rate_low": low,
        "identification_rate_high": high,
        "stars_matched_mean": float(np.mean(columns["stars_matched"][solved])) if solved.any() else None,
    }
    errors = np.stack([np.asarray(columns[f"error_{axis}_deg"], dtype=float)[solved] for axis in AXES], axis=1)
    intervals = moment_intervals(errors, seed)["rms"]
    for k, axis in enumerate(AXES):
        e = axis_statistics(errors[:, k])
        low_deg, high_deg = plain(None if intervals is None else intervals[k])
        found |= {
            f"{axis}_mean_deg": e["mean"],
            f"{axis}_rms_deg": e["rms"],
            f"{axis}_rms_low_deg": low_deg,
            f"{axis}_rms_high_deg": high_deg,
            f"{axis}_three_sigma_deg": e["three_sigma"],
            f"{axis}_p997_deg": e["p997"],
        }
    if judgement is not None:
        found["verdict"] = judgement.state
        found |= {f"{each.requirement.name}_verdict": each.verdict for each in judgement.verdicts}
    return found | {name: median(columns[name.removeprefix("median_")]) for name in TIMINGS}
