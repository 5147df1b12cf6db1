"""Trials that an error budget excludes: a single large error does not measure the contribution of an effect.

Such an error (a misidentified star, a cosmic ray, a blend at a threshold) often disappears with any change. Its square
would then be attributed to every effect that is switched off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulator.study.axes import CAMERA_AXES
from startracker.core import BoolArray, FloatArray

LIMIT_SIGMAS = 8.0
"""Limit in robust standard deviations of the errors with all effects, each relative to the Cramér–Rao bound of its own
stars, so that fields with few stars do not count as outliers. A Gaussian exceeds it with probability 1e-15."""
_MAD_TO_SIGMA = 1.4826
_FEWEST = 20
_FEW_EFFECTS = 3
"""Most effects that are named as the cause of an outlier."""
ALL_ON = "all effects on"
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
    gone: tuple[str, ...]
    """Effects without which it is none."""
    of: int
    """Number of runs."""

    @property
    def cause(self) -> str:
        """What the runs say about its cause."""
        if ALL_ON not in self.runs:
            off = ", ".join(f"'{name}'" for name in self.runs[:3])
            return f"only without {off}" + (" and others" if len(self.runs) > 3 else "")
        if self.of <= 2 * len(self.runs):
            return "caused by the scene, independent of the effects"
        if len(self.gone) <= _FEW_EFFECTS:
            return "caused by " + " together with ".join(f"'{name}'" for name in self.gone)
        return f"gone whichever of {len(self.gone)} effects is off: at a threshold of the tracker"

    def __str__(self) -> str:
        what = "wrong" if self.wrong else "off"
        axis = self.axis.replace("_", " ")
        size = f"{what} by {self.error_deg * 3600:.3f}″ {axis}, {self.sigmas:.0f} sigma"
        return f"trial {self.index}: {size}, in {len(self.runs)} of {self.of} runs; {self.cause}"

    def to_dict(self) -> dict[str, Any]:
        """As in ``budget.json``."""
        return {
            "index": self.index,
            "axis": self.axis,
            "error_deg": self.error_deg,
            "sigmas": self.sigmas,
            "wrong": self.wrong,
            "runs": list(self.runs),
            "cause": self.cause,
        }


def find_outliers(
    names: Sequence[str],
    errors: Sequence[FloatArray],
    right: Sequence[BoolArray],
    solved: Sequence[BoolArray],
    bound: FloatArray | None = None,
    effects: Sequence[str] = (),
) -> tuple[Outlier, ...]:
    """Outliers of several runs of the same trials, in order of their indices.

    A trial is an outlier if it is wrong in the first run, or if its error about an axis in any run exceeds
    `LIMIT_SIGMAS` times 1.4826 times the median magnitude of the errors of the first run, both relative to the bound of
    the trial. Magnitudes are measured from zero, so that a bias that is switched off does not produce outliers.

    Parameters
    ----------
    names : sequence of str
        Names of the runs; the first has all effects on.
    errors : sequence of (n, 3) arrays
        About the camera's axes, degrees.
    right, solved : sequence of (n,) arrays
        Whether a trial is solved and not wrong, and whether it is solved.
    bound : (n, 3) array, optional
        Cramér–Rao bounds with all effects on, degrees; trials without one (NaN) have the median.
    effects : sequence of str
        The names that are single effects.
    """
    scale = _scale(bound, np.shape(errors[0]))
    good = (errors[0] / scale)[right[0]]
    sigma = _MAD_TO_SIGMA * np.median(np.abs(good), axis=0) if len(good) >= _FEWEST else np.full(3, np.inf)
    off = np.abs(np.stack(errors) / scale) / np.where(sigma > 0.0, sigma, np.inf)  # (runs, n, 3)
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
                tuple(
                    name for name, is_out in zip(names, out[:, index], strict=True) if not is_out and name in effects
                ),
                len(names),
            )
        )
    return tuple(found)


def _scale(bound: FloatArray | None, shape: tuple[int, ...]) -> FloatArray:
    """Bounds without gaps; 1 if there are none."""
    if bound is None or not np.isfinite(bound).any(axis=0).all():
        return np.ones(shape)
    known = np.where(np.isfinite(bound) & (bound > 0.0), bound, np.nan)
    return np.where(np.isnan(known), np.nanmedian(known, axis=0), known)


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
