"""Trials that an error budget excludes: a single large error does not measure the contribution of an effect.

Such an error (a misidentified star, a cosmic ray, a blend at a threshold) often disappears with any change. Its square
would then be attributed to every effect that is switched off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.statistics import CAMERA_AXES

__all__ = ["Outlier", "find_outliers"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LIMIT_SIGMAS = 8.0
"""Limit in robust standard deviations of the errors with all effects. A Gaussian exceeds it with probability 1e-15;
errors of fields with few stars, which may have three times the uncertainty, with 1 %."""
_MAD_TO_SIGMA = 1.4826
_FEWEST = 20
"""Minimum number of trials for a standard deviation."""
_MOST_LISTED = 10


@dataclass(frozen=True)
class Outlier:
    """An excluded trial."""

    index: int
    """Index of the trial, for ``boresight render --index``."""
    axis: str
    """Camera axis with the largest error."""
    error_deg: float
    """This error, in the run in which it is largest."""
    sigmas: float
    """The same in robust standard deviations of the errors with all effects."""
    wrong: bool
    """Whether the attitude is wrong in a run, not only inaccurate."""
    runs: tuple[str, ...]
    """Runs in which it is an outlier: ``all effects on``, or the effect that is off."""
    of: int
    """Number of runs."""

    def __str__(self) -> str:
        what = "wrong" if self.wrong else "off"
        where = f"in {len(self.runs)} of {self.of} runs" if len(self.runs) > 1 else f"with '{self.runs[0]}'"
        if 1 < self.of <= 2 * len(self.runs):
            where += ": caused by the scene, independent of the effects"
        axis = self.axis.replace("_", " ")
        return f"trial {self.index}: {what} by {self.error_deg * 3600:.3f}″ {axis}, {self.sigmas:.0f} sigma, {where}"

    def to_dict(self) -> dict[str, Any]:
        """As in ``budget.json``."""
        return {
            "index": self.index,
            "axis": self.axis,
            "error_deg": self.error_deg,
            "sigmas": self.sigmas,
            "wrong": self.wrong,
            "runs": list(self.runs),
        }


def find_outliers(
    names: Sequence[str], errors: Sequence[FloatArray], right: Sequence[BoolArray], solved: Sequence[BoolArray]
) -> tuple[Outlier, ...]:
    """Outliers of several runs of the same trials, in order of their indices.

    A trial is an outlier if it is wrong in the first run, or if its error about an axis in any run exceeds
    `LIMIT_SIGMAS` times 1.4826 times the median magnitude of the errors of the first run. Magnitudes are measured from
    zero, so that a bias that is switched off does not produce outliers.

    Parameters
    ----------
    names : sequence of str
        Names of the runs; the first has all effects on.
    errors : sequence of (n, 3) arrays
        About the camera's axes, degrees.
    right, solved : sequence of (n,) arrays
        Whether a trial is solved and not wrong, and whether it is solved.
    """
    good = errors[0][right[0]]
    sigma = _MAD_TO_SIGMA * np.median(np.abs(good), axis=0) if len(good) >= _FEWEST else np.full(3, np.inf)
    off = np.abs(np.stack(errors)) / np.where(sigma > 0.0, sigma, np.inf)  # (runs, n, 3)
    off[~np.stack(solved)] = 0.0
    wrong = np.stack(solved) & ~np.stack(right)
    out: BoolArray = np.asarray((off > LIMIT_SIGMAS).any(axis=2), dtype=bool)
    out[0] |= wrong[0]
    found = []
    for index in np.flatnonzero(out.any(axis=0)):
        largest = np.argmax(np.where(out[:, index, None], off[:, index], -1.0))
        run, axis = divmod(int(largest), len(CAMERA_AXES))
        found.append(
            Outlier(
                int(index),
                CAMERA_AXES[axis],
                float(errors[run][index, axis]),
                float(off[run, index, axis]),
                bool(wrong[:, index].any()),
                tuple(name for name, is_out in zip(names, out[:, index], strict=True) if is_out),
                len(names),
            )
        )
    return tuple(found)


def lines_of(outliers: tuple[Outlier, ...]) -> list[str]:
    """Lines of a table that list them."""
    if not outliers:
        return []
    count = f"{len(outliers)} trial{'s' if len(outliers) > 1 else ''}"
    lines = [f"Excluded from the values above: {count} with an outlying error in one of the runs, or a wrong attitude"]
    lines += [f"  {outlier}" for outlier in outliers[:_MOST_LISTED]]
    if len(outliers) > _MOST_LISTED:
        lines.append(f"  and {len(outliers) - _MOST_LISTED} more, in budget.json")
    return lines
