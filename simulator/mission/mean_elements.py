"""Two-line elements and orbit mean-elements messages (CCSDS 502.0-B-3), propagated by SGP4."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import erfa
import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.ccsds import Item, read_items
from simulator.mission.clock import SECONDS_PER_DAY, Clock
from simulator.mission.frames import teme, to_gcrs
from simulator.mission.trajectory import refuse_outside
from startracker.arrays import FloatArray
from startracker.errors import InputError
from startracker.files import MESSAGE_BYTES, read_text

SGP4_EPOCH = datetime(1949, 12, 31)
_REVOLUTIONS_DAY_TO_RAD_MIN = 2.0 * math.pi / 1440.0


class MeanElements(NamedTuple):
    """One set of elements as SGP4 takes them, in TEME: radians, radians per minute, days."""

    name: str
    number: str
    """Name and catalogue number."""
    position: str
    """File and line."""
    epoch_jd: tuple[float, float]
    """Two-part Julian date UTC."""
    bstar: float
    """Drag term, 1/Earth radii."""
    eccentricity: float
    periapsis_rad: float
    inclination_rad: float
    mean_anomaly_rad: float
    mean_motion_rad_min: float
    """Kozai's mean motion."""
    node_rad: float


@dataclass(frozen=True)
class MeanElementsOrbit:
    """Mean elements through SGP4 (SDP4 above 225 minutes; Vallado et al. 2006; python-sgp4, constants of WGS 72), from
    TEME into GCRS.

    Accurate to about 1 km at the epoch, and to 1 to 3 km more for each day from it in a low orbit (Vallado et al.
    2006); therefore limited to `max_age_days`."""

    elements: MeanElements
    """The set of elements."""
    clock: Clock
    """Epoch of the times, which may differ from that of the elements."""
    max_age_days: float
    """Longest time from the epoch of the elements."""

    centre = "Earth"

    @functools.cached_property
    def _epoch_s(self) -> float:
        return epoch_s(self.elements, self.clock)

    @property
    def span_s(self) -> tuple[float, float]:
        """`max_age_days` before and after the epoch of the elements."""
        age_s = self.max_age_days * SECONDS_PER_DAY
        return self._epoch_s - age_s, self._epoch_s + age_s

    @property
    def period_s(self) -> float:
        """Nodal period from SGP4's secular rates of mean anomaly and perigee."""
        satellite = _satellite(self.elements)
        return 60.0 * 2.0 * math.pi / float(satellite.mdot + satellite.argpdot)

    def state(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3), km, and velocity (..., 3), km/s, in GCRS at seconds since the clock's epoch, shape (...).

        Raises
        ------
        InputError
            Outside the span, or if SGP4 reports an error (a decayed orbit, diverging elements).
        """
        t = np.asarray(t_s, dtype=float)
        what = f"{self.elements.position}: the set of elements with orbit.max_age_days = {self.max_age_days:g}"
        refuse_outside(self.clock, t, self.span_s, what)
        satellite = _satellite(self.elements)
        # SGP4 subtracts its own epoch again: these are elapsed SI seconds, independent of leap seconds
        days = satellite.jdsatepochF + (t.ravel() - self._epoch_s) / SECONDS_PER_DAY
        error, position, velocity = satellite.sgp4_array(np.full(days.shape, satellite.jdsatepoch), days)
        if error.any():
            from sgp4.api import SGP4_ERRORS

            raise InputError(f"{self.elements.position}: SGP4 stops: {SGP4_ERRORS[int(error[error != 0][0])]}")
        matrix = teme(self.clock, t)
        return to_gcrs(matrix, position.reshape(*t.shape, 3)), to_gcrs(matrix, velocity.reshape(*t.shape, 3))


def epoch_s(elements: MeanElements, clock: Clock) -> float:
    """Epoch of a set of elements, SI seconds after that of a clock."""
    # elements count days of 86,400 s; ERFA's quasi Julian date would stretch a day with a leap second
    leap_s, _ = erfa.ufunc.dat(*erfa.ufunc.jd2cal(*elements.epoch_jd)[:4])
    tt1, tt2, _ = erfa.ufunc.taitt(elements.epoch_jd[0], elements.epoch_jd[1] + leap_s / SECONDS_PER_DAY)
    first1, first2 = clock.tt_jd(0.0)
    return float(((tt1 - first1) + (tt2 - first2)) * SECONDS_PER_DAY)


def read_elements(path: Path) -> list[MeanElements]:
    """Every set of elements of a file: a CCSDS OMM in KVN or XML (``.omm``, ``.xml``, ``.kvn``), otherwise two-line
    elements; `InputError` as `read_tle`."""
    return _messages(path) if path.suffix.lower() in (".omm", ".xml", ".kvn") else list(_two_lines(path))


def read_tle(path: Path, clock: Clock, wanted: str | int | None, max_age_days: float) -> MeanElementsOrbit:
    """Orbit of a file of two-line elements, with or without lines of names.

    Of several sets of the same object, the one whose epoch is closest to the scenario's is used.

    Parameters
    ----------
    path : Path
        The file; lines that start with ``#`` are comments.
    clock : Clock
        The scenario's clock.
    wanted : str, int or None
        Name or catalogue number; needed if the file has several objects.
    max_age_days : float
        As `MeanElementsOrbit.max_age_days`.

    Raises
    ------
    InputError
        With file and line: a line that is no TLE, a wrong check digit, an incomplete set; or no such object.
    """
    return _nearest(path, list(_two_lines(path)), clock, wanted, max_age_days)


def read_omm(path: Path, clock: Clock, wanted: str | int | None, max_age_days: float) -> MeanElementsOrbit:
    """Orbit of a CCSDS OMM in KVN or XML, in which several may follow each other; as `read_tle`."""
    return _nearest(path, _messages(path), clock, wanted, max_age_days)


def _messages(path: Path) -> list[MeanElements]:
    sets: list[dict[str, Item]] = [{}]
    for item in read_items(path, "OMM"):
        if item.key in sets[-1] and item.key in ("OBJECT_NAME", "CCSDS_OMM_VERS"):
            sets.append({})
        if item.key[:1] not in ("+", "-"):
            sets[-1].setdefault(item.key, item)
    return [_of_message(path, keys) for keys in sets]


def _nearest(
    path: Path, sets: list[MeanElements], clock: Clock, wanted: str | int | None, max_age_days: float
) -> MeanElementsOrbit:
    """The wanted object's set with the epoch closest to the clock's."""
    chosen = [e for e in sets if wanted is None or str(wanted).strip().lower() in (e.name.lower(), e.number)]
    objects = {(e.number, e.name) for e in sets}
    if not chosen or len({e.number for e in chosen}) > 1:
        known = ", ".join(f"{number} {name}".strip() for number, name in sorted(objects)[:12])
        more = f" and {len(objects) - 12} more" if len(objects) > 12 else ""
        raise InputError(f"{path}: choose one of its objects by orbit.object: {known}{more}")
    orbits = [MeanElementsOrbit(elements, clock, max_age_days) for elements in chosen]
    return min(orbits, key=lambda orbit: abs(sum(orbit.span_s)))


def _two_lines(path: Path) -> Iterator[MeanElements]:
    name, first = "", None
    position = f"{path}:1"
    for number, raw in enumerate(read_text(path, MESSAGE_BYTES, "give a file of two-line elements").splitlines(), 1):
        line, position = raw.rstrip(), f"{path}:{number}"
        if not line.strip() or line.startswith("#"):
            continue
        if first is not None:
            yield _of_lines(name, *first, (position, line))
            name, first = "", None
        elif line.startswith("1 ") and len(line) > 24:
            first = (position, line)
        elif line.startswith("2 ") and len(line) > 24:
            raise InputError(f"{position}: line 2 of a set without its line 1; the file is damaged")
        else:
            name = line.removeprefix("0 ").strip()
    if first is not None:
        raise InputError(f"{position}: the set of elements ends after line 1; the file is truncated")
    if name:
        raise InputError(f"{position}: is not a line of two-line elements (1 NNNNN…, 2 NNNNN…)")


def _of_lines(name: str, position1: str, line1: str, second: tuple[str, str]) -> MeanElements:
    """Elements of two lines; python-sgp4 reads their columns."""
    from sgp4.api import WGS72, Satrec
    from sgp4.io import compute_checksum

    position2, line2 = second
    for position, line, begins in ((position1, line1, "1 "), (position2, line2, "2 ")):
        if not line.startswith(begins) or len(line) < 69 or not line.isascii():
            raise InputError(f"{position}: is not line {begins.strip()} of two-line elements, 69 characters")
        if line[68] != str(compute_checksum(line)):
            raise InputError(f"{position}: check digit {line[68]}, but the line adds up to {compute_checksum(line)}")
    try:
        _verify_numbers(line1, line2)
        found = Satrec.twoline2rv(line1, line2, WGS72)
    except ValueError as error:
        raise InputError(f"{position2}: {str(error).splitlines()[0]}") from None
    if found.error not in (0, 6):
        raise InputError(f"{position2}: {found.error_message or 'impossible elements'}")
    return MeanElements(
        name,
        str(found.satnum),
        position1,
        (float(found.jdsatepoch), float(found.jdsatepochF)),
        float(found.bstar),
        float(found.ecco),
        float(found.argpo),
        float(found.inclo),
        float(found.mo),
        float(found.no_kozai),
        float(found.nodeo),
    )


def _verify_numbers(line1: str, line2: str) -> None:
    """`ValueError` unless both lines have the same object, and numbers in the columns of numbers."""
    if line1[2:7] != line2[2:7]:
        raise ValueError(f"lines 1 and 2 are of the objects {line1[2:7]} and {line2[2:7]}")
    for text in (line1[18:20], line1[20:32], line2[8:16], line2[17:25], line2[34:42], line2[43:51], line2[52:63]):
        float(text)


_OMM_FIELDS = (
    "BSTAR",
    "ECCENTRICITY",
    "ARG_OF_PERICENTER",
    "INCLINATION",
    "MEAN_ANOMALY",
    "MEAN_MOTION",
    "RA_OF_ASC_NODE",
)


def _of_message(path: Path, keys: dict[str, Item]) -> MeanElements:
    """Elements of one OMM."""
    expected: dict[str, tuple[str, ...]] = {
        "CENTER_NAME": ("EARTH",),
        "REF_FRAME": ("TEME",),
        "TIME_SYSTEM": ("UTC",),
        "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4"),
    }
    for key in ("OBJECT_NAME", "EPOCH", *_OMM_FIELDS, *expected):
        if key not in keys:
            raise InputError(f"{path}: the message has no {key}; it is incomplete or truncated")
    for key, allowed in expected.items():
        if keys[key].value.upper() not in allowed:
            raise InputError(f"{keys[key].position}: {key} is {keys[key].value}; SGP4 needs {' or '.join(allowed)}")
    numbers = []
    for key in _OMM_FIELDS:
        try:
            numbers.append(float(keys[key].value))
        except ValueError:
            raise InputError(f"{keys[key].position}: {key} is '{keys[key].value}', which is not a number") from None
    bstar, eccentricity, periapsis, inclination, anomaly, motion, node = numbers
    if not (0.0 <= eccentricity < 1.0 and motion > 0.0):
        raise InputError(f"{keys['ECCENTRICITY'].position}: eccentricity {eccentricity:g} with mean motion {motion:g}")
    try:
        epoch = datetime.fromisoformat(keys["EPOCH"].value.removesuffix("Z"))
    except ValueError:
        raise InputError(f"{keys['EPOCH'].position}: '{keys['EPOCH'].value}' is no epoch in UTC") from None
    days = epoch - SGP4_EPOCH
    number = keys.get("NORAD_CAT_ID")
    return MeanElements(
        keys["OBJECT_NAME"].value,
        number.value.lstrip("0") if number else keys["OBJECT_NAME"].value,
        keys["OBJECT_NAME"].position,
        (2_433_281.5 + days.days, days.seconds / SECONDS_PER_DAY + days.microseconds * 1e-6 / SECONDS_PER_DAY),
        bstar,
        eccentricity,
        math.radians(periapsis),
        math.radians(inclination),
        math.radians(anomaly),
        motion * _REVOLUTIONS_DAY_TO_RAD_MIN,
        math.radians(node),
    )


@functools.lru_cache(maxsize=64)
def _satellite(elements: MeanElements) -> Any:
    """SGP4's record, cached here because it cannot be pickled."""
    return sgp4_record(elements)


def sgp4_record(elements: MeanElements) -> Any:
    """SGP4's record of a set of elements, python-sgp4's ``Satrec``."""
    from sgp4.api import WGS72, Satrec

    satellite = Satrec()
    day, part = elements.epoch_jd
    satellite.sgp4init(
        WGS72,
        "i",  # the improved mode of operation
        0,  # the number has no effect
        (day - 2_433_281.5) + part,
        elements.bstar,
        0.0,  # first and second derivative of the mean motion, which SGP4 does not use
        0.0,
        elements.eccentricity,
        elements.periapsis_rad,
        elements.inclination_rad,
        elements.mean_anomaly_rad,
        elements.mean_motion_rad_min,
        elements.node_rad,
    )
    return satellite
