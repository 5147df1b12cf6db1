"""Statistics of the heads of a sequence: each alone, its attitudes in the filter, and its alignment."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.scenario import Scenario
from simulator.study.sequence.statistics import longest_run, nees_test
from simulator.study.statistics import AXES, CAMERA_AXES, axis_statistics
from startracker.arrays import Columns

OUTCOMES = ("started", "used", "rejected", "restarted", "too_late")
"""What an attitude did to the filter."""


def fused_nees(columns: Columns) -> dict[str, Any]:
    """`nees_test` of the fused attitude.

    Errors of alignments and of the gyro are constant through much of a sequence, which the scatter of the NEES does not
    show. The effective number is therefore that of the errors u, normalised by their standard deviations, whose mean
    is known to be zero: with ρ_k their autocorrelation, squares of Gaussian deviates have ρ_k², and N = n / (1 + 2 Σ
    ρ_k²), summed while pairs of ρ_k stay positive (Geyer 1992, Statistical Science 7, 473).
    """
    solved = np.asarray(columns["status"] == "solved", dtype=bool) & np.isfinite(columns["nees"])
    if solved.sum() < 2:
        return nees_test(columns["nees"][solved])
    u = np.stack([(columns[f"error_{axis}_deg"] / columns[f"sigma_{axis}_deg"])[solved] for axis in CAMERA_AXES])
    n = u.shape[1]
    products = [float(np.sum(u[:, k:] * u[:, : n - k])) for k in range(n)]
    total = 1.0
    for k in range(1, n - 1, 2):
        if products[k] + products[k + 1] <= 0.0:
            break
        total += 2.0 * (products[k] ** 2 + products[k + 1] ** 2) / products[0] ** 2
    return nees_test(np.asarray(columns["nees"], dtype=float)[solved], max(n / total, 1.0))


def summarise_heads(columns: Columns, scenario: Scenario) -> dict[str, Any]:
    """``heads`` of ``sequence.json``: numbers of each head by its name.

    Errors are those of its solved frames, each from the stars of that frame alone, about the axes of the body and of
    its own camera. ``filter`` counts what its attitudes did; those still on their way at the end are not in it.
    """
    return {head.name: _summary(columns, f"head_{head.name}_", scenario.sequence.step_s) for head in scenario.heads}


def _summary(columns: Columns, prefix: str, step_s: float) -> dict[str, Any]:
    status = columns[f"{prefix}status"]
    solved = np.asarray(status == "solved", dtype=bool)
    statuses, counts = np.unique(np.asarray(status[~solved], dtype=str), return_counts=True)
    update = columns[f"{prefix}update"]
    summary: dict[str, Any] = {
        "solved": int(solved.sum()),
        "availability": float(solved.mean()),
        "unsolved_by_status": {str(s): int(c) for s, c in zip(statuses, counts, strict=True)},
        "longest_outage_s": longest_run(~solved) * step_s,
        "wrong": int(np.sum(columns[f"{prefix}wrong"])),
        "stars_misidentified": int(np.sum(columns[f"{prefix}stars_misidentified"])),
        "stars_matched_mean": float(np.mean(columns[f"{prefix}stars_matched"][solved])) if solved.any() else None,
        "filter": {outcome: int(np.sum(update == outcome)) for outcome in OUTCOMES},
        "errors_deg": {
            axis: axis_statistics(np.asarray(columns[f"{prefix}error_{axis}_deg"], dtype=float)[solved])
            for axis in AXES
        },
        "nees": nees_test(np.asarray(columns[f"{prefix}nees"], dtype=float)[solved]),
    }
    if f"{prefix}alignment_x_arcsec" in columns:
        summary["alignment_arcsec"] = {
            axis: {
                "true": float(columns[f"{prefix}true_alignment_{axis}_arcsec"][-1]),
                "estimated": _finite(columns[f"{prefix}alignment_{axis}_arcsec"][-1]),
                "sigma": _finite(columns[f"{prefix}sigma_alignment_{axis}_arcsec"][-1]),
            }
            for axis in "xyz"
        }
    return summary


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
