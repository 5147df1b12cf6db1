"""The scenario's ``sequence`` section: frames one after the other in tracking mode, the motion meanwhile, the gyro."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from simulator.scenario.schema_base import NonNegative, Positive, Section, Vector3
from startracker.settings import OperationSettings


class RatePointSection(Section):
    """A point of a profile of rates."""

    at_s: NonNegative
    """Seconds after the first frame."""
    roll_deg_s: FiniteFloat = 0.0
    """Rate about the body's X."""
    pitch_deg_s: FiniteFloat = 0.0
    """About Y."""
    yaw_deg_s: FiniteFloat = 0.0
    """About Z."""


class SlewSection(Section):
    """A turn about one axis: the speed rises evenly, stays, and falls evenly."""

    turn_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector of the whole turn in body axes, from where the body then is to where it ends; 0: no slew."""
    max_rate_deg_s: Positive = 2.0
    """Speed that is not exceeded; a short turn does not reach it."""
    acceleration_deg_s2: Positive = 0.2
    """Angular acceleration at the beginning, and deceleration at the end."""
    start_s: NonNegative = 10.0
    """When it begins, after the first frame."""


class DropoutSection(Section):
    """A time in which no frame comes."""

    start_s: NonNegative
    """Its beginning, after the first frame."""
    duration_s: Positive
    """Its length."""


class GyroSection(Section):
    """A gyro that the tracking filter goes by between frames; its axes are the camera's."""

    use: bool = False
    """Whether there is one; without it the filter estimates the rate from the stars alone."""
    angle_random_walk_deg_sqrt_h: Positive = 0.05
    """White noise of the rate."""
    bias_deg_h: NonNegative = 10.0
    """Standard deviation of the constant bias, each axis."""
    bias_instability_deg_h: NonNegative = 0.5
    """Standard deviation of the part of the bias that wanders (first-order Gauss-Markov)."""
    bias_time_s: Positive = 300.0
    """Correlation time of that part."""
    scale_factor_ppm: Annotated[FiniteFloat, Field(ge=0, le=200_000)] = 0.0
    """Standard deviation of the scale factors' errors, constant, each axis; 10,000 is 1 %."""


class SequenceSection(Section):
    """Frames in tracking mode: ``boresight run --sequence``."""

    frames: Annotated[int, Field(ge=1)] = 120
    """Number of frames."""
    step_s: Positive = 0.5
    """Time from one to the next."""
    start_s: FiniteFloat = 0.0
    """Mid-exposure of the first, after the epoch."""
    rates: tuple[RatePointSection, ...] = ()
    """Rate of the body against what it holds, on top of `pointing.rate_deg_s`: a list of {at_s, roll_deg_s,
    pitch_deg_s, yaw_deg_s} in order of time, straight lines between, held before the first and after the last."""
    slew: SlewSection = SlewSection()
    """A turn on top of that."""
    dropouts: tuple[DropoutSection, ...] = ()
    """Times without a frame: a list of {start_s, duration_s}."""
    gyro: GyroSection = GyroSection()
    """The gyro."""
    rate_walk_deg_s_sqrt_s: Positive | Literal["auto"] = "auto"
    """What the filter without a gyro allows the rate to change in a second; ``auto``: 3 times the largest angular
    acceleration of the sequence times the root of the step, or what jitter takes, 5.7e-5 at least."""
    rate_sigma_deg_s: Positive = 2.0
    """What it takes for the standard deviation of the rate, each axis, before it has seen two frames."""
    operation: OperationSettings = OperationSettings()
    """The rules by which the sensor sets its exposure, stands by under the Sun, clears the Moon and maps blemishes."""
