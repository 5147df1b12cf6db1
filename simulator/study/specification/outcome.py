"""Misidentified, inconsistent, wrong: the one definition of every study, its counts and its words.

``misidentified``
    A star of the solution is not the one that it names.
``inconsistent``
    The error lies beyond 5 σ of the stated covariance (`INCONSISTENT_NEES`). The attitude may be as good as required,
    but is stated too confidently.
``wrong``
    Misidentified; or inconsistent, and beyond the specification as well: an error exceeds its limit, of several about
    one axis (at different percentiles) the widest. Without any limit on an error the rotation must exceed `GROSS_DEG`.
    (A scenario always has limits: those of `simulator.scenario.schema_specification` unless it names its own.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.study.axes import CAMERA_AXES
from simulator.study.intervals import wilson_interval
from simulator.study.specification.requirements import Specification
from simulator.study.texts import deg_text
from startracker.core import BoolArray

INCONSISTENT_NEES = 31.812
"""Normalised error squared beyond which an attitude contradicts its stated covariance: χ² of 3 degrees of freedom
exceeds it with probability 5.7e-7, as a normal deviate exceeds 5 σ."""

GROSS_DEG = 0.1
"""Rotation beyond which an inconsistent attitude is wrong if no error is specified, as in the benchmarks."""

DISPLACED, CENTROIDS, NOISE, BIAS, UNKNOWN = "displaced", "centroids", "noise", "bias", "unknown"
CAUSES = {
    DISPLACED: "star images displaced by errors of the lens or of the time that the tracker does not know",
    CENTROIDS: "errors of the centroids larger than stated",
    NOISE: "a stated covariance smaller than the noise of the stars allows",
    BIAS: "an error common to all frames",
    UNKNOWN: "unknown: not noise, larger errors of the centroids, known displacements or a common error",
}
"""Likely causes of inconsistent attitudes. The first three and the last are found frame by frame
(`simulator.study.trials.causes`), `BIAS` from all frames."""

_BIAS_SIGMAS = 5.0

Columns = Mapping[str, NDArray[Any]]


class Outcome(NamedTuple):
    """What an accepted attitude is. All are False for a frame without one."""

    misidentified: bool = False
    inconsistent: bool = False
    wrong: bool = False


NO_OUTCOME = Outcome()


def outcome_of(
    stars_misidentified: int, nees: float, error_deg: Mapping[str, float], specification: Specification
) -> Outcome:
    """Outcome of an accepted attitude, by the module's definition.

    Parameters
    ----------
    stars_misidentified : int
        Number of stars that are not the ones named.
    nees : float
        Error squared, normalised by the stated covariance; NaN without one, which contradicts nothing.
    error_deg : mapping
        Error by axis (`simulator.study.statistics.AXES`), degrees.
    specification : Specification
        Its limits on errors.
    """
    misidentified, inconsistent = stars_misidentified > 0, bool(nees > INCONSISTENT_NEES)
    return Outcome(
        misidentified, inconsistent, misidentified or (inconsistent and exceeds_limit(error_deg, specification))
    )


def exceeds_limit(error_deg: Mapping[str, float], specification: Specification) -> bool:
    """Whether an error exceeds the widest limit of the specification about its axis, or the rotation `GROSS_DEG` if the
    specification has no limit on errors."""
    widest: dict[str, float] = {}
    # An axis may have limits at several percentiles. An error between two of them is allowed in some of the frames, and
    # is not wrong by itself.
    for each in specification.errors:
        widest[each.axis] = max(each.limit, widest.get(each.axis, 0.0))
    if widest:
        return bool(Specification.of_limits(widest).worst_share(error_deg) > 1.0)
    return math.hypot(*(error_deg[axis] for axis in CAMERA_AXES)) > GROSS_DEG


def outcome_flags(columns: Columns, prefix: str = "") -> tuple[BoolArray, BoolArray, BoolArray]:
    """Misidentified, inconsistent and wrong frames, (n,) each, from the columns of a study.

    Columns of versions before these words, with ``wrong``, ``stars_misidentified`` and ``nees``, are read as well.
    """
    wrong = np.asarray(columns[f"{prefix}wrong"], dtype=bool)
    nothing = np.zeros(len(wrong))
    found = []
    for name, source, limit in (
        ("misidentified", "stars_misidentified", 0.0),
        ("inconsistent", "nees", INCONSISTENT_NEES),
    ):
        if f"{prefix}{name}" in columns:
            found.append(np.asarray(columns[f"{prefix}{name}"], dtype=bool))
        else:
            solved = np.asarray(columns[f"{prefix}status"] == "solved", dtype=bool)
            found.append(solved & (np.asarray(columns.get(f"{prefix}{source}", nothing), dtype=float) > limit))
    return found[0], found[1], wrong


def identified(columns: Columns) -> BoolArray:
    """Solved frames (n,) with the right stars, as far as it is known: not misidentified, and not wrong for an unknown
    cause. A large error that the lens, the centroids or the noise explain is an error of the right stars."""
    misidentified, _, wrong = outcome_flags(columns)
    if "inconsistent_cause" in columns:
        wrong = wrong & (np.asarray(columns["inconsistent_cause"]) == UNKNOWN)
    return np.asarray(np.asarray(columns["status"] == "solved", dtype=bool) & ~misidentified & ~wrong)


def outcome_counts(columns: Columns, prefix: str = "") -> dict[str, int]:
    """Numbers of misidentified, inconsistent and wrong frames."""
    misidentified, inconsistent, wrong = outcome_flags(columns, prefix)
    return {
        "misidentified": int(misidentified.sum()),
        "inconsistent": int(inconsistent.sum()),
        "wrong": int(wrong.sum()),
    }


def inconsistency(columns: Columns) -> dict[str, Any] | None:
    """Rate of inconsistent attitudes among the solved frames, and their likely cause; None without any.

    ``causes`` counts what was found for each (`CAUSES`). If most are `UNKNOWN`, and the mean error about an axis of the
    camera exceeds both the scatter of the errors and five of its standard errors, the likely cause is this `BIAS`.
    """
    misidentified, inconsistent, wrong = outcome_flags(columns)
    count = int(inconsistent.sum())
    if not count:
        return None
    solved = np.asarray(columns["status"] == "solved", dtype=bool)
    said: list[Any] = []
    if "inconsistent_cause" in columns:
        said = np.asarray(columns["inconsistent_cause"])[inconsistent].tolist()
    causes = {name: said.count(name) for name in CAUSES}
    causes[UNKNOWN] += count - sum(causes.values())
    likely, detail = max(causes, key=lambda name: causes[name]), ""
    bias = _bias(columns, solved & ~misidentified)
    if likely == UNKNOWN and bias is not None:
        axis, mean_deg, std_deg = bias
        likely = BIAS
        detail = f" of {deg_text(abs(mean_deg))} about {axis.replace('_', ' ')}, with a scatter of {deg_text(std_deg)}"
    total = int(solved.sum())
    low, high = wilson_interval(count, total)
    return {
        "count": count,
        "rate": count / total,
        "rate_interval95": [low, high],
        "beyond_limit": int((inconsistent & wrong & ~misidentified).sum()),
        "causes": {name: number for name, number in causes.items() if number},
        "likely_cause": likely,
        "text": f"Inconsistent with the stated covariance: {count} of {total} attitudes ({100 * count / total:.2f} %, "
        f"95 % interval {100 * low:.2f} to {100 * high:.2f} %); likely cause: {CAUSES[likely]}{detail}"
        + ("" if likely == BIAS or causes[likely] == count else f" ({causes[likely]} of {count})"),
    }


def _bias(columns: Columns, frames: BoolArray) -> tuple[str, float, float] | None:
    """Axis, mean and standard deviation, degrees, of the error with the largest mean against its scatter."""
    best, largest = None, 1.0
    for axis in CAMERA_AXES:
        error = np.asarray(columns[f"error_{axis}_deg"], dtype=float)[frames]
        if len(error) < 2:
            return None
        mean, std = float(error.mean()), float(error.std(ddof=1))
        if abs(mean) > largest * std and abs(mean) * math.sqrt(len(error)) > _BIAS_SIGMAS * std:
            best, largest = (axis, mean, std), abs(mean) / std if std else math.inf
    return best


def outcome_counts_text(summary: Mapping[str, Any]) -> str:
    """Numbers of wrong and, if there are any, inconsistent attitudes of a summary: ``0 wrong, 3 inconsistent``."""
    inconsistent = summary.get("inconsistent", 0)
    return f"{summary['wrong']} wrong" + (f", {inconsistent} inconsistent" if inconsistent else "")


def outcome_text(summary: Mapping[str, Any]) -> str:
    """``none wrong``, or what the wrong and the inconsistent attitudes of a summary are."""
    wrong, misidentified = summary["wrong"], summary.get("misidentified", 0)
    gross = wrong - misidentified
    within = summary.get("inconsistent", 0) - (summary.get("inconsistency") or {}).get("beyond_limit", 0)
    parts = [f"{misidentified} misidentified"] if misidentified else []
    parts += [f"{gross} inconsistent and beyond the specification"] if gross > 0 else []
    text = f"{wrong} wrong ({', '.join(parts)})" if wrong else "none wrong"
    return text + (f", {within} inconsistent" if within > 0 else "")
