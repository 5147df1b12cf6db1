"""Interface of trajectories: position and velocity at any time within a span, relative to a centre, ICRF axes."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from simulator.constants import EARTH_GM_KM3_S2
from simulator.mission.clock import Clock
from startracker.core import FloatArray
from startracker.ephemeris import DE421_BARYCENTRES, DE421_NAME, barycentric, timescale
from startracker.errors import InputError

BARYCENTRE = "Solar system barycentre"
CENTRES = (*DE421_NAME, *DE421_BARYCENTRES, BARYCENTRE)
"""Centres of trajectories: all points of DE421. Jupiter to Neptune stand for the barycentres of their systems. The
barycentre of Mars and its moons is within a metre of the planet's centre, and Mercury and Venus have no moons."""

GM_KM3_S2 = {
    "Mercury": 22_031.78,
    "Venus": 324_858.592,
    "Earth": EARTH_GM_KM3_S2,
    "Moon": 4_902.800_066,
    "Mars": 42_828.375_214,
    "Jupiter": 126_712_764.8,
    "Saturn": 37_940_585.2,
    "Uranus": 5_794_548.6,
    "Neptune": 6_836_527.100_58,
    "Sun": 132_712_440_041.9394,
    "Earth-Moon barycentre": EARTH_GM_KM3_S2 + 4_902.800_066,
    "Pluto barycentre": 977.0,
    BARYCENTRE: 132_712_440_041.9394,
}
"""Gravitational parameters of DE430 and DE431 (Folkner et al. 2014, IPN Progress Report 42-196, table 8), for Mars and
beyond including the moons; for the Earth `EARTH_GM_KM3_S2`, and for the barycentre of the solar system the Sun's."""

UNLIMITED = (-math.inf, math.inf)


class States(NamedTuple):
    """Position and velocity; unpacks as a pair."""

    r_km: FloatArray
    """(..., 3)."""
    v_km_s: FloatArray
    """(..., 3)."""


@runtime_checkable
class Trajectory(Protocol):
    """Trajectory; immutable and picklable."""

    @property
    def clock(self) -> Clock:
        """Clock with the epoch of `t_s`."""
        ...

    @property
    def centre(self) -> str:
        """Origin of the states, one of `CENTRES`; the local level refers to it."""
        ...

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds after the epoch; infinite where the model has no limit of its own."""
        ...

    @property
    def period_s(self) -> float:
        """Period of the orbit around the centre at the epoch; infinite for a trajectory that is not closed."""
        ...

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, relative to the centre at seconds since the epoch, shape
        (...).

        ICRF axes (GCRS for an orbit around the Earth). `InputError` outside the span.
        """
        ...


def refuse_outside(clock: Clock, t_s: FloatArray, span_s: tuple[float, float], what: str) -> None:
    """Raise an error that names the span if a time is outside it.

    Parameters
    ----------
    clock : Clock
        Epoch of the times.
    t_s : array
        Seconds after the epoch.
    span_s : (float, float)
        First and last time that are permitted.
    what : str
        What covers the span, the subject of the message.

    Raises
    ------
    InputError
        If any time is outside, or NaN.
    """
    # Negated, because every comparison with NaN is false.
    outside = ~((t_s >= span_s[0]) & (t_s <= span_s[1]))
    if outside.any():
        first, last = (clock.isot(limit) for limit in span_s)
        worst = float(t_s[outside][0])
        when = clock.isot(worst) if math.isfinite(worst) else f"{worst} s"
        raise InputError(
            f"{what} covers {first} to {last} UTC; {when} is outside: change the epoch, the start of the sequence, or "
            "study.sampling (span: within it)"
        )


def osculating_period_s(r_km: FloatArray, v_km_s: FloatArray, gm_km3_s2: float) -> float:
    """Period of the osculating ellipse, 2π √(a³/μ) with 1/a = 2/r − v²/μ; infinite for a parabola or hyperbola."""
    inverse = 2.0 / math.hypot(*r_km.tolist()) - float(v_km_s @ v_km_s) / gm_km3_s2
    return 2.0 * math.pi / math.sqrt(gm_km3_s2 * inverse**3) if inverse > 0.0 else math.inf


def centre_state(centre: str, clock: Clock, t_s: float | FloatArray) -> States:
    """Barycentric position, km, and velocity, km/s, of a centre (DE421), shape (3,) or (N, 3); ICRF axes.

    Raises
    ------
    InputError
        If a date is outside DE421.
    """
    if centre == BARYCENTRE:
        return States(np.zeros((*np.shape(t_s), 3)), np.zeros((*np.shape(t_s), 3)))
    # Skyfield converts TT to TDB, the argument of the ephemeris; its arrays have the components first.
    at = barycentric(centre, timescale().tt_jd(*clock.tt_jd(t_s)))
    return States(at.xyz.km.T, at.velocity.km_per_s.T)


def geocentric(trajectory: Trajectory, t_s: FloatArray) -> States:
    """Geocentric states (N, 3) of a trajectory at times (N,), ICRF axes; `InputError` outside its span."""
    return from_earth(trajectory, t_s, *trajectory.state(t_s))


def from_earth(trajectory: Trajectory, t_s: FloatArray, r_km: FloatArray, v_km_s: FloatArray) -> States:
    """Geocentric states (N, 3) of states (N, 3) of a trajectory at times (N,), ICRF axes.

    The relativistic difference between coordinates of GCRS and BCRS, 1e-8 of them, is neglected.
    """
    if trajectory.centre == "Earth":
        return States(r_km, v_km_s)
    centre = centre_state(trajectory.centre, trajectory.clock, t_s)
    earth = centre_state("Earth", trajectory.clock, t_s)
    return States(r_km + (centre.r_km - earth.r_km), v_km_s + (centre.v_km_s - earth.v_km_s))
