"""Rules of the ``orbit`` section: contradictory keys, and orbits that meet the surface."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from simulator.constants import RADIUS_KM
from simulator.mission.kepler import periapsis_km
from simulator.mission.orbit import SPHERE_OF_INFLUENCE_KM
from simulator.mission.parameters import FILES
from simulator.mission.trajectory import GM_KM3_S2
from simulator.scenario.errors import Violation, impossible, unphysical
from simulator.scenario.pointing_rules import attitude_ends

MIN_ORBIT_KM = 150.0
"""Below this altitude, drag causes re-entry within about one orbit (Vallado 2013, chapter 8)."""
_INFLUENCE_KM = {"Earth": SPHERE_OF_INFLUENCE_KM, "Moon": 66_100.0, "Sun": math.inf}
"""Spheres of influence, within which a state is near a conic: a (m/M)^(2/5)."""
GIVEN_BY = {"elements": "elements.semi_major_axis_km", "state": "state.position_km"}
"""Key of each section that defines an orbit, without which the section has no effect."""


def sources(v: Mapping[str, Any]) -> list[str]:
    """Keys of the ``orbit`` section that define an orbit other than the circular one."""
    keys = (*GIVEN_BY.values(), *FILES)
    return [key for key in keys if v[f"orbit.{key}"] is not None]


def contradictions(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Violated rules of the ``orbit`` section."""
    given = sources(v)
    if len(given) > 1:
        message = f"the orbit is already defined by orbit.{given[0]}; set one of them to null"
        yield impossible(f"orbit.{given[1]}", message)
        return
    if (v["orbit.state.position_km"] is None) != (v["orbit.state.velocity_km_s"] is None):
        missing = "velocity_km_s" if v["orbit.state.velocity_km_s"] is None else "position_km"
        yield impossible(f"orbit.state.{missing}", "a state vector needs both position_km and velocity_km_s")
    yield from _propagator(v, given[0].partition(".")[0] if given else "circular")
    yield from _periapsis(v)
    if v["study.sampling"] == "span" and not any(key in FILES for key in given) and not attitude_ends(v):
        message = "span is for orbits and attitudes that end, such as those of a file; use mission_year or orbit"
        yield impossible("study.sampling", message)
    if v["orbit.centre"] != "Earth" and not given:
        yield impossible("orbit.centre", "circular orbits are around the Earth; give orbit.elements or a state")


def _propagator(v: Mapping[str, Any], source: str) -> Iterator[Violation]:
    name, centre = v["orbit.propagator"], v["orbit.centre"]
    allowed = {"circular": ("j2", "sgp4", "numerical"), "state": ("numerical",)}.get(source, ())
    if source == "elements":
        mean = centre == "Earth" and v["orbit.frame"] in ("auto", "equator_of_date")
        allowed = ("j2", "kepler", "numerical") if mean else ("kepler", "numerical")
    if name != "auto" and name not in allowed:
        what = {"circular": "a circular orbit", "state": "a state vector", "elements": f"these elements ({centre})"}
        reason = f"{name} is not for {what.get(source, 'a file')}"
        yield impossible("orbit.propagator", f"{reason}; use {' or '.join(('auto', *allowed))}")


def _periapsis(v: Mapping[str, Any]) -> Iterator[Violation]:
    """An orbit by elements or by a state must pass above the surface of its centre."""
    centre, a_km = v["orbit.centre"], v["orbit.elements.semi_major_axis_km"]
    position, velocity = v["orbit.state.position_km"], v["orbit.state.velocity_km_s"]
    # A state outside the sphere of influence is not on a conic about the centre, and has no periapsis there.
    if a_km is not None:
        key, least_km = "elements.semi_major_axis_km", a_km * (1.0 - v["orbit.elements.eccentricity"])
    elif position is not None and velocity is not None and 0.0 < math.hypot(*position) < _INFLUENCE_KM[centre]:
        key, least_km = "state.velocity_km_s", periapsis_km(position, velocity, GM_KM3_S2[centre])
    else:
        return
    height_km = least_km - RADIUS_KM[centre]
    if height_km < (MIN_ORBIT_KM if centre == "Earth" else 0.0):
        where = "within the atmosphere or the Earth" if centre == "Earth" else "below the surface"
        yield unphysical(f"orbit.{key}", f"the periapsis is at a height of {height_km:.0f} km, {where}; raise it")
