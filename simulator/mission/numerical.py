"""Numerical propagation of a state by SciPy's DOP853, in steps that do not depend on the times requested."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.clock import SECONDS_PER_DAY, Clock
from simulator.mission.forces import Forces
from simulator.mission.interpolation import StateTable
from simulator.mission.parameters import ForceModel
from simulator.mission.trajectory import GM_KM3_S2, osculating_period_s, refuse_outside
from startracker.core import FloatArray
from startracker.errors import InputError

_RELATIVE, _ABSOLUTE = 1e-12, 1e-9
"""Tolerances of a step; the absolute one in km and km/s: 1 mm and 1 mm/s at small values."""
_NODES = 6
"""Integration steps that an interpolating polynomial passes through. With positions and velocities its degree is 11,
above the order of the integrator."""
_FIRST_STEP = 0.1
"""First step, in units of r/v. It is about as long as the following ones, because interpolation needs similar steps."""
_LONGEST_STEP_DAYS = 8.0
"""Maximum step: two blocks of the bodies' polynomials (`simulator.mission.forces`)."""
_SPAN_DAYS = 36_525.0
"""Limit given to the integrator, which only serves as a direction; a century is beyond any ephemeris."""


class _March:
    """Integration in one direction from the epoch, continued as far as requested."""

    def __init__(self, forces: Forces, start: FloatArray, direction: float) -> None:
        from scipy.integrate import DOP853

        limit = direction * _SPAN_DAYS * SECONDS_PER_DAY
        self._solver = DOP853(
            forces.derivative(),
            0.0,
            start,
            limit,
            first_step=_FIRST_STEP * float(np.linalg.norm(start[:3]) / np.linalg.norm(start[3:])),
            max_step=_LONGEST_STEP_DAYS * SECONDS_PER_DAY,
            rtol=_RELATIVE,
            atol=_ABSOLUTE,
        )
        self._times, self._states, self._backwards = [0.0], [start], direction < 0.0
        self._table: StateTable | None = None

    def reach(self, t_s: float) -> StateTable:
        """Table of the steps until `_NODES` steps beyond a time, so that its interpolation does not depend on how far
        the integration is continued later."""
        # The interpolating polynomial uses the nodes around a time; it is final if `_NODES` steps lie beyond the time.
        while abs(self._times[-min(_NODES, len(self._times))]) <= abs(t_s):
            self._step()
            self._table = None
        if self._table is None:
            order = slice(None, None, -1 if self._backwards else 1)  # a table has ascending times
            self._table = StateTable(np.array(self._times)[order], np.array(self._states)[order], "hermite", _NODES)
        return self._table

    def _step(self) -> None:
        message = self._solver.step()
        days = self._solver.t / SECONDS_PER_DAY
        if self._solver.status != "running" or not np.isfinite(self._solver.y).all():
            raise InputError(
                f"orbit: the integration stops {days:.3f} days after the epoch ({message or 'not finite'}); the "
                "trajectory meets the centre of a body"
            )
        self._times.append(float(self._solver.t))
        self._states.append(self._solver.y.copy())


@dataclass(eq=False)
class NumericalOrbit:
    """Orbit from a state at the epoch, integrated with the attraction of the centre, its zonal harmonics, and other
    bodies.

    Dormand and Prince's method of order 8 (Hairer, Nørsett & Wanner 1993, section II.10; SciPy's ``DOP853``) with a
    relative tolerance of 1e-12 per step; the error is 0.2 mm after 30 revolutions of a low orbit and 12 mm after 150.
    The steps do not depend on the times requested, so every process computes bit-identical states. Not modelled: drag,
    radiation pressure, tesseral harmonics, harmonics of the Moon, relativity."""

    clock: Clock
    """Epoch."""
    start: FloatArray
    """(6,): Position, km, and velocity, km/s, at the epoch, ICRF axes."""
    centre: str
    """Origin of the states: Earth, Moon or Sun."""
    model: ForceModel
    """Forces."""
    span_s: tuple[float, float]
    """Limits, seconds after the epoch."""
    _marches: dict[float, _March] = field(default_factory=dict, repr=False)

    @property
    def period_s(self) -> float:
        """Period of the osculating ellipse at the epoch."""
        return osculating_period_s(self.start[:3], self.start[3:], GM_KM3_S2[self.centre])

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, ICRF axes, at seconds since the epoch, shape (...).

        Raises
        ------
        InputError
            Outside the span, or if the integration fails.
        """
        t = np.asarray(t_s, dtype=float)
        refuse_outside(self.clock, t, self.span_s, "the ephemeris of the numerical propagator")
        # Two integrations start at the epoch, forwards and backwards; each is only started if a time needs it.
        flat, out = t.ravel(), np.empty((t.size, 6))
        for direction in (1.0, -1.0):
            rows = np.flatnonzero(flat * direction >= 0.0 if direction > 0.0 else flat < 0.0)
            if len(rows):
                out[rows] = self._interpolated(flat[rows], direction)
        return out[:, :3].reshape(*t.shape, 3), out[:, 3:].reshape(*t.shape, 3)

    def _interpolated(self, t_s: FloatArray, direction: float) -> FloatArray:
        if direction not in self._marches:
            forces = Forces(self.clock, self.centre, self.model)
            self._marches[direction] = _March(forces, self.start, direction)
        return self._marches[direction].reach(float(np.abs(t_s).max())).state(t_s)

    def __getstate__(self) -> dict[str, Any]:
        # A solver cannot be pickled; another process repeats the integration with bit-identical results.
        return self.__dict__ | {"_marches": {}}
