"""Statistics of a study: rates with their intervals, errors about each axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.study.axes import AXES, CAMERA_AXES
from simulator.study.intervals import (
    mean_chi_square_bounds,
    moment_intervals,
    percentile_interval,
    plain,
    ratios_of_rms,
    spread_interval,
    wilson_interval,
)
from simulator.study.specification.outcome import identified, inconsistency, outcome_counts, outcome_flags
from simulator.study.specification.requirements import Specification
from simulator.study.specification.verdicts import Judgement
from startracker.core import FloatArray

BEYOND_FACTOR = 10.0
"""An error that exceeds the specification this many times is counted as beyond the specification."""

PERCENTILES = {"p50": 50.0, "p95": 95.0, "p997": 99.7}
"""Percentiles of an error's magnitude."""

OUTLIER_SIGMAS = 5.0
"""Number of robust standard deviations of all errors about an axis beyond which an error is an outlier."""

MOST_OUTLIERS_LISTED = 200
"""Maximum number of outliers listed in ``summary.json``; others are counted, and all are in ``trials.parquet``."""

_MAD_TO_SIGMA = 1.482602218505602

Columns = Mapping[str, NDArray[Any]]


def axis_statistics(errors_deg: FloatArray) -> dict[str, float | None]:
    """Mean, standard deviation (n − 1), rms, and the percentiles of the magnitude of one axis' errors, degrees.

    ``p997`` is the smallest magnitude that at least 99.7 % of the errors do not exceed, ``three_sigma`` three times the
    rms; both agree for a normal distribution about zero. None for too few errors.
    """
    n = len(errors_deg)
    if n == 0:
        return dict.fromkeys(("mean", "std", "rms", "three_sigma", "p50", "p95", "p997", "max"))
    magnitude = np.abs(errors_deg)
    # an error of the sample, so that it is within its interval between two others
    p50, p95, p997 = np.percentile(magnitude, list(PERCENTILES.values()), method="inverted_cdf").tolist()
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


def median(values: ArrayLike) -> float | None:
    """Median of the finite values; None if there are none."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    return float(np.median(finite)) if len(finite) else None


def beyond_specification(error_deg: Mapping[str, float], specification: Specification) -> bool:
    """Whether an error exceeds `BEYOND_FACTOR` times its specification; errors in degrees by axis."""
    return bool(specification.worst_share(error_deg) > BEYOND_FACTOR)


def error_intervals(errors_deg: dict[str, FloatArray], seed: int = 0) -> dict[str, dict[str, list[float | None]]]:
    """95 % intervals of the values of `axis_statistics`, degrees: by axis, then ``<statistic>_interval95`` with lower
    and upper limit; None for a limit that the trials do not determine.

    Mean, std, rms and three_sigma by the bootstrap (`simulator.study.intervals.moment_intervals`), percentiles by
    order statistics (`percentile_interval`).

    Parameters
    ----------
    errors_deg : dict of (n,) arrays
        By axis, one value per trial.
    seed : int
        Seed of the resampling.
    """
    axes = list(errors_deg)
    moments = moment_intervals(np.stack([errors_deg[axis] for axis in axes], axis=1), seed)
    found: dict[str, dict[str, list[float | None]]] = {}
    for k, axis in enumerate(axes):
        ends = {name: plain(None if interval is None else interval[k]) for name, interval in moments.items()}
        ends["three_sigma"] = [None if v is None else 3 * v for v in ends["rms"]]
        ordered = np.sort(np.abs(errors_deg[axis]))
        ends |= {name: plain(percentile_interval(ordered, percent)) for name, percent in PERCENTILES.items()}
        found[axis] = {f"{name}_interval95": interval for name, interval in ends.items()}
    return found


@dataclass(frozen=True, eq=False)
class Binned:
    """Errors about one axis in bins of another column; arrays with one entry per bin."""

    name: str
    axis: str
    """Names of the column and the axis."""
    edges: FloatArray
    """(bins + 1,): Limits of the bins, ascending; a bin includes its lower limit, the last one also its upper limit."""
    centre: FloatArray
    """Mean of the column over the trials of the bin; the centre of an empty bin."""
    count: NDArray[np.int64]
    """Trials that are solved with the right stars (`simulator.study.specification.outcome.identified`)."""
    trials: NDArray[np.int64]
    """All trials, including unsolved ones for which the column has a value."""
    rms_deg: FloatArray
    """NaN for an empty bin."""
    low_deg: FloatArray
    high_deg: FloatArray
    """Its 95 % interval (`simulator.study.intervals.spread_interval`)."""


def error_against(
    columns: Columns, name: str, bins: int | Sequence[float] | FloatArray = 8, *, axis: str = "cross_x"
) -> Binned:
    """Rms error about an axis against a column: ``stars_matched``, ``limit_mag``, ``orbit_argument_deg``,
    ``galactic_latitude_deg``, ``rate_deg_s``, ``temperature_c``, or any other numerical column.

    Parameters
    ----------
    columns : mapping of arrays
        As in ``trials.parquet``.
    name : str
        The column.
    bins : int or sequence of float
        Number of bins with equal numbers of trials (fewer for repeated values), or their limits.
    axis : str
        One of `AXES`.

    Raises
    ------
    KeyError
        For a missing column.
    """
    value = np.asarray(columns[name], dtype=float)
    error = np.asarray(columns[f"error_{axis}_deg"], dtype=float)
    right = identified(columns) & np.isfinite(error)
    finite = np.isfinite(value)
    if isinstance(bins, int):
        known = value[finite & right] if (finite & right).any() else value[finite]
        edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, bins + 1))) if len(known) else np.array([0.0])
        if len(edges) == 1:  # a single value: a bin around it
            edges = edges[0] + np.array([-0.5, 0.5])
    else:
        edges = np.asarray(bins, dtype=float)
    count = len(edges) - 1
    bin_of = np.searchsorted(edges, value, side="right") - 1
    bin_of = np.where(value == edges[-1], count - 1, bin_of)
    bin_of[~finite | (value < edges[0]) | (value > edges[-1])] = -1
    members = [np.flatnonzero((bin_of == k) & right) for k in range(count)]
    ends = np.array([spread_interval(error[m]) for m in members])
    middle = (edges[1:] + edges[:-1]) / 2.0
    return Binned(
        name,
        axis,
        edges,
        centre=np.array([float(value[m].mean()) if len(m) else middle[k] for k, m in enumerate(members)]),
        count=np.array([len(m) for m in members], dtype=np.int64),
        trials=np.bincount(bin_of[bin_of >= 0], minlength=count).astype(np.int64),
        rms_deg=np.array([math.sqrt(float(np.mean(error[m] ** 2))) if len(m) else math.nan for m in members]),
        low_deg=ends[:, 0],
        high_deg=ends[:, 1],
    )


def against_bound(columns: Columns, seed: int = 0) -> dict[str, Any] | None:
    """Measured errors and Cramér–Rao bound by camera axis: ``trials``, both rms in degrees (``rms_deg``,
    ``bound_rms_deg``), their ``ratio`` and its ``interval95``.

    Over the trials that are solved with the right stars and have a bound; None if there are none or the columns are
    missing.
    """
    if not all(f"bound_{axis}_deg" in columns for axis in CAMERA_AXES):
        return None
    errors = np.stack([np.asarray(columns[f"error_{axis}_deg"], dtype=float) for axis in CAMERA_AXES], axis=1)
    bounds = np.stack([np.asarray(columns[f"bound_{axis}_deg"], dtype=float) for axis in CAMERA_AXES], axis=1)
    use = (
        identified(columns)
        & np.isfinite(errors).all(axis=1)
        & np.isfinite(bounds).all(axis=1)
        & (bounds > 0).all(axis=1)
    )
    if not use.any():
        return None
    errors, bounds = errors[use], bounds[use]
    ratio, interval = ratios_of_rms(errors, bounds, seed)
    return {
        axis: {
            "trials": int(use.sum()),
            "rms_deg": math.sqrt(float(np.mean(errors[:, k] ** 2))),
            "bound_rms_deg": math.sqrt(float(np.mean(bounds[:, k] ** 2))),
            "ratio": float(ratio[k]),
            "interval95": plain(None if interval is None else interval[k]),
        }
        for k, axis in enumerate(CAMERA_AXES)
    }


def consistency(columns: Columns) -> dict[str, Any] | None:
    """Consistency of the stated covariance with the errors: mean normalised error squared and its 95 % bounds.

    ``inside`` is True if the mean is within the bounds. A mean below them indicates that the stated covariance is too
    large, above that it is too small. Over all solved trials including wrong ones, as errors that contradict the
    covariance must not be excluded from its test. None if there are none.
    """
    if "nees" not in columns:
        return None
    nees = np.asarray(columns["nees"], dtype=float)
    nees = nees[np.asarray(columns["status"] == "solved", dtype=bool) & np.isfinite(nees)]
    bounds = mean_chi_square_bounds(len(nees), 3)
    if bounds is None:
        return None
    mean = float(np.mean(nees))
    return {
        "trials": len(nees),
        "freedom": 3,
        "mean": mean,
        "bounds95": list(bounds),
        "inside": bounds[0] <= mean <= bounds[1],
    }


def outliers(columns: Columns) -> list[dict[str, Any]]:
    """Trials that are wrong or inconsistent (`simulator.study.specification.outcome`), have a misidentified star, or
    have an error about a camera axis beyond `OUTLIER_SIGMAS` robust standard deviations (1.48 times the median absolute
    deviation).

    Each has its ``index``, ``why``, the error about every axis in degrees, ``stars_matched`` and ``nees`` if available;
    ``boresight render --index`` renders it again. In order of their indices.
    """
    _, inconsistent, wrong = outcome_flags(columns)
    why: dict[int, list[str]] = {int(i): ["wrong attitude"] for i in np.flatnonzero(wrong)}
    for row in np.flatnonzero(inconsistent):
        why.setdefault(int(row), []).append("inconsistent with the stated covariance")
    for row in np.flatnonzero(np.asarray(columns["stars_misidentified"]) > 0):
        why.setdefault(int(row), []).append(f"misidentified stars: {int(columns['stars_misidentified'][row])}")
    good = np.flatnonzero(identified(columns))
    for axis in CAMERA_AXES if len(good) else ():
        error = np.asarray(columns[f"error_{axis}_deg"], dtype=float)
        middle = float(np.median(error[good]))
        sigma = _MAD_TO_SIGMA * float(np.median(np.abs(error[good] - middle)))
        if sigma > 0.0:
            off = np.abs(error - middle) / sigma
            for k in good[off[good] > OUTLIER_SIGMAS]:
                why.setdefault(int(k), []).append(f"{axis} error {off[k]:.1f} robust sigma")
    listed = []
    for i in sorted(why, key=lambda row: int(columns["index"][row])):
        entry: dict[str, Any] = {"index": int(columns["index"][i]), "why": "; ".join(why[i])}
        entry["errors_deg"] = {axis: plain([columns[f"error_{axis}_deg"][i]])[0] for axis in AXES}
        entry["stars_matched"] = int(columns["stars_matched"][i])
        entry["nees"] = plain([columns["nees"][i]])[0] if "nees" in columns else None
        listed.append(entry)
    return listed


def summarise(columns: Columns, judgement: Judgement, seed: int = 0) -> dict[str, Any]:
    """Numbers of ``summary.json`` from the columns of the trials.

    Parameters
    ----------
    columns : mapping of arrays
        As in ``trials.parquet``.
    judgement : Judgement
        Verdicts on the specification (`simulator.study.specification`).
    seed : int
        Seed of the bootstrap: the scenario's.
    """
    n = len(columns["index"])
    solved = np.asarray(columns["status"] == "solved", dtype=bool)
    wrong, right = outcome_flags(columns)[2], int(identified(columns).sum())
    of_axis = {axis: np.asarray(columns[f"error_{axis}_deg"], dtype=float)[solved] for axis in AXES}
    errors = {axis: axis_statistics(values) for axis, values in of_axis.items()}
    reasons: dict[str, int] = {}
    for status in columns["status"][~solved]:
        reasons[str(status)] = reasons.get(str(status), 0) + 1
    intervals = error_intervals(of_axis, seed)
    out = outliers(columns)
    return {
        "trials": n,
        "solved": int(solved.sum()),
        "unsolved": int(n - solved.sum()),
        "unsolved_by_status": dict(sorted(reasons.items())),
        **outcome_counts(columns),
        "inconsistency": inconsistency(columns),
        "beyond_specification": int(np.sum(columns["beyond_specification"]))
        if "beyond_specification" in columns
        else 0,
        "identification_rate": right / n if n else None,
        "identification_rate_interval95": list(wilson_interval(right, n)),
        "availability": int(solved.sum()) / n if n else None,
        "availability_interval95": list(wilson_interval(int(solved.sum()), n)),
        "wrong_rate_interval95": list(wilson_interval(int(wrong.sum()), n)),
        "errors_deg": {axis: errors[axis] | intervals[axis] for axis in AXES},
        "specification": judgement.by_name({axis: errors[axis]["three_sigma"] for axis in AXES}),
        "verdict": judgement.to_dict(),
        "bound_ratio": against_bound(columns, seed),
        "nees": consistency(columns),
        "outliers": out[:MOST_OUTLIERS_LISTED],
        "outliers_count": len(out),
        "stars_matched_mean": float(np.mean(columns["stars_matched"][solved])) if solved.any() else None,
        "stars_misidentified": int(np.sum(columns["stars_misidentified"])),
    }
