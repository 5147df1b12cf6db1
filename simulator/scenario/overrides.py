"""Overriding values of a scenario file: ``--set optics.aperture_mm=25``, ``--seed 2``, or a mapping in Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from simulator.scenario.document import REPORTED, Entry, Table, Value, parse_value
from simulator.scenario.errors import Location, Problem
from simulator.scenario.fields import Key, component_key
from simulator.scenario.quantities import as_written
from startracker.errors import InputError


def set_values(tree: Table, values: Mapping[str, Any], keys: Mapping[str, Key], problems: list[Problem]) -> Table:
    """The tree with values set by dotted path, after conversion by `as_written`."""
    for path, value in values.items():
        location = Location(path, key=path)
        try:
            tree = merge(tree, _nest(path, Value(as_written(path, value, keys), location), location))
        except InputError as error:
            problems.append(Problem(location, path, str(error).removeprefix(f"{path} ")))
    return tree


def apply_overrides(tree: Table, overrides: Iterable[str], problems: list[Problem]) -> Table:
    """The tree with every ``path=value`` applied; values are parsed as YAML. The last one takes precedence."""
    for text in overrides:
        path, equals, written = text.partition("=")
        path = path.strip()
        location = Location(f"--set {path}", key=path)
        if not equals or not path or not all(path.split(".")):
            problems.append(Problem(Location(f"--set {text}"), "", "must look like section.key=value"))
        elif path == "base":
            problems.append(Problem(location, "base", "can only be set in a file; load another scenario instead"))
        else:
            value = parse_value(written.strip(), location, problems)
            if value is not None:
                tree = merge(tree, _nest(path, value, location))
    return tree


def with_components(options: Table, below: Table, keys: Mapping[str, Key], problems: list[Problem]) -> Table:
    """Options in which components of lists (``pointing.rate_deg_s.0``) are lists, with the other components of the tree
    below or of the default."""

    def filled(table: Table, old: Table, prefix: str) -> Table:
        entries = {}
        for name, (location, node) in table.entries.items():
            path, under = f"{prefix}{name}", old.entries.get(name)
            inner, new = under.node if under else None, node
            if isinstance(node, Table) and path in keys and not keys[path].section:
                data = inner.data if isinstance(inner, Value) else keys[path].default
                new = _with_items(node, data, path, keys, problems)
            elif isinstance(node, Table):
                new = filled(node, inner if isinstance(inner, Table) else Table(location), f"{path}.")
            entries[name] = Entry(location, new)
        return Table(table.location, entries)

    return filled(options, below, "")


def _with_items(items: Table, data: Any, path: str, keys: Mapping[str, Key], problems: list[Problem]) -> Table | Value:
    """A list with some components replaced; the table itself, whose error the schema reports, if they are none."""
    if not all(name.isdecimal() for name in items.entries):
        return items
    values = list(data) if isinstance(data, (list, tuple)) else []
    for name, entry in items.entries.items():
        item = entry.node.data if isinstance(entry.node, Value) else entry.node.plain()
        replaced = with_component(values, int(name), item)
        if component_key(f"{path}.{name}", keys) is None or replaced is None:
            last = f"has the components 0 to {len(values) - 1}" if values else "has no components; give the whole value"
            problems.append(Problem(entry.location, f"{path}.{name}", f"{path} {last}"))
            return Value(REPORTED, items.location)
        values = replaced
    return Value(values, items.location)


def with_component(values: Any, index: int, value: Any) -> list[Any] | None:
    """A list with another component; None if it is none, or has no such component."""
    if not isinstance(values, (list, tuple)) or index >= len(values):
        return None
    return [*values[:index], value, *values[index + 1 :]]


def set_option(tree: Table, option: str, path: str, value: object) -> Table:
    """The tree with the key of an option such as ``--seed`` set."""
    location = Location(option, key=path)
    return merge(tree, _nest(path, Value(value, location), location))


def merge(below: Table, above: Table) -> Table:
    """A new table: sections are merged key by key, other values of `above` replace those of `below`."""
    merged = Table(below.location, dict(below.entries))
    for key, entry in above.entries.items():
        old = merged.entries.get(key)
        if old and isinstance(old.node, Table) and isinstance(entry.node, Table):
            # An option sets a single key, so the section remains at its location in the file.
            location = old.location if entry.location.key else entry.location
            merged.entries[key] = Entry(location, merge(old.node, entry.node))
        else:
            merged.entries[key] = entry
    return merged


def _nest(path: str, value: Table | Value, location: Location) -> Table:
    node: Table | Value = value
    for part in reversed(path.split(".")):
        node = Table(location, {part: Entry(location, node)})
    assert isinstance(node, Table)
    return node
