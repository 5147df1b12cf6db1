"""Navigation messages of CCSDS (502.0-B-1 to B-3, 504.0-B-1 and B-2, 505.0-B-1 to B-3) as a stream of keys and values
with their lines.

Both notations, KVN (``KEY = value`` on each line) and XML, give the same stream: an element with text is a key with its
value, and a block (``META_START`` … ``META_STOP`` in KVN, ``<metadata>`` in XML) is an opening and a closing entry.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from startracker.errors import InputError
from startracker.files import MESSAGE_BYTES, as_text, read_bytes


class Item(NamedTuple):
    """One entry of a message."""

    position: str
    """File and line, for messages."""
    key: str
    """Keyword; ``+BLOCK`` where a block opens, ``-BLOCK`` where it closes; empty for a line of data."""
    value: str
    """Its value without units, or the line."""
    axis: str = ""
    """Axis, X, Y or Z, that an angle or a rate in XML of the first version names."""


_BLOCKS = {
    "metadata": "META",
    "data": "DATA",
    "covarianceMatrix": "COVARIANCE",
    "stateVector": "STATE",
    "attitudeState": "STATE",
}
"""Names of the blocks by XML element; any other element is a block of its own name."""
_ROTATIONS = {"rotationAngles": "ANGLE_{}", "rotationRates": "ANGLE_{}_DOT"}
"""Keys of the elements ``rotation1`` to ``rotation3`` (505.0-B-1) by the element around them."""
_NUMBER_WITH_UNIT = re.compile(r"([-+.\d][-+.\deEdD]*)\s*\[(.*)\]")
_VERSIONS = {"OEM": ("1", "2", "3"), "OMM": ("1", "2", "3"), "AEM": ("1", "2")}
"""Supported versions: the number before the decimal point."""
_MESSAGES = ("AEM", "ACM", "APM", "CDM", "OCM", "OEM", "OMM", "OPM", "RDM", "TDM")
_UNITS = {
    "km": ("X", "Y", "Z", "SEMI_MAJOR_AXIS"),
    "km/s": ("X_DOT", "Y_DOT", "Z_DOT"),
    "km/s**2": ("X_DDOT", "Y_DDOT", "Z_DDOT"),
    "km**3/s**2": ("GM",),
    "rev/day": ("MEAN_MOTION",),
    "rev/day**2": ("MEAN_MOTION_DOT",),
    "rev/day**3": ("MEAN_MOTION_DDOT",),
    "1/er": ("BSTAR",),
    "1/s": ("Q1_DOT", "Q2_DOT", "Q3_DOT", "QC_DOT"),
    "s": ("NUTATION_PER",),
    "deg": (
        *("INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY", "TRUE_ANOMALY"),
        *("ANGLE_1", "ANGLE_2", "ANGLE_3", "SPIN_ALPHA", "SPIN_DELTA", "SPIN_ANGLE"),
        *("NUTATION", "NUTATION_PHASE", "MOMENTUM_ALPHA", "MOMENTUM_DELTA"),
    ),
    "deg/s": (
        *("ANGLE_1_DOT", "ANGLE_2_DOT", "ANGLE_3_DOT", "ANGVEL_X", "ANGVEL_Y", "ANGVEL_Z"),
        *("SPIN_ANGLE_VEL", "NUTATION_VEL"),
    ),
}
_UNIT_OF = {key: unit for unit, keys in _UNITS.items() for key in keys}
"""The unit of each key; the standards permit no other."""


def read_items(path: Path, kind: str) -> list[Item]:
    """Entries of a message of one kind (``OEM``, ``OMM``, ``AEM``), KVN or XML, without its comments.

    Raises
    ------
    InputError
        With file and line, if the file is not such a message or is damaged, for a version that is not known, and for a
        value in a unit that is not the standard's.
    """
    hint = f"give a file of a CCSDS {kind}"
    data = read_bytes(path, MESSAGE_BYTES, hint)
    # XML starts with "<", after a byte order mark (UTF-8, or UTF-16 in either order) and white space.
    if data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"<" or (data[:2] in (b"\xff\xfe", b"\xfe\xff") and b"<" in data[:4]):
        return _XmlReader(path, kind).read(data)
    items = list(_kvn(path, as_text(data, path, hint)))
    if not items or items[0].key != f"CCSDS_{kind}_VERS":
        found = re.fullmatch(r"CCSDS_([A-Z]+)_VERS", items[0].key) if items else None
        other = f"; this is a CCSDS {found[1]}" if found else ""
        raise InputError(f"{path}:1: no CCSDS {kind}; it starts with CCSDS_{kind}_VERS = 2.0, or is XML{other}")
    for item in items:
        if item.key == f"CCSDS_{kind}_VERS":
            _check_version(item, kind)
    return items


def _check_version(item: Item, kind: str) -> None:
    if item.value.partition(".")[0] not in _VERSIONS[kind]:
        known = ", ".join(f"{number}.0" for number in _VERSIONS[kind])
        raise InputError(f"{item.position}: version {item.value} of the {kind} is not known; use {known}")


def _item(position: str, key: str, value: str, unit: str = "", axis: str = "") -> Item:
    """Create an entry; `InputError` if its unit is not the standard's unit of the key."""
    expected = _UNIT_OF.get(key)
    if unit and expected and re.sub(r"\s", "", unit).lower().replace("[earthradii]", "er") != expected:
        raise InputError(f"{position}: {key} is in {unit}; the standard has {expected}, in which the value is needed")
    return Item(position, key, value, axis)


def _kvn(path: Path, text: str) -> Iterator[Item]:
    for number, raw in enumerate(text.splitlines(), 1):
        line, position = raw.strip(), f"{path}:{number}"
        if not line or line.startswith("COMMENT"):
            continue
        if match := re.fullmatch(r"([A-Z_]+)_(START|STOP)", line):
            yield Item(position, ("+" if match[2] == "START" else "-") + match[1], "")
        elif "=" in line:
            key, _, value = (part.strip() for part in line.partition("="))
            # Brackets are a unit only after a number; those in a text, such as a name, belong to the value.
            found = _NUMBER_WITH_UNIT.fullmatch(value)
            yield _item(position, key, *((found[1], found[2]) if found else (value,)))
        else:
            yield Item(position, "", line)


class _Element(NamedTuple):
    """An element of XML that has begun and not ended yet."""

    name: str
    """Tag, without the prefix of a namespace."""
    position: str
    """File and line."""
    attributes: dict[str, str]
    is_block: bool = False
    """Whether it contains other elements."""


class _XmlReader:
    """Reader of a message in XML.

    It uses expat because that parser gives the line of every element. Of several messages in one file (an NDM), those
    of one kind are read."""

    def __init__(self, path: Path, kind: str) -> None:
        self._path, self._kind = path, kind
        self._items: list[Item] = []
        self._found: set[str] = set()
        self._text = ""
        self._open: list[_Element] = []
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._starts
        self._parser.EndElementHandler = self._ends
        self._parser.CharacterDataHandler = self._characters

    def read(self, data: bytes) -> list[Item]:
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise InputError(f"{self._path}:{error.lineno}: damaged or truncated XML ({reason})") from error
        except (LookupError, ValueError) as error:
            raise InputError(f"{self._path}:1: XML in an encoding that cannot be read ({error}); use UTF-8") from error
        # Every known message in the file has been recorded, so that the error can name what the file contains.
        if self._kind not in self._found:
            other = f"; this is a CCSDS {', '.join(sorted(self._found))}" if self._found else ""
            raise InputError(f"{self._path}:1: no CCSDS {self._kind}; it has no element <{self._kind.lower()}>{other}")
        return self._items

    def _position(self) -> str:
        return f"{self._path}:{self._parser.CurrentLineNumber}"

    def _inside(self) -> bool:
        return any(element.name == self._kind.lower() for element in self._open)

    def _starts(self, tag: str, attributes: dict[str, str]) -> None:
        name = tag.rpartition(":")[2]  # without the prefix of a namespace
        # The element around this one is now known to be a block; elements without others inside are keys.
        if self._open and not self._open[-1].is_block:
            outer = self._open[-1] = self._open[-1]._replace(is_block=True)
            if self._inside():
                self._items.append(Item(outer.position, f"+{_BLOCKS.get(outer.name, outer.name)}", ""))
        self._open.append(_Element(name, self._position(), attributes))
        if name.upper() in _MESSAGES:
            self._found.add(name.upper())
        if name == self._kind.lower() and "version" in attributes:
            version = Item(self._position(), f"CCSDS_{self._kind}_VERS", attributes["version"].strip())
            _check_version(version, self._kind)
            self._items.append(version)
        self._text = ""

    def _ends(self, _: str) -> None:
        inside = self._inside()
        element = self._open.pop()
        text, self._text = " ".join(self._text.split()), ""
        if not inside:
            return
        if element.is_block:
            self._items.append(Item(self._position(), f"-{_BLOCKS.get(element.name, element.name)}", ""))
        elif element.name != "COMMENT":
            key, given = element.name, element.attributes
            # Version 1 of AEM in XML numbers the rotations, where version 2 and KVN have names such as ANGLE_1.
            if re.fullmatch("rotation[123]", key) and self._open[-1].name in _ROTATIONS:
                key = _ROTATIONS[self._open[-1].name].format(key[-1])
            axis = (given.get("angle") or given.get("rate") or "")[:1].upper()
            unit = given.get("units", "")
            self._items.append(_item(element.position, key, text, unit, axis))

    def _characters(self, text: str) -> None:
        self._text += text
