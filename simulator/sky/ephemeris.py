"""Barycentric positions of bodies and of the spacecraft at the instants of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.core import AU_KM, FloatArray
from startracker.ephemeris import barycentric, de421, timescale
from startracker.observer import Observer

if TYPE_CHECKING:
    from simulator.mission.clock import Clock


def sky_time(clock: Clock, t_s: float | FloatArray) -> Any:
    """Skyfield's ``Time`` of seconds after the scenario's epoch, a number or an array (N,)."""
    return timescale().tt_jd(*clock.tt_jd(t_s))


def barycentric_position_au(body: str, clock: Clock, t_s: float | FloatArray) -> FloatArray:
    """Barycentric position of a body, au, ICRF axes: (3,), or (N, 3) for times (N,); `InputError` outside DE421."""
    return np.asarray(barycentric(body, sky_time(clock, t_s)).xyz.au.T)


if TYPE_CHECKING:
    from simulator.mission.clock import Clock


def barycentric_state(
    clock: Clock, t_s: float | FloatArray, r_km: ArrayLike, v_km_s: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Barycentric position, au, and velocity, km/s, of the spacecraft; (3,), or (N, 3) for times (N,).

    The geocentric (GCRS) state is added to the Earth's barycentric state (BCRS) directly: the relativistic terms
    between the two systems are 1e-8 of it, that is 7 cm and 0.1 mm/s.

    Parameters
    ----------
    clock : Clock
        The scenario's clock.
    t_s : float or array, shape (N,)
        Seconds since its epoch.
    r_km, v_km_s : array_like, shape (3,) or (N, 3)
        Geocentric position and velocity, GCRS axes.

    Raises
    ------
    InputError
        If a date is outside DE421 (1899 to 2053).
    """
    earth = barycentric("Earth", sky_time(clock, t_s))
    # Skyfield's arrays have the components first; the transpose has shape (3,) or (N, 3).
    position_au = earth.xyz.au.T + np.asarray(r_km, dtype=float) / AU_KM
    return position_au, earth.velocity.km_per_s.T + np.asarray(v_km_s, dtype=float)


def observe(clock: Clock, t_s: float, r_km: ArrayLike, v_km_s: ArrayLike) -> Observer:
    """Epoch and `barycentric_state` of the spacecraft at one instant."""
    position_au, velocity_km_s = barycentric_state(clock, t_s, r_km, v_km_s)
    return Observer(float(clock.jyear(t_s)), velocity_km_s=velocity_km_s, position_au=position_au)


def is_sunlit(clock: Clock, t_s: float | FloatArray, r_km: FloatArray) -> NDArray[np.bool_]:
    """Whether the centre of the Sun is not occulted by the spherical Earth; Skyfield's ``is_sunlit``; () or (N,)."""
    from skyfield.positionlib import Geocentric

    return np.asarray(Geocentric(r_km.T / AU_KM, t=sky_time(clock, t_s)).is_sunlit(de421()), dtype=bool)
