"""A trajectory of which only the newest state is known, because another simulator supplies it while it runs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.clock import Clock
from simulator.mission.trajectory import CENTRES, GM_KM3_S2, osculating_period_s
from startracker.core import FloatArray
from startracker.errors import InputError

_REACH_S = 10.0
"""Maximum time from the newest state to which it is extrapolated; an exposure and its light times need less."""


class GivenTrajectory:
    """Trajectory whose state is set by `update` and extrapolated with constant acceleration.

    Parameters
    ----------
    clock : Clock
        Epoch of the times.
    centre : str
        Origin of the states, one of `simulator.mission.trajectory.CENTRES`.

    Raises
    ------
    InputError
        For an unknown centre.

    Notes
    -----
    Within τ = 10 s of the newest state the position is r + v τ − μ r τ²/2r³. Its error is the neglected jerk term
    n³ r τ³/6: 1.4 mm after 1 s, and 1.4 m after 10 s, at 800 km above the Earth.
    """

    def __init__(self, clock: Clock, centre: str = "Earth") -> None:
        if centre not in CENTRES:
            raise InputError(f"unknown centre {centre!r}; choose one of {', '.join(CENTRES)}")
        self.clock, self.centre = clock, centre
        self._t_s, self._r_km, self._v_km_s = math.nan, np.zeros(3), np.zeros(3)

    def update(self, t_s: float, r_km: ArrayLike, v_km_s: ArrayLike) -> None:
        """Replace the state by position and velocity (3,), ICRF axes, at seconds after the epoch.

        Raises
        ------
        InputError
            For a state that is not finite, or at the centre.
        """
        r, v = np.array(r_km, dtype=float), np.array(v_km_s, dtype=float)
        if not (r.shape == v.shape == (3,) and np.isfinite([r, v]).all() and r.any() and math.isfinite(t_s)):
            raise InputError(f"a position {r} km with the velocity {v} km/s at {t_s} s is not a state of a spacecraft")
        self._t_s, self._r_km, self._v_km_s = t_s, r, v

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time about the newest state; infinite before there is one."""
        if math.isnan(self._t_s):
            return -math.inf, math.inf
        return self._t_s - _REACH_S, self._t_s + _REACH_S

    @property
    def period_s(self) -> float:
        """Period of the osculating ellipse; infinite before there is a state."""
        gm = GM_KM3_S2.get(self.centre, 0.0)
        return osculating_period_s(self._r_km, self._v_km_s, gm) if gm and self._r_km.any() else math.inf

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, at times (...).

        Raises
        ------
        InputError
            More than 10 s from the newest state, or before there is one.
        """
        since = np.asarray(t_s, dtype=float)[..., None] - self._t_s
        if not (np.abs(since) <= _REACH_S).all():  # this form also refuses NaN, the time before the first state
            raise InputError(f"no position of the spacecraft is known within {_REACH_S:g} s of {np.asarray(t_s)} s")
        pull = -GM_KM3_S2.get(self.centre, 0.0) * self._r_km / math.hypot(*self._r_km.tolist()) ** 3
        # Constant acceleration: the position changes by the mean of initial and final velocity.
        velocity = self._v_km_s + pull * since
        return self._r_km + 0.5 * (self._v_km_s + velocity) * since, velocity
