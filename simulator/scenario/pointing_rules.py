"""Rules of the ``pointing`` section: contradictory keys."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from simulator.mission.clock import Clock
from simulator.mission.parameters import ATTITUDE_FILES, FILES, Waypoints
from simulator.mission.slews import build_slews
from simulator.scenario.errors import Violation, impossible
from startracker.errors import InputError

LAW_KEYS = {
    "target": ("target",),
    "spin": ("spin.rate_deg_s",),
    "attitude": tuple(f"attitude.{key}" for key in ATTITUDE_FILES),
    "waypoints": ("waypoints.points",),
    "track": ("track.target",),
}
"""Keys of the section that define the attitude, by law; null, an empty list and a rate of 0 do not."""


def attitude_files(v: Mapping[str, Any]) -> list[str]:
    """Keys of the files that define the attitude."""
    return [f"pointing.attitude.{key}" for key in ATTITUDE_FILES if v[f"pointing.attitude.{key}"] is not None]


def attitude_ends(v: Mapping[str, Any]) -> bool:
    """Whether the attitude is defined over a limited span: by a file, a spline, or a spacecraft on an orbit from a
    file."""
    spline = bool(v["pointing.waypoints.points"]) and v["pointing.waypoints.profile"] == "spline"
    followed = v["pointing.track.target"] == "spacecraft"
    other = followed and any(v[f"pointing.track.spacecraft.{key}"] is not None for key in FILES)
    return bool(attitude_files(v)) or spline or other


def contradictions(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Violated rules of the ``pointing`` section."""
    mounting = v["pointing.mounting"]
    if not isinstance(mounting, str) and math.hypot(*mounting) < 1e-6:
        yield impossible(
            "pointing.mounting", "a quaternion of zeros is not a rotation; use [0, 0, 0, 1] for no rotation"
        )
    if v["pointing.jitter.psd"] == "table" and v["pointing.jitter.table"] is None:
        yield impossible("pointing.jitter.table", "psd: table needs a CSV file (frequency_hz, psd)")
    if v["pointing.jitter.series"] is not None and any(v["pointing.jitter.rms_arcsec"]):
        message = (
            "the jitter is already defined by pointing.jitter.series, which has angles; set one of them to 0 or null"
        )
        yield impossible("pointing.jitter.rms_arcsec", message)
    yield from _laws(v)
    yield from _waypoints(v)


def _laws(v: Mapping[str, Any]) -> Iterator[Violation]:
    """The attitude may have only one definition."""
    if v["pointing.spin.rate_deg_s"] and v["pointing.target"] is not None:
        yield impossible(
            "pointing.spin.rate_deg_s", "a freely spinning body cannot hold a pointing.target; remove one of them"
        )
        return
    given = [f"pointing.{key}" for keys in LAW_KEYS.values() for key in keys if v[f"pointing.{key}"]]
    if len(given) > 1:
        yield impossible(given[1], f"the attitude is already defined by {given[0]}; set one of them to null")


def _waypoints(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Rules of slews, which are checked by building the attitude law."""
    points = v["pointing.waypoints.points"]
    limits = Waypoints(
        points,
        v["pointing.waypoints.profile"],
        v["pointing.waypoints.max_rate_deg_s"],
        v["pointing.waypoints.acceleration_deg_s2"],
    )
    # The mounting does not affect the times and rates of slews, so an identity serves.
    try:
        if points:
            build_slews(limits, Clock(v["epoch"]), np.array([0.0, 0.0, 0.0, 1.0]))
    except InputError as error:
        yield impossible("pointing.waypoints.points", str(error).removeprefix("pointing.waypoints: "))
