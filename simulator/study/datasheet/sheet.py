"""Values of a datasheet: each with unit, axis, interval, level, statistical interpretation and method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulator.study.datasheet.estimates import CONFIDENCE, Estimate

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
