"""The scenario's ``heads`` section: several cameras on one spacecraft, solved separately and fused."""

from __future__ import annotations

import json
from typing import Annotated, Any

from pydantic import Field, FiniteFloat

from simulator.scenario.schema_base import NonNegative, Positive, Section
from simulator.scenario.schema_sequence import DropoutSection


class HeadSection(Section):
    """One camera of several, with what differs from the scenario's own."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    """Name, part of the names of its columns."""
    mounting: str | tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
    """Name of a mounting, or the quaternion (x, y, z, w) from body to camera, as the tracker knows it."""
    misalignment_arcsec: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    """Actual rotation of the camera from its mounting, a rotation vector about the camera's x, y and z, not known to
    the tracker; null: three random values of the standard deviation `alignment_sigma_arcsec`."""
    alignment_sigma_arcsec: NonNegative = 0.0
    """Standard deviation of the mounting about each axis, as the filter assumes it; it then estimates the alignment. 0:
    the mounting is exact."""
    correlated_arcsec: tuple[NonNegative, NonNegative, NonNegative] = (0.0, 0.0, 0.0)
    """Standard deviation that the filter assumes, about the camera's x, y and z, for the part of the errors that is
    correlated from frame to frame: stars with unresolved companions, errors of the calibration. It is then estimated;
    zeros: errors of different frames are independent."""
    correlation_s: Positive = 60.0
    """Correlation time of this part, such as the time that a star takes to cross the field."""
    bending_arcsec: NonNegative | None = None
    """Standard deviation that the filter assumes, about each axis, for the motion of the mounting in flight, such as
    the thermal deformation of the structure; it then estimates the motion. 0: the mounting does not move; null: the
    largest amplitude of `pointing.thermo_elastic`, divided by √2."""
    bending_s: Positive = 900.0
    """Correlation time of this motion: for a deformation that follows the orbit, its period divided by 2π."""
    time_offset_s: NonNegative = 0.0
    """Mid-exposure after the times of the sequence; less than `sequence.step_s`."""
    delay_s: NonNegative = 0.0
    """Time from mid-exposure until the filter has the attitude."""
    dropouts: tuple[DropoutSection, ...] = ()
    """Intervals without frames of this head, in addition to `sequence.dropouts`: a list of {start_s, duration_s}."""
    optics: dict[str, Any] | None = None
    """Keys of the scenario's section `optics` with other values for this head."""
    detector: dict[str, Any] | None = None
    """Keys of the scenario's section `detector` with other values for this head, such as `exposure_s`."""
    tracker: dict[str, Any] | None = None
    """Keys of the scenario's section `tracker` with other values for this head."""

    def __hash__(self) -> int:
        return hash(json.dumps(self.model_dump(mode="json"), sort_keys=True))


OVERRIDDEN = ("optics", "detector", "tracker")
"""Sections of the scenario that a head may override."""
