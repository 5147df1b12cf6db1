"""Algorithms by name: built-in ones from a dictionary, others from entry points."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import TypeVar

from startracker.arguments import text
from startracker.errors import InputError

T = TypeVar("T")


_REPLACED = {
    ("identifiers", "triads_integer"): "triads in integers are the flight build; set tracker.engine: flight and "
    "tracker.identifier: triads in a scenario, or use 'triads'",
}
"""What to use in place of names that have gone."""


def lookup(kind: str, methods: Mapping[str, T], name: str) -> T:
    """Look up an algorithm by name.

    Parameters
    ----------
    kind : str
        Plural noun, for example ``"identifiers"``; other packages register theirs in the entry-point group
        ``boresight.<kind>``.
    methods : mapping
        The built-in algorithms.
    name : str
        Name given by the user.

    Raises
    ------
    InputError
        For an unknown name; the message lists the known ones.
    """
    text(f"the name of one of the {kind}", name)
    if name in methods:
        return methods[name]
    offered = {entry.name: entry for entry in entry_points(group=f"boresight.{kind}")}
    if name in offered:
        return offered[name].load()  # type: ignore[no-any-return]  # an entry point's type is its author's promise
    if advice := _REPLACED.get((kind, name)):
        raise InputError(f"'{name}' is not one of the {kind} any more: {advice}")
    known = sorted({*methods, *offered})
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    raise InputError(f"'{name}' is not one of the {kind}: {', '.join(known)}{hint}")
