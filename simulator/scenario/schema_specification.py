"""The ``specification`` section of a scenario: the required performance of the camera."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import Field, FiniteFloat, model_validator

from simulator.scenario.schema_base import Positive, Section

Axis = Literal["roll", "pitch", "yaw", "cross_x", "cross_y", "across", "about_boresight"]

SPECIFIED_AXES: tuple[str, ...] = get_args(Axis)
"""Axes of errors: of the body, of the camera, and across the boresight."""

DEFAULT_LIMITS_DEG = {"roll_deg": 0.025, "pitch_deg": 0.286, "yaw_deg": 0.025}
"""Limits of errors, degrees, of a scenario that specifies none."""

Percent = Annotated[FiniteFloat, Field(gt=0, lt=100)]
Share = Annotated[FiniteFloat, Field(gt=0, lt=1)]
ExclusionAngle = Annotated[FiniteFloat, Field(gt=0, le=180)]


class RequiredError(Section):
    """A required error at a percentile of its own."""

    axis: Axis
    """Axis, or ``across`` for the angle between the true and the estimated boresight."""
    limit_deg: Positive
    """Limit, degrees."""
    percentile: Percent = 99.7
    """Percentage of the frames whose error must be within the limit."""


class SpecificationSection(Section):
    """Required performance; null: not required. Without any error specified, roll and yaw are 0.025°, pitch 0.286°."""

    roll_deg: Positive | None = None
    """Error about the body's X axis (roll)."""
    yaw_deg: Positive | None = None
    """Error about the body's Z axis (yaw)."""
    pitch_deg: Positive | None = None
    """Error about the body's Y axis (pitch)."""
    cross_x_deg: Positive | None = None
    """Error about the camera's x axis."""
    cross_y_deg: Positive | None = None
    """Error about the camera's y axis."""
    across_deg: Positive | None = None
    """Angle between the true and the estimated boresight."""
    about_boresight_deg: Positive | None = None
    """Error about the boresight."""
    percentile: Percent = 99.7
    """Percentage of the frames whose errors must be within these limits, and of the acquisitions within theirs."""
    errors: tuple[RequiredError, ...] = ()
    """Further limits, each with a percentile of its own."""
    availability: Share | None = None
    """Smallest fraction of the frames with an attitude that is not wrong."""
    wrong_rate: Share | None = None
    """Largest fraction of the frames with a wrong attitude: one with a misidentified star, or one whose error is beyond
    5 sigma of the stated covariance and beyond a limit of this section. Null: none may be wrong."""
    inconsistent_rate: Share | None = None
    """Largest fraction of the frames with an inconsistent attitude, whose error is beyond 5 sigma of the stated
    covariance, within the limits of this section or not. Null: consistency is not required."""
    acquisition_s: Positive | None = None
    """Longest time, lost in space, from the start of the first exposure to the end of the one that gives the first
    correct attitude; without computing time."""
    rate_deg_s: Positive | None = None
    """Angular rate at which all of this must hold; frames within 10 % of it are judged. Null: all frames."""
    sun_exclusion_deg: ExclusionAngle | None = None
    """Angle from the Sun's centre to the boresight below which nothing is required."""
    moon_exclusion_deg: ExclusionAngle | None = None
    """Angle from the Moon's centre below which nothing is required."""
    earth_exclusion_deg: ExclusionAngle | None = None
    """Angle from the Earth's limb below which nothing is required."""

    @model_validator(mode="before")
    @classmethod
    def _default_limits(cls, values: Any) -> Any:
        """The default limits where no error is specified."""
        if not isinstance(values, dict):
            return values
        # Any specified error replaces all default limits, so that a scenario can omit roll, pitch or yaw.
        named = any(values.get(f"{axis}_deg") is not None for axis in SPECIFIED_AXES) or values.get("errors")
        return values if named else values | DEFAULT_LIMITS_DEG
