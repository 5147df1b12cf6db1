"""Elliptical orbits from their elements: two bodies, and around the Earth the secular rates by J2."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.clock import Clock
from simulator.mission.frames import to_frame, to_gcrs
from simulator.mission.kepler import Elements, perifocal, plane_axes, secular_rates
from simulator.mission.trajectory import GM_KM3_S2, UNLIMITED
from startracker.core import FloatArray


@dataclass(frozen=True)
class EllipticOrbit:
    """Ellipse around a centre; with `j2`, its node, perigee and mean anomaly advance at their secular rates.

    With P towards the periapsis, Q 90° ahead of it, W along the angular momentum, and M = M₀ + Ṁ t:

        r = x P + y Q,   v = (Ṁ/n) (ẋ P + ẏ Q) + (ω̇ + Ω̇ cos i) W × r

    where x, y, ẋ, ẏ are the two-body position and velocity in the plane (`simulator.mission.kepler.perifocal`). For
    e = 0 the orbit is that of `J2Orbit`. As there, the velocity omits the cross-track term Ω̇ sin i, and the
    short-period terms of J2 are neglected, so that plane and ellipse are the mean ones; J3, J4, drag, Sun and Moon are
    neglected as well. A position around the Earth is accurate to some 20 km near the epoch, and to 6 km over a day of a
    Molniya orbit if the elements are fitted to it."""

    elements: Elements
    """Mean elements at the epoch with `j2`; otherwise osculating elements, which are constant."""
    clock: Clock
    """Epoch."""
    centre: str = "Earth"
    """Body at the focus."""
    frame: str = "equator_of_date"
    """Axes of the elements (`simulator.mission.frames.to_frame`)."""
    j2: bool = True
    """Secular rates by the Earth's J2; false: two bodies."""

    span_s = UNLIMITED

    @functools.cached_property
    def _rates(self) -> tuple[float, float, float]:
        if self.j2:
            return secular_rates(self.elements, GM_KM3_S2[self.centre])
        return 0.0, 0.0, math.sqrt(GM_KM3_S2[self.centre] / self.elements.semi_major_axis_km**3)

    @property
    def period_s(self) -> float:
        """Mean nodal period, from one ascending node to the next."""
        _, perigee, anomaly = self._rates
        return 2.0 * math.pi / (perigee + anomaly)

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, ICRF axes, at seconds since the epoch, shape (...)."""
        t, elements = np.asarray(t_s, dtype=float), self.elements
        node_rate, perigee_rate, anomaly_rate = self._rates
        gm = GM_KM3_S2[self.centre]
        flat, moving = perifocal(elements, elements.mean_anomaly_rad + anomaly_rate * t, gm)
        # `perifocal` gives the velocity for the Keplerian mean motion n; the anomaly advances at Ṁ.
        moving *= anomaly_rate / math.sqrt(gm / elements.semi_major_axis_km**3)
        turning = perigee_rate + node_rate * math.cos(elements.inclination_rad)
        p, q, _ = plane_axes(
            elements.inclination_rad, elements.node_rad + node_rate * t, elements.periapsis_rad + perigee_rate * t
        )
        x, y = flat[..., :1], flat[..., 1:]
        # The node that precesses by J2 refers to the equator of date; the plane of two bodies is inertially fixed, so
        # it is transformed with the axes of the epoch.
        matrix = to_frame(self.frame, self.clock, t if self.j2 else 0.0)
        r_km = to_gcrs(matrix, x * p + y * q)
        return r_km, to_gcrs(matrix, (moving[..., :1] - turning * y) * p + (moving[..., 1:] + turning * x) * q)
