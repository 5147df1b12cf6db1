"""Requirements of a scenario's ``specification`` section, as one list that every command judges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from simulator.scenario import Scenario

AVAILABILITY, WRONG_RATE, INCONSISTENT_RATE, ACQUISITION = (
    "availability", "wrong_rate", "inconsistent_rate", "acquisition"
)  # fmt: skip
"""Names of the requirements that are not on errors."""


@dataclass(frozen=True)
class Requirement:
    """One required value."""

    name: str
    """Unique: an axis, an axis and a percentile (``across_p95``), `AVAILABILITY`, `WRONG_RATE`, `INCONSISTENT_RATE` or
    `ACQUISITION`."""
    limit: float
    """Degrees for an error, seconds for the acquisition, otherwise a fraction: the minimum of the availability, the
    maximum of everything else."""
    percent: float | None = None
    """Percentage of the frames that must be within the limit; None for fractions."""
    axis: str = ""
    """Axis of an error, one of `SPECIFIED_AXES`; empty for other requirements."""

    @property
    def title(self) -> str:
        """Name for display."""
        axis = self.axis.replace("_", " ").replace("about boresight", "about the boresight")
        return axis or self.name.replace("_", " ")


@dataclass(frozen=True)
class Specification:
    """All requirements, and the conditions in which they hold."""

    requirements: tuple[Requirement, ...]
    rate_deg_s: float | None = None
    """Angular rate at which they hold; None: at any."""
    exclusion_deg: tuple[tuple[str, float], ...] = ()
    """(body, angle): they need not hold where the boresight is closer to the centre of the Sun or the Moon, or to the
    limb of the Earth."""

    @property
    def errors(self) -> tuple[Requirement, ...]:
        """The requirements on errors."""
        return tuple(each for each in self.requirements if each.axis)

    def find(self, name: str) -> Requirement | None:
        """The requirement of a name."""
        return next((each for each in self.requirements if each.name == name), None)

    def worst_share(self, error_deg: Mapping[str, Any]) -> Any:
        """Largest error relative to its limit; NaN without a solution or if no error is specified.

        Parameters
        ----------
        error_deg : mapping
            By axis, degrees: numbers, or arrays of one shape.
        """
        shares = [np.abs(error_about(error_deg, each.axis)) / each.limit for each in self.errors]
        return np.max(shares, axis=0) if shares else np.full(np.shape(error_deg["cross_x"]), math.nan)[()]

    @classmethod
    def of_limits(cls, limits_deg: Mapping[str, float], percent: float = 99.7) -> Specification:
        """Limits about axes at one percentile, degrees."""
        return cls(tuple(Requirement(axis, limit, percent, axis) for axis, limit in limits_deg.items()))


def error_about(error_deg: Mapping[str, Any], axis: str) -> NDArray[np.float64]:
    """Error about an axis; for ``across`` the angle between the true and the estimated boresight, which for small
    errors is √(x² + y²) of those about the camera's cross axes."""
    if axis == "across":
        return np.asarray(np.hypot(error_deg["cross_x"], error_deg["cross_y"]))
    return np.asarray(error_deg[axis], dtype=float)


def specification_of(scenario: Scenario) -> Specification:
    """Requirements of a scenario, axes first, in the order of the schema."""
    from simulator.scenario.schema_specification import SPECIFIED_AXES

    section = scenario.specification
    requirements = []
    for axis in SPECIFIED_AXES:
        limit = getattr(section, f"{axis}_deg")
        if limit is not None:
            requirements.append(Requirement(axis, limit, section.percentile, axis))
    for more in section.errors:
        name = f"{more.axis}_p{more.percentile:g}"
        requirements.append(Requirement(name, more.limit_deg, more.percentile, more.axis))
    if section.availability is not None:
        requirements.append(Requirement(AVAILABILITY, section.availability))
    if section.wrong_rate is not None:
        requirements.append(Requirement(WRONG_RATE, section.wrong_rate))
    if section.inconsistent_rate is not None:
        requirements.append(Requirement(INCONSISTENT_RATE, section.inconsistent_rate))
    if section.acquisition_s is not None:
        requirements.append(Requirement(ACQUISITION, section.acquisition_s, section.percentile))
    excluded = ((body, getattr(section, f"{body}_exclusion_deg")) for body in ("sun", "moon", "earth"))
    return Specification(
        tuple(requirements), section.rate_deg_s, tuple((body, angle) for body, angle in excluded if angle is not None)
    )
