"""Navigation messages of CCSDS (502.0-B-3, 504.0-B-2, 505.0-B-3) as a stream of keys and values with their lines.

KVN, ``KEY = value`` on each line, and XML give the same stream: an element with text is a key with its value, and a
block (``META_START`` … ``META_STOP`` in KVN, ``<metadata>`` in XML) opens and closes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from startracker.errors import InputError
from startracker.files import MESSAGE_BYTES, read_text


class Item(NamedTuple):
    """One entry of a message."""

    position: str
    """File and line, for messages."""
    key: str
    """Keyword; ``+BLOCK`` where a block opens, ``-BLOCK`` where it closes; empty for a line of data."""
    value: str
    """Its value without units, or the line."""


_BLOCKS = {
    "metadata": "META",
    "data": "DATA",
    "covarianceMatrix": "COVARIANCE",
    "stateVector": "STATE",
    "attitudeState": "STATE",
}
"""Names of the blocks in XML; those of other elements are their own."""
_UNIT = re.compile(r"\s*\[[^\]]*\]\s*$")


def read_items(path: Path, kind: str) -> list[Item]:
    """Entries of a message of one kind (``OEM``, ``OMM``, ``AEM``), KVN or XML, without its comments.

    Raises
    ------
    InputError
        With file and line, if the file is not such a message, or is damaged.
    """
    text = read_text(path, MESSAGE_BYTES, f"give a file of a CCSDS {kind}")
    if text.lstrip().startswith("<"):
        return _XmlReader(path, kind).read(text)
    items = list(_kvn(path, text))
    if not items or items[0].key != f"CCSDS_{kind}_VERS":
        raise InputError(f"{path}:1: no CCSDS {kind}; it starts with CCSDS_{kind}_VERS = 2.0, or is XML")
    return items


def _kvn(path: Path, text: str) -> Iterator[Item]:
    for number, raw in enumerate(text.splitlines(), 1):
        line, position = raw.strip(), f"{path}:{number}"
        if not line or line.startswith("COMMENT"):
            continue
        if match := re.fullmatch(r"([A-Z_]+)_(START|STOP)", line):
            yield Item(position, ("+" if match[2] == "START" else "-") + match[1], "")
        elif "=" in line:
            key, _, value = line.partition("=")
            yield Item(position, key.strip(), _UNIT.sub("", value).strip())
        else:
            yield Item(position, "", line)


class _XmlReader:
    """Entries of a message in XML, by expat, which knows its lines."""

    def __init__(self, path: Path, kind: str) -> None:
        self._path, self._kind = path, kind
        self._items: list[Item] = []
        self._text = ""
        self._open: list[tuple[str, str, bool]] = []
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._starts
        self._parser.EndElementHandler = self._ends
        self._parser.CharacterDataHandler = self._characters

    def read(self, text: str) -> list[Item]:
        try:
            self._parser.Parse(text, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise InputError(f"{self._path}:{error.lineno}: damaged or truncated XML ({reason})") from error
        if not any(item.key == f"+{self._kind.lower()}" for item in self._items):
            raise InputError(f"{self._path}:1: no CCSDS {self._kind}; it has no element <{self._kind.lower()}>")
        return self._items

    def _position(self) -> str:
        return f"{self._path}:{self._parser.CurrentLineNumber}"

    def _starts(self, tag: str, _: dict[str, str]) -> None:
        name = tag.rpartition(":")[2]
        if self._open and not self._open[-1][2]:
            outer, position = self._open[-1][:2]
            self._open[-1] = (outer, position, True)
            self._items.append(Item(position, f"+{_BLOCKS.get(outer, outer)}", ""))
        self._open.append((name, self._position(), False))
        self._text = ""

    def _ends(self, _: str) -> None:
        name, position, is_block = self._open.pop()
        if is_block:
            self._items.append(Item(self._position(), f"-{_BLOCKS.get(name, name)}", ""))
        elif name != "COMMENT":
            self._items.append(Item(position, name, self._text.strip()))
        self._text = ""

    def _characters(self, text: str) -> None:
        self._text += text
