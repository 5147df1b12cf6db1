"""Statistics of a study: rates with their intervals, errors about every axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

BODY_AXES = ("roll", "pitch", "yaw")
CAMERA_AXES = ("cross_x", "cross_y", "about_boresight")
AXES = BODY_AXES + CAMERA_AXES

WRONG_FACTOR = 10.0
"""An accepted attitude is wrong when its error about any body axis exceeds the specification this many times."""

FloatArray = NDArray[np.float64]


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval of a proportion (Wilson 1927, J. Am. Stat. Assoc. 22, 209); (0, 1) for no trials.

    Right near 0 and 1, where the normal approximation gives intervals of no width.
    """
    if trials == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    p = successes / trials
    middle = (p + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    # at the ends the two terms are equal; their difference would leave rounding behind
    return (0.0 if successes == 0 else middle - half), (1.0 if successes == trials else middle + half)


def axis_statistics(errors_deg: FloatArray) -> dict[str, float | None]:
    """Mean, standard deviation (n − 1), rms, and the percentiles of the magnitude of one axis' errors, degrees.

    ``p997`` is the magnitude that 99.7 % of the errors stay below, ``three_sigma`` three times the rms: the two meet
    for a normal distribution about zero. None where there are too few errors.
    """
    n = len(errors_deg)
    if n == 0:
        return dict.fromkeys(("mean", "std", "rms", "three_sigma", "p50", "p95", "p997", "max"))
    magnitude = np.abs(errors_deg)
    p50, p95, p997 = (float(v) for v in np.percentile(magnitude, [50, 95, 99.7]))
    rms = math.sqrt(float(np.mean(errors_deg**2)))
    return {
        "mean": float(np.mean(errors_deg)),
        "std": float(np.std(errors_deg, ddof=1)) if n > 1 else None,
        "rms": rms,
        "three_sigma": 3 * rms,
        "p50": p50,
        "p95": p95,
        "p997": p997,
        "max": float(magnitude.max()),
    }


@dataclass(frozen=True)
class Verdict:
    """One axis against its specification: 3σ (three times the rms) and what was asked for, degrees."""

    axis: str
    three_sigma_deg: float | None
    specified_deg: float

    @property
    def met(self) -> bool:
        """Whether the specification holds; nothing solved is not met."""
        return self.three_sigma_deg is not None and self.three_sigma_deg <= self.specified_deg


def summarise(columns: dict[str, NDArray[Any]], specification: dict[str, float]) -> dict[str, Any]:
    """Numbers of ``summary.json`` from the columns of the trials.

    Parameters
    ----------
    columns : dict of arrays
        As in ``trials.parquet``.
    specification : dict
        Degrees for roll, pitch and yaw.
    """
    n = len(columns["index"])
    solved = np.asarray(columns["status"] == "solved", dtype=bool)
    wrong = np.asarray(columns["wrong"], dtype=bool)
    right = int(np.sum(solved & ~wrong))
    errors = {axis: axis_statistics(np.asarray(columns[f"error_{axis}_deg"], dtype=float)[solved]) for axis in AXES}
    verdicts = [Verdict(axis, errors[axis]["three_sigma"], specification[axis]) for axis in BODY_AXES]
    reasons: dict[str, int] = {}
    for status in columns["status"][~solved]:
        reasons[str(status)] = reasons.get(str(status), 0) + 1
    return {
        "trials": n,
        "solved": int(solved.sum()),
        "unsolved": int(n - solved.sum()),
        "unsolved_by_status": dict(sorted(reasons.items())),
        "wrong": int(wrong.sum()),
        "identification_rate": right / n if n else None,
        "identification_rate_interval95": list(wilson_interval(right, n)),
        "wrong_rate_interval95": list(wilson_interval(int(wrong.sum()), n)),
        "errors_deg": errors,
        "specification": {
            v.axis: {"specified_deg": v.specified_deg, "three_sigma_deg": v.three_sigma_deg, "met": v.met}
            for v in verdicts
        },
        "stars_matched_mean": float(np.mean(columns["stars_matched"][solved])) if solved.any() else None,
        "stars_misidentified": int(np.sum(columns["stars_misidentified"])),
    }


def deg_text(value_deg: float | None) -> str:
    """Angle for people: degrees, and arcseconds where these read better."""
    if value_deg is None or not math.isfinite(value_deg):
        return "–"
    return f"{value_deg:.4f}°" if abs(value_deg) >= 0.1 else f"{value_deg * 3600:.2f}″"
