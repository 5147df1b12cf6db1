"""Errors of a scenario with their locations; a `ScenarioError` reports all of them at once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from startracker.errors import InputError


@dataclass(frozen=True)
class Location:
    """Location of a key: a line of a file, or a command-line option."""

    source: str
    """File name as the user wrote it, or the option (``--set optics.aperture_mm``)."""
    line: int = 0
    """Line, counted from 1; 0 for the whole source."""
    column: int = 0
    """Column, counted from 1."""
    key: str = ""
    """For an option: the key that it sets, so that a message does not repeat it."""

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source


@dataclass(frozen=True)
class Problem:
    """One error."""

    location: Location
    key: str
    """Dotted path of the key; empty if the error does not belong to a key."""
    message: str
    """What is wrong, and what to do."""

    def __str__(self) -> str:
        subject = f"{self.key}: " if self.key and self.key != self.location.key else ""
        line = f"{self.location}: {subject}{self.message}"
        return "".join(c if c.isprintable() else repr(c)[1:-1] for c in line)  # a single line for any quoted text


class ScenarioError(InputError):
    """All errors of a scenario, one per line.

    Attributes
    ----------
    problems : tuple of Problem
        In the order of files and lines; command-line options last.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        unique = list(dict.fromkeys(problems))
        # Sources in the order of their first error, lines within them, and command-line options last.
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

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception is unpickled by passing its text to __init__, which takes problems here.
        return type(self), (self.problems,)


class Violation(NamedTuple):
    """A violated rule."""

    key: str
    """Dotted path of the key."""
    message: str
    """The reason, and what to do."""
    overridable: bool
    """Whether ``allow_unphysical`` permits the violation."""


def impossible(key: str, message: str) -> Violation:
    """A contradiction, which is always an error."""
    return Violation(key, message, overridable=False)


def unphysical(key: str, message: str) -> Violation:
    """An unphysical value, which ``allow_unphysical`` permits."""
    return Violation(key, message, overridable=True)
