"""Angles of boresights from the Sun, the Moon and the limb of the Earth."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from simulator.build import build_orbit
from simulator.constants import EARTH_RADIUS_KM
from simulator.mission.clock import Clock
from simulator.mission.trajectory import geocentric
from simulator.scenario import Scenario
from simulator.sky.ephemeris import barycentric_position_au
from startracker.core import AU_KM, FloatArray


def body_angles_deg(
    scenario: Scenario, t_s: FloatArray, directions: FloatArray, bodies: Iterable[str]
) -> dict[str, FloatArray]:
    """Angle (n,) by body, ``sun``, ``moon`` or ``earth``, for boresights along a scenario's orbit, degrees.

    Parameters
    ----------
    scenario : Scenario
        Orbit and epoch.
    t_s : (n,) array
        Seconds after the epoch.
    directions : (n, 3) array
        Unit vectors of the boresights, ICRS.
    bodies : iterable of str
        The bodies.
    """
    orbit = build_orbit(scenario)
    r_km = geocentric(orbit, t_s).r_km
    return {body: angle_from_deg(body, orbit.clock, t_s, r_km, directions) for body in bodies}


def angle_from_deg(body: str, clock: Clock, t_s: FloatArray, r_km: FloatArray, directions: FloatArray) -> FloatArray:
    """Angle (n,) of boresights from the centre of the ``sun`` or the ``moon`` (geometric positions), or from the limb
    of the ``earth``, negative within its disc, seen from geocentric positions `r_km` (n, 3), degrees."""
    if body == "earth":
        limb = np.degrees(np.arcsin(np.minimum(EARTH_RADIUS_KM / np.linalg.norm(r_km, axis=1), 1.0)))
        return np.asarray(_angle_deg(-r_km, directions) - limb)
    barycentric = (barycentric_position_au(each, clock, t_s) for each in (body.title(), "Earth"))
    return _angle_deg(np.subtract(*barycentric) * AU_KM - r_km, directions)


def _angle_deg(vectors: FloatArray, directions: FloatArray) -> FloatArray:
    cosine = np.sum(vectors * directions, axis=1) / np.linalg.norm(vectors, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
