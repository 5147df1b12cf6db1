"""Estimates with their 95 % intervals, as every value of a datasheet is stated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.study.intervals import FEWEST, moment_intervals, percentile_interval, wilson_interval

CONFIDENCE = 0.95
"""Confidence of all intervals."""


class Estimate(NamedTuple):
    """A value and its interval; None for what the frames do not determine."""

    value: float | None
    low: float | None = None
    high: float | None = None

    def times(self, factor: float) -> Estimate:
        """The estimate times a positive factor."""
        return Estimate(*(None if part is None else factor * part for part in self))

    def plain(self) -> Estimate:
        """As floats of Python, with None for values that are not finite."""
        return Estimate(*(None if part is None or not math.isfinite(part) else float(part) for part in self))

    @property
    def half_width(self) -> float | None:
        """Half the width of the interval."""
        return None if self.low is None or self.high is None else 0.5 * (self.high - self.low)


def cross_square_deg2(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Mean square error per axis across the boresight, of each frame."""
    return np.asarray(0.5 * (columns["error_cross_x_deg"] ** 2 + columns["error_cross_y_deg"] ** 2))


def rms_of(errors: ArrayLike, seed: int = 0) -> Estimate:
    """Rms of independent errors, without NaN."""
    return _moment(errors, "rms", seed)


def mean_of(errors: ArrayLike, seed: int = 0) -> Estimate:
    """Mean of independent errors, without NaN."""
    return _moment(errors, "mean", seed)


def _moment(errors: ArrayLike, name: str, seed: int) -> Estimate:
    known = np.asarray(errors, dtype=float)
    known = known[np.isfinite(known)]
    if len(known) < FEWEST:
        return Estimate(None)
    ends = moment_intervals(known[:, None], seed)[name]
    assert ends is not None
    value = float(np.mean(known)) if name == "mean" else math.sqrt(float(np.mean(known**2)))
    return Estimate(value, float(ends[0, 0]), float(ends[0, 1]))


def upper_limit(errors: ArrayLike, level: float) -> Estimate:
    """Percentile of the magnitude of independent errors, without NaN, with its interval by order statistics."""
    known = np.sort(np.abs(np.asarray(errors, dtype=float)))
    known = known[np.isfinite(known)]
    if not len(known):
        return Estimate(None)
    value = float(np.percentile(known, level, method="inverted_cdf"))
    return Estimate(value, *percentile_interval(known, level))


def proportion(events: Iterable[Any]) -> Estimate:
    """Fraction of true values with Wilson's interval."""
    happened = [bool(event) for event in events]
    share = sum(happened) / len(happened) if happened else None
    return Estimate(share, *wilson_interval(sum(happened), len(happened)))
