"""The spacecraft among the planets: barycentric position and velocity, from the Earth's and its orbit's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from simulator.sky.ephemeris import EARTH, state, tdb_jd
from startracker.constants import AU_KM
from startracker.observer import Observer

if TYPE_CHECKING:
    from simulator.mission.clock import Clock

__all__ = ["observe"]


def observe(clock: Clock, t_s: float, r_km: ArrayLike, v_km_s: ArrayLike) -> Observer:
    """Epoch, barycentric position and barycentric velocity of the spacecraft.

    The geocentric (GCRS) state is added to the Earth's barycentric one (BCRS) as it stands: the Lorentz terms between
    the two systems are 1e-8 of it, that is 7 cm and 0.1 mm/s.

    Parameters
    ----------
    clock : Clock
        The scenario's clock.
    t_s : float
        Seconds since its epoch.
    r_km, v_km_s : array_like, shape (3,)
        Geocentric position and velocity, GCRS axes.

    Raises
    ------
    InputError
        When the date lies outside DE421 (1899 to 2053).
    """
    earth_km, earth_km_s = state(EARTH, tdb_jd(*clock.tt_jd(t_s)))
    return Observer(
        epoch_jyear=float(clock.jyear(t_s)),
        velocity_km_s=earth_km_s + np.asarray(v_km_s, dtype=float),
        position_au=(earth_km + np.asarray(r_km, dtype=float)) / AU_KM,
    )
