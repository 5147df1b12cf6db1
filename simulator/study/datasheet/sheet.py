"""Values of a datasheet, each with its 95 % interval, unit, axis, level, statistical interpretation and method; and how
much a datasheet simulates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.study.intervals import FEWEST, moment_intervals, percentile_interval, wilson_interval


@dataclass(frozen=True)
class Amounts:
    """Numbers of frames; the trials of all points of a series have the same indices (common random numbers)."""

    fields: int
    """Scanned fields."""
    trials: int
    """Trials of the mission."""
    acquisition: int
    """Trials over the whole sky, lost in space; half of them with a prior."""
    per_rate: int
    """Frames at each angular rate."""
    bisections: int
    """Steps in which the bracket of a limit is halved."""
    per_point: int
    """Trials of each other point: temperature, robustness, pairs of trials."""
    sequence: int
    """Frames of the sequence in tracking mode."""
    acceleration: int
    """Frames of the sequence at each acceleration."""
    directions: int
    """Directions of the sky coverage, and instants along the path."""

    def to_dict(self) -> dict[str, int]:
        """As in ``datasheet.json``."""
        return asdict(self)


QUICK = Amounts(6, 120, 30, 8, 2, 8, 16, 6, 1000)
"""For a first look."""
FULL = Amounts(96, 3000, 800, 60, 5, 150, 300, 24, 10_000)
"""From 1,228 trials on, the 99.7th percentile has an upper limit."""


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


LEVELS = (68.0, 95.0, 99.7)
"""Levels at which errors are stated, percent."""


@dataclass(frozen=True)
class Quantity:
    """One value of a datasheet."""

    name: str
    """Name in ``datasheet.json``."""
    title: str
    """Name on the page."""
    estimate: Estimate
    """Value and interval."""
    unit: str = ""
    """Unit."""
    axis: str = ""
    """Axis of the camera."""
    level: float | None = None
    """Percentage of the errors that are within the value; None for a mean, an rms, or no error."""
    interpretation: str = ""
    """Statistical interpretation of ECSS-E-ST-60-10C: ``temporal``, ``ensemble`` or ``mixed``."""
    method: str = ""
    """How the value was found."""

    def to_dict(self) -> dict[str, Any]:
        """As in ``datasheet.json``; entries that do not apply are left out."""
        value, low, high = self.estimate.plain()
        found: dict[str, Any] = {"name": self.name, "title": self.title, "value": value}
        found |= {"interval": [low, high], "confidence": CONFIDENCE}
        optional = ("unit", "axis", "level", "interpretation", "method")
        return found | {name: given for name in optional if (given := getattr(self, name)) not in ("", None)}


def select(quantities: list[Quantity], name: str, axis: str = "", level: float | None = None) -> Quantity | None:
    """The first value with this name, axis and level; None if there is none."""
    for quantity in quantities:
        if (quantity.name, quantity.axis, quantity.level) == (name, axis, level):
            return quantity
    return None
