"""Parameters of orbit, pointing and motion: plain values, which a scenario's sections of these names are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from simulator.optics.jitter import NO_JITTER, Jitter
from startracker.display import changed_fields

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class OrbitParameters:
    """Circular orbit. The node is given by `raan_deg` or by `ltan_h`, not by both."""

    altitude_km: float = 800.0
    """Height above the equatorial radius."""
    inclination_deg: float | Literal["auto"] = "auto"
    """Inclination; ``auto`` is sun-synchronous by J2."""
    ltan_h: float | None = None
    """Local mean solar time of the ascending node, hours; 22.5 where neither node key is given."""
    raan_deg: float | None = None
    """Right ascension of the ascending node at the epoch, true equator of date."""
    argument_of_latitude_deg: float = 0.0
    """Angle from the ascending node at the epoch."""
    propagator: str = "j2"
    """``j2``: analytic circular orbit with secular J2; ``sgp4``: the same mean elements through SGP4."""

    __repr__ = changed_fields


@dataclass(frozen=True)
class Spin:
    """Free spin of a body with two equal moments of inertia: its axis of symmetry, body +Z, cones about the angular
    momentum, which stands still."""

    rate_deg_s: float = 0.0
    """Angular velocity about body +Z; 0: no spin, the body holds the local level or `pointing.target`."""
    axis_deg: tuple[float, float] = (0.0, 90.0)
    """Right ascension and declination of the axis that stands still (ICRS)."""
    phase_deg: float = 0.0
    """Turn of the body about its +Z at the epoch, from where, with `cone_phase_deg` 0, its +X points east."""
    cone_deg: float = 0.0
    """Half angle of the cone on which +Z goes about that axis."""
    cone_phase_deg: float = 0.0
    """Where on the cone +Z is at the epoch: its position angle, north through east, from the axis."""
    inertia_ratio: float = 0.1
    """Moment of inertia about +Z over that across it: below 1 a rod, above a disk. The cone turns this many times as
    fast as the body (over the cosine of `cone_deg`)."""


@dataclass(frozen=True)
class PointingParameters:
    """How the camera is mounted and how the body is turned against the local level."""

    mounting: str | tuple[float, float, float, float] = "orbit_normal"
    """Name of a mounting, or the quaternion (x, y, z, w) from body to camera."""
    target: str | Vector | None = None
    """Hold the camera on this instead of the local level: right ascension, declination, roll in degrees (ICRS), or the
    name of a star of the sky's catalogue (``Alp CMa``, ``HIP 32349``) or of a body (``Moon``, ``Jupiter``)."""
    target_offset_deg: tuple[float, float] = (0.0, 0.0)
    """Where a named target stands in the image: degrees from the boresight along +x (columns) and +y (rows)."""
    target_roll_deg: float = 0.0
    """Roll of the camera on a named target."""
    offset_deg: Vector = (0.0, 0.0, 0.0)
    """Fixed attitude offset of the body from the local level: roll, pitch, yaw (rotation vector)."""
    error_deg: float = 1.0
    """Half width of the random attitude offset a trial and axis: what the other sensors leave unknown."""
    rate_deg_s: Vector = (0.0, 0.0, 0.0)
    """Body rate about X, Y, Z on top of the turning of the local-level frame itself."""
    spin: Spin = Spin()
    """Spin about an axis that stands still among the stars, in place of the local level; off without its rate."""
    jitter: Jitter = NO_JITTER
    """Jitter."""

    __repr__ = changed_fields


@dataclass(frozen=True)
class RatePoint:
    """A point of a profile of rates."""

    at_s: float
    """Seconds after the first frame."""
    roll_deg_s: float = 0.0
    """Rate about the body's X."""
    pitch_deg_s: float = 0.0
    """About Y."""
    yaw_deg_s: float = 0.0
    """About Z."""


@dataclass(frozen=True)
class Slew:
    """A turn about one axis: the speed rises evenly, stays, and falls evenly."""

    turn_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation vector of the whole turn in body axes, from where the body then is to where it ends; 0: no slew."""
    max_rate_deg_s: float = 2.0
    """Speed that is not exceeded; a short turn does not reach it."""
    acceleration_deg_s2: float = 0.2
    """Angular acceleration at the beginning, and deceleration at the end."""
    start_s: float = 10.0
    """When it begins, after the first frame."""


@dataclass(frozen=True)
class SequenceMotion:
    """Start after the epoch, step between frames, rate profile and slew of a sequence."""

    start_s: float
    step_s: float
    rates: tuple[RatePoint, ...]
    slew: Slew


@dataclass(frozen=True)
class Gyro:
    """A gyro that the tracking filter goes by between frames, its noise in the terms of IEEE Std 952-1997; its axes are
    the camera's."""

    use: bool = False
    """Whether there is one; without it the filter estimates the rate from the stars alone."""
    angle_random_walk_deg_sqrt_h: float = 0.05
    """White noise of the rate."""
    bias_deg_h: float = 10.0
    """Standard deviation of the constant bias, each axis."""
    bias_instability_deg_h: float = 0.5
    """Standard deviation of the part of the bias that wanders (first-order Gauss-Markov)."""
    bias_time_s: float = 300.0
    """Correlation time of that part."""
    scale_factor_ppm: float = 0.0
    """Standard deviation of the scale factors' errors, constant, each axis; 10,000 is 1 %."""
