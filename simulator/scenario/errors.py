"""Where a mistake stands and what it is; a `ScenarioError` reports all mistakes of a scenario at once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from startracker.errors import InputError


@dataclass(frozen=True)
class Location:
    """Where a key was written: a line of a file, or an option of the command line."""

    source: str
    """File name as the user wrote it, or the option (``--set optics.aperture_mm``)."""
    line: int = 0
    column: int = 0
    """Counted from 1; 0 means the whole source."""
    key: str = ""
    """For an option: the key it sets, which a message then need not repeat."""

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source


@dataclass(frozen=True)
class Problem:
    """One mistake: its location, the dotted key it is about (or an empty string), and what to do."""

    location: Location
    key: str
    message: str

    def __str__(self) -> str:
        subject = f"{self.key}: " if self.key and self.key != self.location.key else ""
        line = f"{self.location}: {subject}{self.message}"
        return "".join(c if c.isprintable() else repr(c)[1:-1] for c in line)  # one line, whatever was quoted


class ScenarioError(InputError):
    """Everything that is wrong with a scenario, a line each.

    Attributes
    ----------
    problems : tuple of Problem
        In the order of the files and their lines; options of the command line last.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        unique = list(dict.fromkeys(problems))
        rank = {source: i for i, source in enumerate(dict.fromkeys(p.location.source for p in unique))}
        unique.sort(
            key=lambda p: (
                p.location.source.startswith("--"),
                rank[p.location.source],
                p.location.line,
                p.location.column,
            )
        )
        self.problems: tuple[Problem, ...] = tuple(unique)
        super().__init__("\n".join(map(str, self.problems)))

    def __reduce__(self) -> tuple[Any, ...]:  # the default would hand the text to __init__ when it crosses processes
        return type(self), (self.problems,)


class Violation(NamedTuple):
    """A rule that does not hold: the key at fault, why, and whether ``allow_unphysical`` lets it pass."""

    key: str
    message: str
    overridable: bool


def impossible(key: str, message: str) -> Violation:
    """A contradiction, which nothing allows."""
    return Violation(key, message, overridable=False)


def unphysical(key: str, message: str) -> Violation:
    """A value that cannot be, which ``allow_unphysical`` lets pass."""
    return Violation(key, message, overridable=True)
