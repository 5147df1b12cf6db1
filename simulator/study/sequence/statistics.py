"""Statistics of a sequence: availability, modes, accuracy, consistency of the filter; and of each of several heads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from simulator.scenario import Scenario
from simulator.study.axes import AXES, CAMERA_AXES
from simulator.study.intervals import effective_number
from simulator.study.sequence.frames import MODES
from simulator.study.specification.outcome import inconsistency, outcome_counts
from simulator.study.specification.verdicts import Judgement
from simulator.study.statistics import axis_statistics
from startracker.core import Columns, FloatArray


def summarise_sequence(columns: Columns, step_s: float, judgement: Judgement) -> dict[str, Any]:
    """Numbers of ``sequence.json`` from the columns of ``sequence.parquet``.

    A frame represents the step that begins with it: times in modes and outages are numbers of frames times the step.
    Errors are those of the solved frames; comparisons with single frames (``gain``: rms of single frames over rms in
    tracking) use the frames solved both ways.
    """
    n = len(columns["index"])
    error_deg = {axis: np.asarray(columns[f"error_{axis}_deg"], dtype=float) for axis in AXES}
    solved = np.asarray(columns["status"] == "solved", dtype=bool)
    errors = {axis: axis_statistics(values[solved]) for axis, values in error_deg.items()}
    first = int(np.argmax(solved)) if solved.any() else None
    statuses, counts = np.unique(np.asarray(columns["status"][~solved], dtype=str), return_counts=True)
    summary: dict[str, Any] = {
        "frames": n,
        "step_s": step_s,
        "duration_s": n * step_s,
        "solved": int(solved.sum()),
        "availability": float(solved.mean()),
        "unsolved_by_status": {str(s): int(c) for s, c in zip(statuses, counts, strict=True)},
        "time_in_mode_s": {mode: float(np.sum(columns["mode"] == mode)) * step_s for mode in MODES},
        "first_solution_s": None if first is None else first * step_s,
        "longest_outage_s": longest_run(~solved) * step_s,
        **outcome_counts(columns),
        "inconsistency": inconsistency(columns),
        "beyond_specification": int(np.sum(columns["beyond_specification"]))
        if "beyond_specification" in columns
        else 0,
        "stars_misidentified": int(np.sum(columns["stars_misidentified"])),
        "restarts": int(np.sum(columns["restarted"])),
        "stars_matched_mean": float(np.mean(columns["stars_matched"][solved])) if solved.any() else None,
        "errors_deg": errors,
        "specification": judgement.by_name({axis: errors[axis]["three_sigma"] for axis in AXES}),
        "verdict": judgement.to_dict(),
        "rate_rms_deg_s": {
            axis: _rms((columns[f"rate_{axis}_deg_s"] - columns[f"true_rate_{axis}_deg_s"])[solved]) for axis in "xyz"
        },
        "nees": nees_test(np.asarray(columns["nees"], dtype=float)[solved]),
    }
    if "true_bias_x_deg_h" in columns:
        summary["bias_error_deg_h"] = {
            axis: _finite(columns[f"bias_{axis}_deg_h"][-1] - columns[f"true_bias_{axis}_deg_h"][-1]) for axis in "xyz"
        }
    if "true_scale_x_ppm" in columns:
        summary["scale_error_ppm"] = {
            axis: _finite(columns[f"scale_{axis}_ppm"][-1] - columns[f"true_scale_{axis}_ppm"][-1]) for axis in "xyz"
        }
    if "single_status" in columns:
        alone = np.asarray(columns["single_status"] == "solved", dtype=bool)
        both = alone & solved
        single = {axis: np.asarray(columns[f"single_error_{axis}_deg"], dtype=float) for axis in AXES}
        gain = {}
        for axis in AXES:
            rms, rms_alone = _rms(error_deg[axis][both]), _rms(single[axis][both])
            gain[axis] = rms_alone / rms if rms and rms_alone is not None else None
        summary["single"] = {
            "solved": int(alone.sum()),
            "availability": float(alone.mean()),
            **outcome_counts(columns, "single_"),
            "errors_deg": {axis: axis_statistics(single[axis][alone]) for axis in AXES},
            "gain": gain,
        }
    return summary


def longest_run(mask: NDArray[np.bool_]) -> int:
    """Length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def nees_test(nees: FloatArray, independent: float | None = None) -> dict[str, Any]:
    """Mean of the normalised estimation error squared and its 95 % bounds.

    e P⁻¹ e of a consistent filter is χ² of 3 degrees of freedom; the mean of N independent ones is χ²(3 N)/N
    (Bar-Shalom, Li & Kirubarajan 2001, *Estimation with Applications to Tracking and Navigation*, section 5.4).
    Successive errors of a filter are correlated; N is the effective number, `independent` if it is given.
    """
    nees = nees[np.isfinite(nees)]
    if not len(nees):
        return {"mean": None, "effective_frames": 0.0, "bounds95": None, "within": None}
    n = effective_number(nees) if independent is None else independent
    low, high = (float(chdtri(3 * n, p)) / n for p in (0.975, 0.025))
    mean = float(nees.mean())
    return {"mean": mean, "effective_frames": n, "bounds95": [low, high], "within": low <= mean <= high}


def _rms(values: NDArray[Any]) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


OUTCOMES = ("started", "used", "rejected", "realigned", "restarted", "too_late")
"""What an attitude did to the filter."""


def fused_nees(columns: Columns) -> dict[str, Any]:
    """`nees_test` of the fused attitude.

    Errors of alignments and of the gyro are constant through much of a sequence, which the scatter of the NEES does not
    show. The effective number is therefore that of the errors u, normalised by their standard deviations, whose mean
    is known to be zero: with ρ_k their autocorrelation, squares of Gaussian deviates have ρ_k², and N = n / (1 + 2 Σ
    ρ_k²), summed while pairs of ρ_k stay positive (Geyer 1992, Statistical Science 7, 473). The sum of all ρ_k² is at
    most n (Young's inequality), so that N is at least 1.
    """
    solved = np.asarray(columns["status"] == "solved", dtype=bool) & np.isfinite(columns["nees"])
    u = np.stack([(columns[f"error_{axis}_deg"] / columns[f"sigma_{axis}_deg"])[solved] for axis in CAMERA_AXES])
    n = u.shape[1]
    products = [float(np.sum(u[:, k:] * u[:, : n - k])) for k in range(n)]
    total = 1.0
    for k in range(1, n - 1, 2):
        if products[k] + products[k + 1] <= 0.0:
            break
        total += 2.0 * (products[k] ** 2 + products[k + 1] ** 2) / products[0] ** 2
    return nees_test(np.asarray(columns["nees"], dtype=float)[solved], n / total)


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
    agreement = np.asarray(columns[f"{prefix}agreement"], dtype=str)
    summary: dict[str, Any] = {
        "solved": int(solved.sum()),
        "availability": float(solved.mean()),
        "unsolved_by_status": {str(s): int(c) for s, c in zip(statuses, counts, strict=True)},
        "longest_outage_s": longest_run(~solved) * step_s,
        **outcome_counts(columns, prefix),
        "stars_misidentified": int(np.sum(columns[f"{prefix}stars_misidentified"])),
        "stars_matched_mean": float(np.mean(columns[f"{prefix}stars_matched"][solved])) if solved.any() else None,
        "agreement": {str(s): int(c) for s, c in zip(*np.unique(agreement, return_counts=True), strict=True)},
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


def consistency_text(nees: Mapping[str, Any]) -> str:
    """Whether the stated covariance is consistent with the errors, from ``nees`` of ``sequence.json``; empty without a
    solved frame."""
    if nees["mean"] is None:
        return ""
    low, high = nees["bounds95"]
    finding = "is consistent with the errors"
    if not nees["within"]:
        finding = "is too small" if nees["mean"] > 3 else "is too large"
    return (
        f"NEES {nees['mean']:.2f} (expected 3; 95 % band for a consistent covariance {low:.2f} to {high:.2f}): "
        f"the stated covariance {finding}."
    )
