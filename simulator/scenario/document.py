"""A YAML 1.2 file as a tree with the line and column of every key.

The tree is built from the parser's events, because these still contain duplicate keys, tags and merge keys, which are
reported as errors. Plain scalars follow the core schema of YAML 1.2 (``yes`` is text, ``012`` is twelve); dates remain
text until a key requires one. Anchors and aliases are supported within a file. No content of a file is executed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from simulator.scenario.errors import Location, Problem

REPORTED = object()
"""Marks a value that cannot be read and whose error has already been reported."""

MAX_BYTES = 1_000_000
MAX_DEPTH = 20
MAX_NODES = 20_000  # after expansion of aliases, which could otherwise grow without limit

_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_WORDS: dict[str, bool | None] = {"": None, "~": None, "null": None, "Null": None, "NULL": None}
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_FORBIDDEN = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]")


class Entry(NamedTuple):
    """A key of a table: its location and value."""

    location: Location
    node: Table | Value


@dataclass
class Value:
    """A scalar or a list, as plain Python values."""

    data: Any
    location: Location
    items: tuple[Table | Value, ...] = ()
    """For a list, its items with their locations."""


@dataclass
class Table:
    """A mapping; `location` is its start."""

    location: Location
    entries: dict[str, Entry] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """The table without locations."""
        return {k: e.node.plain() if isinstance(e.node, Table) else e.node.data for k, e in self.entries.items()}


def read_text(path: Path, name: str, location: Location | None = None, key: str = "") -> str | Problem:
    """Text of a UTF-8 file, or the problem (reported at `location` if given, otherwise at the file)."""
    at = location or Location(name)
    named = f": {name}" if location else ""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)  # one byte more shows that the file is too large
    except (FileNotFoundError, NotADirectoryError):
        return Problem(at, key, f"no such file{named}")
    except IsADirectoryError:
        return Problem(at, key, f"is a folder, not a scenario file{named}")
    except PermissionError:
        return Problem(at, key, f"cannot be read (permission denied){named}")
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        return Problem(at, key, f"cannot be read: {getattr(error, 'strerror', None) or error}{named}")
    if len(raw) > MAX_BYTES:
        return Problem(Location(name), "", f"is larger than {MAX_BYTES // 1000} kB, too large for a scenario")
    try:
        return raw.decode("utf-8-sig")  # without a byte order mark, which some editors write
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line, column = before.count(b"\n") + 1, len(before) - before.rfind(b"\n")
        message = f"is not UTF-8 text: byte 0x{raw[error.start]:02x}; save the file as UTF-8"
        return Problem(Location(name, line, column), "", message)


def parse_document(text: str, name: str, problems: list[Problem]) -> Table | None:
    """Tree of a scenario file; None if it cannot be parsed. Errors are appended to `problems`."""
    node = _parse(text, Location(name, 1, 1), problems)
    if isinstance(node, Table) or node is None:
        return node
    if node.data is None:
        problems.append(Problem(Location(name), "", "is empty; a scenario needs name, epoch, optics and detector"))
    elif node.data is not REPORTED:
        problems.append(
            Problem(node.location, "", f"must consist of keys and values (key: value), not {show_value(node.data)}")
        )
    return None


def parse_value(text: str, location: Location, problems: list[Problem]) -> Table | Value | None:
    """Value of a command-line option, parsed as YAML; every location in it is `location`."""
    return _parse(text, location, problems)


def show_value(value: Any) -> str:
    """A value in YAML notation, shortened for a message."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a section"
    if isinstance(value, (list, tuple)):
        shown = "[" + ", ".join(show_value(v) for v in value[:8]) + (", …]" if len(value) > 8 else "]")
    elif isinstance(value, int):
        shown = str(value) if abs(value) < 10**40 else f"a number of {value.bit_length()} bits"
    else:
        shown = repr(value)
    return shown if len(shown) <= 80 else shown[:79] + "…"


def _parse(text: str, start: Location, problems: list[Problem]) -> Table | Value | None:
    fixed = start.line == 0  # a command-line option, in which all locations are the same
    if bad := _FORBIDDEN.search(text):
        line, column = text.count("\n", 0, bad.start()) + 1, bad.start() - text.rfind("\n", 0, bad.start())
        location = start if fixed else Location(start.source, line, column)
        problems.append(Problem(location, "", f"invalid YAML: character U+{ord(bad.group()):04X} is not allowed"))
        return None
    try:
        return _Builder(_events(text, start), start, problems).document()
    except _StoppedError as stopped:
        problems.append(stopped.problem)
        return None


class _StoppedError(Exception):
    """Raised where the rest of a document cannot be read."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.message)
        self.problem = problem


def _events(text: str, start: Location) -> Iterator[Any]:
    """The parser's events, one after the other.

    They are not collected first, so that a document nested too deeply is refused while it is read: the time of the
    parser grows with the square of the depth.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        yield from YAML(typ="safe", pure=True).parse(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        location = Location(start.source, mark.line + 1, mark.column + 1) if mark and start.line else start
        raise _StoppedError(Problem(location, "", _syntax_message(str(error.problem or error.context)))) from None
    except (YAMLError, ValueError, IndexError, TypeError, AttributeError, OverflowError) as error:
        # The parser raises internal errors for some malformed directives.
        reason = (str(error).splitlines() or ["unreadable"])[0]
        raise _StoppedError(Problem(start, "", f"invalid YAML: {reason}")) from None


def _syntax_message(problem: str) -> str:
    if "'\\t'" in problem or "\t" in problem:
        return "invalid YAML: a tab; indent with spaces"
    if "mapping values are not allowed" in problem:
        return "invalid YAML: unexpected ':'; check the indentation, or quote the text"
    if "could not find expected ':'" in problem:
        return "invalid YAML: missing ':' after the key"
    return f"invalid YAML: {problem}"


class _Builder:
    """Builds the tree from the parser's events while they arrive."""

    def __init__(self, events: Iterator[Any], start: Location, problems: list[Problem]) -> None:
        self.events, self.start, self.problems = events, start, problems
        self.anchors: dict[str, tuple[Table | Value, int] | None] = {}  # None: under construction
        self.count = 0
        self.full = False

    def document(self) -> Table | Value:
        node: Table | Value = Value(None, self.start)
        documents = 0
        for event in self.events:
            kind = type(event).__name__
            if kind == "DocumentStartEvent":
                documents += 1
                if event.version and tuple(event.version) != (1, 2):
                    self.report(event, "only YAML 1.2 is supported; remove the %YAML line")
                if documents == 2:
                    self.report(event, "second document; a file must contain one scenario only")
                # Further documents are parsed too, so that their errors are reported, but only the first is used.
                read = self.node(next(self.events), 0)
                if documents == 1:
                    node = read
        return node

    def location(self, event: Any) -> Location:
        if self.start.line == 0:
            return self.start
        return Location(self.start.source, event.start_mark.line + 1, event.start_mark.column + 1)

    def report(self, event: Any, message: str, key: str = "") -> None:
        self.problems.append(Problem(self.location(event), key, message))

    def node(self, event: Any, depth: int) -> Table | Value:
        kind, location = type(event).__name__, self.location(event)
        self.count += 1
        if kind == "AliasEvent":
            return self.alias(event, location)
        first = self.count
        # An anchor is registered before its node is complete, so that an alias within it is recognised as circular.
        anchor = getattr(event, "anchor", None)
        if anchor:
            self.anchors[anchor] = None
        if getattr(event, "tag", None) is not None:
            self.report(event, f"tags ('{event.tag}') are not supported in scenarios; write the plain value")
        node: Table | Value
        if kind == "ScalarEvent":
            node = Value(self.scalar(event), location)
        elif kind == "SequenceStartEvent":
            node = self.sequence(event, location, depth)
        else:
            node = self.table(event, location, depth)
        if anchor:
            self.anchors[anchor] = (node, self.count - first + 1)
        return node

    def alias(self, event: Any, location: Location) -> Table | Value:
        if event.anchor not in self.anchors:
            self.report(event, f"alias '*{event.anchor}' has no anchor '&{event.anchor}' above it")
            return Value(REPORTED, location)
        target = self.anchors[event.anchor]
        if target is None:
            self.report(event, f"alias '*{event.anchor}' refers to itself")
            return Value(REPORTED, location)
        # An alias counts as all values of its target: nested aliases could otherwise expand exponentially.
        self.count += target[1]
        if self.count > MAX_NODES:
            if not self.full:
                self.report(event, f"the aliases expand to more than {MAX_NODES} values; reduce them")
            self.full = True
            return Value(REPORTED, location)
        return target[0]

    def check_depth(self, event: Any, depth: int) -> None:
        if depth >= MAX_DEPTH:
            message = f"nested more than {MAX_DEPTH} levels deep; reduce the nesting"
            raise _StoppedError(Problem(self.location(event), "", message))

    def sequence(self, event: Any, location: Location, depth: int) -> Value:
        self.check_depth(event, depth)
        nodes = []
        while type(item := next(self.events)).__name__ != "SequenceEndEvent":
            nodes.append(self.node(item, depth + 1))
        items = [node.plain() if isinstance(node, Table) else node.data for node in nodes]
        return Value(REPORTED if REPORTED in items else items, location, tuple(nodes))

    def table(self, event: Any, location: Location, depth: int) -> Table:
        self.check_depth(event, depth)
        table = Table(location)
        while type(key_event := next(self.events)).__name__ != "MappingEndEvent":
            # A key may be an alias of a text; any other node that is not a scalar has no value and is reported.
            key_node = self.node(key_event, depth + 1)
            key = getattr(key_event, "value", None)
            if type(key_event).__name__ == "AliasEvent" and isinstance(key_node, Value):
                key = key_node.data
            value = self.node(next(self.events), depth + 1)
            if not isinstance(key, str):
                self.report(key_event, "a key must be a plain word")
            elif key == "<<" and not key_event.style:
                self.report(key_event, "merge keys (<<) are not part of YAML 1.2; use base: or repeat the keys")
            elif key in table.entries:
                first = table.entries[key].location
                where = f"; first given on line {first.line}" if first.line else ""
                self.report(key_event, f"duplicate key{where}; keep one of them", key)
            else:
                table.entries[key] = Entry(self.location(key_event), value)
        return table

    def scalar(self, event: Any) -> Any:
        text: str = event.value
        if _FORBIDDEN.search(text) or re.search("[\ud800-\udfff]", text):
            self.report(event, "text contains a control character or an unpaired surrogate; remove it")
            return REPORTED
        if event.style:  # quoted or block: text
            return text
        if text in _WORDS:
            return _WORDS[text]
        if _INT.fullmatch(text):
            if len(text) > 400:
                self.report(event, "numbers may have at most 400 digits")
                return REPORTED
            return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
        if _FLOAT.fullmatch(text):
            return float(text)
        if match := _INFINITY.fullmatch(text):
            return float(match.group(1) + "inf")
        return float("nan") if text in (".nan", ".NaN", ".NAN") else text
