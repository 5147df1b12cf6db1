"""Checks of names in a scenario that refer to later stages: algorithms, catalogues, mountings, curves.

The scenario package may not import those stages. It takes these checks as an argument instead, so that an unknown name
is reported with its line, together with all other mistakes of the file.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.mission.parameters import ATTITUDE_FILES, FILES, AttitudeSource, OrbitParameters
from simulator.scenario import Scenario
from simulator.scenario.fields import NameChecks
from startracker.arguments import of_kind
from startracker.errors import InputError
from startracker.settings.registry import lookup

if TYPE_CHECKING:
    from simulator.optics.curves import CurveKind

NameCheck = Callable[[Any, Mapping[str, Any]], str | None]


def load_scenario(
    path: str | os.PathLike[str],
    overrides: Sequence[str] | None = None,
    *,
    trials: int | None = None,
    seed: int | None = None,
) -> Scenario:
    """`Scenario.load` with all names checked.

    Raises
    ------
    ScenarioError
        With all mistakes of the file, its bases and the options.
    """
    return Scenario.load(path, overrides or (), seed=seed, trials=trials, names=NAME_CHECKS)


def as_scenario(given: Any) -> Scenario:
    """Convert an argument to a `Scenario`: it may be one already, the name of an included one, or a file.

    Raises
    ------
    InputError
        For anything else; `ScenarioError` with all mistakes of the file.
    """
    if isinstance(given, str | os.PathLike):
        return load_scenario(given)
    return of_kind("scenario", given, Scenario, "or the name of one")


def _registered(kind: str, module: str, registry: str) -> NameCheck:
    """Check of a name against a registry and the entry points of its kind; the module is imported on first use."""

    def check(name: Any, _: Mapping[str, Any]) -> str | None:
        if not isinstance(name, str):  # a mounting may be a quaternion, which needs no check here
            return None
        try:
            lookup(kind, getattr(import_module(module), registry), name)
        except InputError as error:
            return str(error)
        return None

    return check


def _catalog(name: Any, _: Mapping[str, Any]) -> str | None:
    """Check of the name of a catalogue against the built-in ones, those that were added, and entry points."""
    from startracker.catalog import known_catalogs

    try:
        lookup("catalogs", known_catalogs(), name)
    except InputError as error:
        return str(error)
    return None


def _curve(kind: CurveKind) -> NameCheck:
    def check(spec: Any, _: Mapping[str, Any]) -> str | None:
        from simulator.optics.curves import load_curve

        try:
            load_curve(spec, kind, Path())  # the loader has made file names absolute
        except InputError as error:
            return str(error)
        return None

    return check


def _target(name: Any, keys: Mapping[str, Any]) -> str | None:
    """Check of ``pointing.target`` against the sky that the scenario renders."""
    if not isinstance(name, str):  # a direction
        return None
    from simulator.sky.target import find_target
    from startracker.catalog import load_catalog

    try:
        # Keys whose values are invalid are missing; their errors are reported by other checks.
        sky = load_catalog(keys.get("sky.catalog", "hipparcos"))
        found = find_target(name, sky.brighter_than(keys.get("sky.magnitude_limit", math.inf)))
    except InputError as error:
        return str(error)
    if isinstance(found, str) and not keys.get("sky.planets", True):
        return f"{found} is not rendered; set sky.planets: true"
    return None


def _orbit_file(key: str, section: str = "orbit") -> NameCheck:
    """Check of a file of an orbit section, together with the keys that define how it is read."""

    def check(name: Any, keys: Mapping[str, Any]) -> str | None:
        from simulator.mission.trajectories import build_trajectory

        # If several files are given, the rules of the orbit section report it; a check of each would add errors that
        # have the same cause.
        others = {k: keys.get(f"{section}.{k}") for k in FILES}
        if not isinstance(name, str) or "epoch" not in keys or any(others[k] for k in FILES if k != key):
            return None
        plain = ("object", "centre", "frame", "max_age_days")
        given: dict[str, Any] = {k: keys[f"{section}.{k}"] for k in plain if f"{section}.{k}" in keys}
        try:
            build_trajectory(OrbitParameters(**(given | {key: name})), keys["epoch"])
        except InputError as error:
            return str(error)
        return None

    return check


def _satellite_file(name: Any, keys: Mapping[str, Any]) -> str | None:
    """Check of ``sky.satellites.file``, together with the objects to which the scenario assigns a size."""
    from simulator.mission.clock import Clock
    from simulator.sky.parameters import SatelliteParameters
    from simulator.sky.satellites import load_satellites

    if not isinstance(name, str) or "epoch" not in keys:
        return None
    try:
        given = SatelliteParameters(file=name, objects=keys.get("sky.satellites.objects", ()))
        load_satellites(given, Clock(keys["epoch"]), Path())  # the loader has made file names absolute
    except InputError as error:
        return str(error)
    return None


def _attitude_file(key: str) -> NameCheck:
    """Check of a file of ``pointing.attitude``, together with the keys that define how it is read."""

    def check(name: Any, keys: Mapping[str, Any]) -> str | None:
        from simulator.mission.attitudes import attitude_from_file
        from simulator.mission.clock import Clock

        prefix = "pointing.attitude."
        given = {k.removeprefix(prefix): value for k, value in keys.items() if k.startswith(prefix)}
        section = AttitudeSource(**(given | {key: name}))
        if name is None or "epoch" not in keys or len(section.sources) > 1:
            return None
        try:
            # The mounting is not known here. An identity is enough to find out whether the file can be read.
            attitude_from_file(section, Clock(keys["epoch"]), np.array([0.0, 0.0, 0.0, 1.0]), Path())
        except InputError as error:
            return str(error)
        return None

    return check


def _jitter_series(name: Any, keys: Mapping[str, Any]) -> str | None:
    """Check of the table of ``pointing.jitter.series``."""
    from simulator.mission.clock import Clock
    from simulator.mission.jitter_table import read_jitter
    from simulator.optics.jitter import Jitter

    if name is None or "epoch" not in keys:
        return None
    try:
        read_jitter(Jitter(series=name), Clock(keys["epoch"]), Path())
    except InputError as error:
        return str(error)
    return None


ORBITS = ("orbit", "pointing.track.spacecraft")
"""Sections of orbits."""

NAME_CHECKS: NameChecks = {
    **{f"{section}.{key}": _orbit_file(key, section) for section in ORBITS for key in FILES},
    **{f"pointing.attitude.{key}": _attitude_file(key) for key in ATTITUDE_FILES},
    "pointing.jitter.series": _jitter_series,
    "pointing.target": _target,
    "pointing.mounting": _registered("mountings", "simulator.mission.pointing", "MOUNTINGS"),
    "sky.catalog": _catalog,
    "sky.satellites.file": _satellite_file,
    "sky.spectrum": _registered("spectra", "simulator.sky.spectra", "SPECTRA"),
    "optics.transmission": _curve("transmission"),
    "optics.psf.model": _registered("psfs", "simulator.optics.psf", "PSFS"),
    "detector.quantum_efficiency": _curve("quantum_efficiency"),
    "tracker.catalog": _catalog,
    "tracker.detector": _registered("detectors", "startracker.detection", "METHODS"),
    "tracker.centroider": _registered("centroiders", "startracker.centroid", "METHODS"),
    "tracker.identifier": _registered("identifiers", "startracker.identification", "METHODS"),
    "tracker.estimator": _registered("estimators", "startracker.estimation", "METHODS"),
}
"""Checks of values by the dotted path of their key, for `Scenario.load`."""
