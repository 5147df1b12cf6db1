"""Accelerations of a spacecraft: its centre, the Earth's zonal harmonics, and other bodies as point masses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import chebyshev

from simulator.constants import EARTH_RADIUS_KM, EARTH_ZONALS
from simulator.mission.clock import SECONDS_PER_DAY, Clock
from simulator.mission.frames import true_of_date
from simulator.mission.parameters import ForceModel
from simulator.mission.trajectory import GM_KM3_S2, centre_state
from startracker._compiled import kernel
from startracker.core import FloatArray

BODIES = {
    "Earth": ("Sun", "Moon"),
    "Moon": ("Earth", "Sun"),
    "Sun": ("Mercury", "Venus", "Earth", "Moon", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune"),
}
"""Bodies that act on a spacecraft beside the centre of its trajectory."""

_BLOCK_S = 4.0 * SECONDS_PER_DAY
_DEGREE = 15
"""Degree of the Chebyshev polynomials of the bodies and the pole over blocks of four days. DE421's own polynomials for
the Moon have degree 12 over the same interval."""


@dataclass
class Forces:
    """Acceleration relative to a centre, as a function of time and state."""

    clock: Clock
    """Epoch of the times."""
    centre: str
    """Origin: Earth, Moon or Sun."""
    model: ForceModel
    _blocks: dict[int, FloatArray] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        self._bodies = BODIES[self.centre] if self.model.third_bodies else ()
        self._gm = np.array([GM_KM3_S2[self.centre], *(GM_KM3_S2[body] for body in self._bodies)])
        self._zonals = np.array(EARTH_ZONALS[: max(self.model.zonal_degree - 1, 0)] if self.centre == "Earth" else ())

    def derivative(self) -> Callable[[float, FloatArray], FloatArray]:
        """Right-hand side f(t, y) of the equations of motion, y = (position, velocity), km and km/s."""

        def slope(t_s: float, y: FloatArray) -> FloatArray:
            # Ephemerides cost milliseconds per call, and the integrator calls this a dozen times per step: the
            # polynomials of a block replace them.
            block, part = divmod(t_s / _BLOCK_S, 1.0)
            return np.asarray(_derivative(y, self._block(int(block)), 2.0 * part - 1.0, self._gm, self._zonals))

        return slope

    def _block(self, number: int) -> FloatArray:
        """Chebyshev coefficients (degree + 1, bodies + 1, 3) of the pole and of the bodies relative to the centre."""
        if number not in self._blocks:
            points = chebyshev.chebpts1(_DEGREE + 1)
            t_s = (number + (points + 1.0) / 2.0) * _BLOCK_S
            origin = centre_state(self.centre, self.clock, t_s).r_km
            # The third row of the matrix is the Earth's pole of date in GCRS, the axis of the zonal harmonics.
            columns = [true_of_date(self.clock, t_s)[:, 2]]
            columns += [centre_state(body, self.clock, t_s).r_km - origin for body in self._bodies]
            values = np.stack(columns, axis=1).reshape(len(t_s), -1)
            fitted = chebyshev.chebfit(points, values, _DEGREE)
            self._blocks[number] = np.ascontiguousarray(fitted.reshape(_DEGREE + 1, -1, 3))
        return self._blocks[number]


@kernel
def _derivative(y: FloatArray, block: FloatArray, at: float, gm: FloatArray, zonals: FloatArray) -> FloatArray:
    """Velocity and `acceleration` (6,) of a state; pole and bodies are evaluated from their polynomials by Clenshaw's
    recurrence."""
    degree, columns = block.shape[0] - 1, block.shape[1]
    # Clenshaw's recurrence b_k = c_k + 2x b_(k+1) − b_(k+2) for every column, and Σ = c₀ + x b₁ − b₂.
    near = np.empty((columns, 3))
    for n in range(columns):
        for axis in range(3):
            high, low = 0.0, 0.0
            for order in range(degree, 0, -1):
                high, low = block[order, n, axis] + 2.0 * at * high - low, high
            near[n, axis] = block[0, n, axis] + at * high - low
    out = np.empty(6)
    out[:3] = y[3:]
    out[3:] = acceleration(y[:3], near[0], near[1:], gm, zonals)
    return out


@kernel
def acceleration(
    r_km: FloatArray, pole: FloatArray, bodies_km: FloatArray, gm_km3_s2: FloatArray, zonals: FloatArray
) -> FloatArray:
    """Acceleration (3,), km/s².

    Zonal harmonics: the gradient of −μ/r Σ Jₙ (R/r)ⁿ Pₙ(u), u = r̂·ẑ (Vallado 2013, section 8.6),

        a = μ/r² Σ Jₙ (R/r)ⁿ {[(n + 1) Pₙ + u Pₙ′] r̂ − Pₙ′ ẑ};

    other bodies: μ_b [(s − r)/|s − r|³ − s/|s|³], the acceleration of the spacecraft minus that of the centre (section
    8.6).

    Parameters
    ----------
    r_km : array, shape (3,)
        Position relative to the centre.
    pole : array, shape (3,)
        Axis of symmetry ẑ of the zonal harmonics.
    bodies_km : array, shape (N, 3)
        Positions of other bodies relative to the centre.
    gm_km3_s2 : array, shape (N + 1,)
        Gravitational parameters of the centre and of the bodies.
    zonals : array, shape (M,)
        J2, J3, … of the centre; may be empty.
    """
    r = math.sqrt(r_km[0] * r_km[0] + r_km[1] * r_km[1] + r_km[2] * r_km[2])
    pull = gm_km3_s2[0] / (r * r)
    u = (r_km[0] * pole[0] + r_km[1] * pole[1] + r_km[2] * pole[2]) / r
    # The acceleration is pull · (along r̂ + across ẑ); the −1 is the attraction of the central mass.
    along, across = -1.0, 0.0
    before, now, slope_before, slope = 1.0, u, 0.0, 1.0  # P0, P1 and their derivatives
    power = EARTH_RADIUS_KM / r
    for k in range(len(zonals)):
        n = k + 2
        # Bonnet's recurrence for Pₙ, and Pₙ′ = Pₙ₋₂′ + (2n − 1) Pₙ₋₁; `before` is Pₙ₋₁ after the first line.
        before, now = now, ((2 * n - 1) * u * now - (n - 1) * before) / n
        slope_before, slope = slope, slope_before + (2 * n - 1) * before
        power *= EARTH_RADIUS_KM / r
        along += zonals[k] * power * ((n + 1) * now + u * slope)
        across -= zonals[k] * power * slope
    out: FloatArray = pull * (along / r * r_km + across * pole)
    for n in range(len(bodies_km)):
        away, far = 0.0, 0.0
        for axis in range(3):
            away += (bodies_km[n, axis] - r_km[axis]) ** 2
            far += bodies_km[n, axis] ** 2
        direct, indirect = gm_km3_s2[n + 1] / away**1.5, gm_km3_s2[n + 1] / far**1.5
        for axis in range(3):
            out[axis] += direct * (bodies_km[n, axis] - r_km[axis]) - indirect * bodies_km[n, axis]
    return out
