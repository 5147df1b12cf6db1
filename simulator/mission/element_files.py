"""Files of mean elements: two-line elements, and orbit mean-elements messages (CCSDS 502.0-B-2 and B-3).

Only elements of SGP4 are read; a field that selects another theory, reference frame or time scale is an error that
names the field.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from simulator.mission.ccsds import Item, read_items
from simulator.mission.clock import Clock
from simulator.mission.epochs import utc_days
from simulator.mission.mean_elements import MeanElements, MeanElementsOrbit
from simulator.mission.segments import warn_of
from startracker.errors import InputError
from startracker.files import MESSAGE_BYTES, read_text

_REVOLUTIONS_DAY_TO_RAD_MIN = 2.0 * math.pi / 1440.0
_GM_KM3_S2 = 398_600.8
"""Gravitational parameter of WGS 72, with which elements of SGP4 are fitted."""
_OTHER_THEORIES = {
    "1": "SGP",
    "3": "SDP4 or PPT3",
    "4": "SGP4-XP or SGP8",
    "5": "SDP8",
    "6": "special perturbations",
}
"""Theories of other ephemeris types; SGP4 has the types 0 and 2 (Hoots & Roehrich 1980; CCSDS 502.0-B-3, section
4.2.4)."""


def read_elements(path: Path) -> list[MeanElements]:
    """Every set of elements of a file: a CCSDS OMM in KVN or XML (``.omm``, ``.xml``, ``.kvn``), otherwise two-line
    elements; `InputError` as `read_tle`."""
    return _messages(path) if path.suffix.lower() in (".omm", ".xml", ".kvn") else list(_two_lines(path))


def read_tle(path: Path, clock: Clock, wanted: str | int | None, max_age_days: float) -> MeanElementsOrbit:
    """Orbit of a file of two-line elements, with or without lines of names.

    Of several sets of the same object, the one whose epoch is closest to the scenario's is used. Blanks before a line
    and text around the sets, as in bulletins, are ignored. A line without its check digit (68 characters) is read with
    an `InputWarning`.

    Parameters
    ----------
    path : Path
        The file; lines that start with ``#`` are comments.
    clock : Clock
        The scenario's clock.
    wanted : str, int or None
        Name, catalogue number (also in the form of letter and four digits) or international designator; needed if the
        file has several objects.
    max_age_days : float
        As `MeanElementsOrbit.max_age_days`.

    Raises
    ------
    InputError
        With file and line: a line that is not a TLE, a wrong check digit, an incomplete set, an ephemeris type other
        than SGP4's; or no such object.
    """
    return _nearest(path, list(_two_lines(path)), clock, wanted, max_age_days)


def read_omm(path: Path, clock: Clock, wanted: str | int | None, max_age_days: float) -> MeanElementsOrbit:
    """Orbit of a file with one or several CCSDS OMM in KVN or XML; parameters and errors as in `read_tle`."""
    return _nearest(path, _messages(path), clock, wanted, max_age_days)


def _nearest(
    path: Path, sets: list[MeanElements], clock: Clock, wanted: str | int | None, max_age_days: float
) -> MeanElementsOrbit:
    """Set of elements of the wanted object whose epoch is closest to that of the clock."""
    chosen = [e for e in sets if wanted is None or is_called(e, wanted)]
    objects = {(e.number, e.name) for e in sets}
    if not chosen or len({e.number for e in chosen}) > 1:
        known = ", ".join(f"{number} {name}".strip() for number, name in sorted(objects)[:12])
        more = f" and {len(objects) - 12} more" if len(objects) > 12 else ""
        raise InputError(f"{path}: choose one of its objects by orbit.object: {known}{more}")
    orbits = [MeanElementsOrbit(elements, clock, max_age_days) for elements in chosen]
    # The span is symmetric about the epoch of the elements, so its sum is twice their distance from the clock's epoch.
    return min(orbits, key=lambda orbit: abs(sum(orbit.span_s)))


def is_called(elements: MeanElements, wanted: str | int) -> bool:
    """Whether `wanted` is the name, the catalogue number (also as a letter and four digits, "alpha-5") or the
    international designator of the object of these elements."""
    from sgp4.alpha5 import from_alpha5

    text = str(wanted).strip()
    number = str(from_alpha5(text.upper())) if re.fullmatch("[A-HJ-NP-Za-hj-np-z][0-9]{4}", text) else text
    return number == elements.number or text.lower() in (elements.name.lower(), elements.designator.lower())


# ---------------------------------------------------------------- two-line elements
class _Line(NamedTuple):
    """A line of a file."""

    position: str
    text: str


_WITHOUT_DIGIT = 68
"""Characters of a line of elements before its check digit."""
_BEGINS = re.compile(r"[12] [0-9A-Z ][0-9 ]{3}[0-9]")
"""Beginning of a line of elements: its number, 1 or 2, and the catalogue number of the object."""


def _is_element_line(text: str) -> bool:
    return text[:2] in ("1 ", "2 ") and (len(text) > 24 or _BEGINS.match(text) is not None)


def _two_lines(path: Path) -> Iterator[MeanElements]:
    # `name` is the title line of the next set, `first` its line 1, and `short` the position of the first line without
    # a check digit.
    name, first, found, short = "", None, 0, ""
    text = read_text(path, MESSAGE_BYTES, "give a file of two-line elements")
    line = _Line(f"{path}:1", "")
    for number, raw in enumerate(text.splitlines(), 1):
        if not raw.strip() or raw.lstrip().startswith("#"):
            continue
        line = _Line(f"{path}:{number}", raw.strip())
        if first is not None:
            yield _of_lines(name, first, line)
            short = short or next((part.position for part in (first, line) if len(part.text) == _WITHOUT_DIGIT), "")
            name, first, found = "", None, found + 1
        elif not _is_element_line(line.text):
            # The end of a bulletin (/EX) is not the name of the set that follows.
            name = "" if line.text.startswith("/") else line.text.removeprefix("0 ").strip()
        elif line.text.startswith("1 "):
            first = line
        else:
            raise InputError(f"{line.position}: line 2 of a set without its line 1; the file is damaged")
    if short:
        warn_of(f"{short}: the line has no check digit; is the file complete?")
    if first is not None:
        raise InputError(f"{line.position}: the set of elements ends after line 1; the file is truncated")
    if line.text and not found:
        raise InputError(f"{line.position}: is not a line of two-line elements (1 NNNNN…, 2 NNNNN…)")


def _of_lines(name: str, first: _Line, second: _Line) -> MeanElements:
    """Elements of two lines; python-sgp4 reads their columns."""
    from sgp4.api import SGP4_ERRORS, WGS72, Satrec

    line1, line2 = _checked(first, "1 "), _checked(second, "2 ")
    # Column 63, index 62, is the ephemeris type.
    if (kind := line1[62]) not in "02 ":
        theory = f", {_OTHER_THEORIES[kind]}," if kind in _OTHER_THEORIES else ""
        raise InputError(f"{first.position}: elements of ephemeris type {kind}{theory} in column 63; SGP4 needs type 0")
    try:
        _verify_numbers(line1, line2)
        found = Satrec.twoline2rv(line1, line2, WGS72)
    except ValueError as error:
        raise InputError(f"{second.position}: {str(error).splitlines()[0]}") from None
    if found.error not in (0, 6):  # 6, a decayed orbit, is reported by the propagation at the time in question
        raise InputError(f"{second.position}: {SGP4_ERRORS.get(found.error, 'impossible elements')}")
    return MeanElements(
        name,
        str(found.satnum),
        first.position,
        (float(found.jdsatepoch), float(found.jdsatepochF)),
        float(found.bstar),
        float(found.ecco),
        float(found.argpo),
        float(found.inclo),
        float(found.mo),
        float(found.no_kozai),
        float(found.nodeo),
        _designator(line1[9:17].strip()),
    )


def _checked(line: _Line, begins: str) -> str:
    """Text of a line of elements with its check digit."""
    from sgp4.io import compute_checksum

    position, text = line
    if not text.startswith(begins) or len(text) < _WITHOUT_DIGIT or not text.isascii():
        raise InputError(f"{position}: is not line {begins.strip()} of two-line elements, 69 characters")
    digit = str(compute_checksum(text))
    if len(text) > _WITHOUT_DIGIT and text[68] != digit:
        raise InputError(f"{position}: check digit {text[68]}, but the line adds up to {digit}")
    return text[:_WITHOUT_DIGIT] + digit


def _designator(launch: str) -> str:
    """International designator ``1998-067A`` of columns 10 to 17, ``98067A``; empty where there is none."""
    match = re.fullmatch(r"(\d\d)(\d{3})([A-Z]{1,3})", launch)
    if match is None:
        return ""
    year = int(match[1]) + (1900 if int(match[1]) >= 57 else 2000)  # the first satellite was launched in 1957
    return f"{year}-{match[2]}{match[3]}"


def _verify_numbers(line1: str, line2: str) -> None:
    """Raise `ValueError` unless both lines are of the same object and have numbers where numbers are expected.

    python-sgp4 does not check the columns: instead of a blank field it reads the number that follows.
    """
    if line1[2:7] != line2[2:7]:
        raise ValueError(f"lines 1 and 2 are of the objects {line1[2:7]} and {line2[2:7]}")
    for text in (line1[18:20], line1[20:32], line2[8:16], line2[17:25], line2[34:42], line2[43:51], line2[52:63]):
        float(text)


# ---------------------------------------------------------------- messages
_FIELDS = (
    "BSTAR",
    "ECCENTRICITY",
    "ARG_OF_PERICENTER",
    "INCLINATION",
    "MEAN_ANOMALY",
    "MEAN_MOTION",
    "RA_OF_ASC_NODE",
)
_EXPECTED = {
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4"),
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME", "TEMEOFDATE"),
    "TIME_SYSTEM": ("UTC",),
}
_REFUSED = {
    "REF_FRAME_EPOCH": "the axes of SGP4, TEME, are those of date",
    "SEMI_MAJOR_AXIS": "SGP4 needs MEAN_MOTION instead",
    "BTERM": "SGP4 needs BSTAR instead; BTERM belongs to SGP4-XP",
    "AGOM": "SGP4 has no radiation pressure; AGOM belongs to SGP4-XP",
}


def _messages(path: Path) -> list[MeanElements]:
    sets: list[dict[str, Item]] = [{}]
    for item in read_items(path, "OMM"):
        # A message of several objects repeats these keys, the first of which starts the next set.
        if item.key in sets[-1] and item.key in ("OBJECT_NAME", "CCSDS_OMM_VERS"):
            sets.append({})
        if item.key[:1] not in ("+", "-"):
            sets[-1].setdefault(item.key, item)
    return [_of_message(path, keys) for keys in sets]


def _of_message(path: Path, keys: Mapping[str, Item]) -> MeanElements:
    """Elements of one OMM."""
    _refuse_other_theories(path, keys)
    bstar, eccentricity, periapsis, inclination, anomaly, motion, node = (_number(keys[key]) for key in _FIELDS)
    if not (0.0 <= eccentricity < 1.0 and motion > 0.0):
        raise InputError(f"{keys['ECCENTRICITY'].position}: eccentricity {eccentricity:g} with mean motion {motion:g}")
    if "GM" in keys and abs(_number(keys["GM"]) / _GM_KM3_S2 - 1.0) > 1e-7:
        warn_of(f"{keys['GM'].position}: GM is not used; SGP4 has that of WGS 72, {_GM_KM3_S2} km³/s²")
    # A message without a catalogue number is identified by its name. Numbers of two-line elements have no leading
    # zeros either.
    number = keys.get("NORAD_CAT_ID")
    designator = keys.get("OBJECT_ID")
    return MeanElements(
        keys["OBJECT_NAME"].value,
        number.value.lstrip("0") if number else keys["OBJECT_NAME"].value,
        keys["OBJECT_NAME"].position,
        utc_days(keys["EPOCH"].value, keys["EPOCH"].position),
        bstar,
        eccentricity,
        math.radians(periapsis),
        math.radians(inclination),
        math.radians(anomaly),
        motion * _REVOLUTIONS_DAY_TO_RAD_MIN,
        math.radians(node),
        designator.value if designator else "",
    )


def _refuse_other_theories(path: Path, keys: Mapping[str, Item]) -> None:
    """Raise `InputError` for a message that is incomplete or has elements of a theory other than SGP4."""
    for key, allowed in _EXPECTED.items():
        if key in keys and keys[key].value.upper() not in allowed:
            raise InputError(f"{keys[key].position}: {key} is {keys[key].value}; SGP4 needs {' or '.join(allowed)}")
    if "EPHEMERIS_TYPE" in keys and (item := keys["EPHEMERIS_TYPE"]).value not in ("0", "2", ""):
        theory = f" ({_OTHER_THEORIES[item.value]})" if item.value in _OTHER_THEORIES else ""
        raise InputError(f"{item.position}: EPHEMERIS_TYPE is {item.value}{theory}; SGP4 needs 0")
    for key, why in _REFUSED.items():
        if key in keys:
            raise InputError(f"{keys[key].position}: {key} cannot be used; {why}")
    for key in ("OBJECT_NAME", "EPOCH", *_FIELDS, *_EXPECTED):
        if key not in keys:
            raise InputError(f"{path}: the message has no {key}; it is incomplete or truncated")


def _number(item: Item) -> float:
    try:
        value = float(item.value)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{item.position}: {item.key} is '{item.value}', which is not a number")
    return value
