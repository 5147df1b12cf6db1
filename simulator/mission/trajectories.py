"""Build the trajectory of a scenario's ``orbit`` section."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simulator.mission.clock import Clock
from simulator.mission.element_files import read_omm, read_tle
from simulator.mission.elliptic import EllipticOrbit
from simulator.mission.frames import to_frame
from simulator.mission.kepler import Elements
from simulator.mission.numerical import NumericalOrbit
from simulator.mission.oem import read_oem
from simulator.mission.orbit import J2Orbit, build_orbit
from simulator.mission.parameters import OrbitParameters
from simulator.mission.spk import read_spk
from simulator.mission.tabulated import read_csv
from simulator.mission.trajectory import Trajectory
from startracker.errors import InputError

_NUMERICAL_SPAN = (datetime(1899, 10, 1, tzinfo=UTC), datetime(2053, 8, 1, tzinfo=UTC))
"""Range of DE421, reduced by two months at either end, because the integrator needs some steps beyond a time."""


class _Given(NamedTuple):
    """A section with the clock and the folder of its files."""

    section: OrbitParameters
    clock: Clock
    folder: Path

    def file(self, key: str) -> Path:
        """File that a key of the section names."""
        return self.folder / str(getattr(self.section, key))

    def frame(self, otherwise: str) -> str:
        """Axes that the section states; `otherwise` for ``auto``."""
        return otherwise if self.section.frame == "auto" else self.section.frame


def build_trajectory(section: OrbitParameters, epoch: datetime, folder: Path = Path()) -> Trajectory:
    """Trajectory of a scenario's section.

    Parameters
    ----------
    section : OrbitParameters
        One of the keys `simulator.mission.parameters.SOURCES`, or a circular orbit.
    epoch : datetime
        With a time zone.
    folder : Path
        Folder of relative file names.

    Raises
    ------
    InputError
        For several sources, elements or a propagator that are impossible, or a file that cannot be used.
    """
    if len(section.sources) > 1:
        raise InputError(f"orbit: {' and '.join(section.sources)} both define the orbit; remove one of them")
    return _BUILDERS[section.source](_Given(section, Clock(epoch), folder))


def _circular(given: _Given) -> Trajectory:
    orbit = build_orbit(given.section, given.clock.epoch)
    if given.section.propagator == "numerical":
        assert isinstance(orbit, J2Orbit)
        # The mean elements at the epoch serve as osculating ones; for e = 0 the mean anomaly counts from the node.
        mean = orbit.elements
        elements = Elements(
            mean.semi_major_axis_km, 0.0, mean.inclination_rad, mean.raan_rad, 0.0, mean.argument_of_latitude_rad
        )
        return _integrated(given, EllipticOrbit(elements, given.clock, j2=False))
    return orbit


def _elliptic(given: _Given) -> Trajectory:
    section, keys = given.section, given.section.elements
    assert keys.semi_major_axis_km is not None
    if not (keys.semi_major_axis_km > 0.0 and 0.0 <= keys.eccentricity < 1.0):
        raise InputError(
            "orbit.elements: an ellipse needs a semi-major axis above 0 and an eccentricity below 1; "
            "give a hyperbola by orbit.state"
        )
    angles = (keys.inclination_deg, keys.raan_deg, keys.argument_of_periapsis_deg, keys.mean_anomaly_deg)
    elements = Elements(keys.semi_major_axis_km, keys.eccentricity, *(math.radians(angle) for angle in angles))
    # The secular rates by J2 refer to the equator of date; elements in other axes, or around other bodies, are those
    # of two bodies.
    around_earth = section.centre == "Earth"
    frame = given.frame({"Earth": "equator_of_date", "Sun": "ecliptic"}.get(section.centre, "icrf"))
    name = section.propagator if section.propagator != "auto" else "j2" if around_earth else "kepler"
    if name == "sgp4" or (name == "j2" and not (around_earth and frame == "equator_of_date")):
        raise InputError(
            f"orbit.propagator: {name} is not for these elements; use kepler or numerical"
            + (" (SGP4 takes elements from orbit.tle or orbit.omm)" if name == "sgp4" else "")
        )
    ellipse = EllipticOrbit(elements, given.clock, section.centre, frame, j2=name == "j2")
    return _integrated(given, ellipse) if name == "numerical" else ellipse


def _integrated(given: _Given, ellipse: EllipticOrbit) -> NumericalOrbit:
    """Numerical propagation from the osculating ellipse at the epoch."""
    return _numerical(given, np.concatenate(ellipse.state(0.0)), ellipse.centre)


def _state(given: _Given) -> Trajectory:
    section = given.section
    if section.state.velocity_km_s is None:
        raise InputError("orbit.state: velocity_km_s is missing")
    if section.propagator not in ("auto", "numerical"):
        raise InputError(f"orbit.propagator: {section.propagator} is not for a state vector; use numerical")
    matrix = to_frame(given.frame("icrf"), given.clock, 0.0)
    # A row vector times the matrix is its inverse times the vector: from the frame of the section to ICRF.
    start = np.concatenate([np.array(section.state.position_km) @ matrix, section.state.velocity_km_s @ matrix])
    return _numerical(given, start, section.centre)


def _numerical(given: _Given, start: np.ndarray, centre: str) -> NumericalOrbit:
    first, last = ((limit - given.clock.epoch).total_seconds() for limit in _NUMERICAL_SPAN)
    return NumericalOrbit(given.clock, start, centre, given.section.forces, (first, last))


_BUILDERS: dict[str, Callable[[_Given], Trajectory]] = {
    "circular": _circular,
    "elements": _elliptic,
    "state": _state,
    "tle": lambda g: read_tle(g.file("tle"), g.clock, g.section.object, g.section.max_age_days),
    "omm": lambda g: read_omm(g.file("omm"), g.clock, g.section.object, g.section.max_age_days),
    "oem": lambda g: read_oem(g.file("oem"), g.clock, None if g.section.object is None else str(g.section.object)),
    "spk": lambda g: read_spk(g.file("spk"), g.clock, g.section.object, g.section.centre),
    "csv": lambda g: read_csv(g.file("csv"), g.clock, g.section.centre, g.frame("icrf")),
}
"""Builder of the trajectory of each source."""
