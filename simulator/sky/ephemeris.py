"""Barycentric positions of Sun, Moon and planets at the instants of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from startracker.core import FloatArray
from startracker.ephemeris import barycentric, timescale

if TYPE_CHECKING:
    from simulator.mission.clock import Clock


def sky_time(clock: Clock, t_s: float | FloatArray) -> Any:
    """Skyfield's ``Time`` of seconds after the scenario's epoch, a number or an array (N,)."""
    return timescale().tt_jd(*clock.tt_jd(t_s))


def barycentric_position_au(body: str, clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Barycentric position of a body, au, ICRF axes: (3,), or (N, 3) for times (N,); `InputError` outside DE421."""
    return np.asarray(barycentric(body, sky_time(clock, t_s)).xyz.au.T)
