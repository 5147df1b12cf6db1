"""The ``sequence`` section of a scenario: successive frames in tracking mode, motion, gyro."""

from __future__ import annotations

from typing import Literal

from pydantic import FiniteFloat

from simulator.mission.parameters import Gyro, RatePoint, Slew
from simulator.scenario.schema_base import Count, NonNegative, Positive, Section
from startracker.settings import OperationSettings


class DropoutSection(Section):
    """An interval without frames."""

    start_s: NonNegative
    """Start, after the first frame."""
    duration_s: Positive
    """Duration."""


class SequenceSection(Section):
    """Frames in tracking mode: ``boresight run --sequence``."""

    frames: Count = 120
    """Number of frames."""
    step_s: Positive = 0.5
    """Time between frames."""
    start_s: FiniteFloat = 0.0
    """Mid-exposure of the first frame, after the epoch."""
    rates: tuple[RatePoint, ...] = ()
    """Rate of the body relative to its reference, in addition to `pointing.rate_deg_s`: a list of {at_s, roll_deg_s,
    pitch_deg_s, yaw_deg_s} in order of time, linear between points, constant before the first and after the last."""
    slew: Slew = Slew()
    """A slew in addition to these rates."""
    dropouts: tuple[DropoutSection, ...] = ()
    """Intervals without frames: a list of {start_s, duration_s}."""
    recording: str | None = None
    """CSV or Parquet file with the true motion, which replaces that of `pointing`, `rates` and `slew`: one row per
    frame with t_s, the quaternion ICRS to camera (qx, qy, qz, qw) and the inertial rate in camera axes (rate_x_rad_s,
    rate_y_rad_s, rate_z_rad_s). ``boresight serve`` records such files."""
    gyro: Gyro = Gyro()
    """The gyro."""
    rate_walk_deg_s_sqrt_s: Positive | Literal["auto"] = "auto"
    """Process noise of the rate in a filter without a gyro; ``auto``: 3 times the largest angular acceleration of the
    sequence times the square root of the step, or the value required by jitter, at least 5.7e-5."""
    rate_sigma_deg_s: Positive = 2.0
    """Standard deviation of the rate about each axis that the filter assumes before the second frame."""
    operation: OperationSettings = OperationSettings()
    """Rules for setting the exposure, suspending operation with the Sun in the field, removing the Moon, and mapping
    defective pixels."""
