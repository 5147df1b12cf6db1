"""The scenario's ``sequence`` section: frames one after the other in tracking mode, the motion meanwhile, the gyro."""

from __future__ import annotations

from typing import Literal

from pydantic import FiniteFloat

from simulator.mission.parameters import Gyro, RatePoint, Slew
from simulator.scenario.schema_base import Count, NonNegative, Positive, Section
from startracker.settings import OperationSettings


class DropoutSection(Section):
    """A time in which no frame comes."""

    start_s: NonNegative
    """Its beginning, after the first frame."""
    duration_s: Positive
    """Its length."""


class SequenceSection(Section):
    """Frames in tracking mode: ``boresight run --sequence``."""

    frames: Count = 120
    """Number of frames."""
    step_s: Positive = 0.5
    """Time from one to the next."""
    start_s: FiniteFloat = 0.0
    """Mid-exposure of the first, after the epoch."""
    rates: tuple[RatePoint, ...] = ()
    """Rate of the body against what it holds, on top of `pointing.rate_deg_s`: a list of {at_s, roll_deg_s,
    pitch_deg_s, yaw_deg_s} in order of time, straight lines between, held before the first and after the last."""
    slew: Slew = Slew()
    """A turn on top of that."""
    dropouts: tuple[DropoutSection, ...] = ()
    """Times without a frame: a list of {start_s, duration_s}."""
    gyro: Gyro = Gyro()
    """The gyro."""
    rate_walk_deg_s_sqrt_s: Positive | Literal["auto"] = "auto"
    """What the filter without a gyro allows the rate to change in a second; ``auto``: 3 times the largest angular
    acceleration of the sequence times the root of the step, or what jitter takes, 5.7e-5 at least."""
    rate_sigma_deg_s: Positive = 2.0
    """What it takes for the standard deviation of the rate, each axis, before it has seen two frames."""
    operation: OperationSettings = OperationSettings()
    """Rules by which the sensor sets its exposure, stands by under the Sun, clears the Moon, maps defective pixels."""
