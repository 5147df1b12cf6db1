"""A table of a scenario file against the schema: valid values with defaults, errors, and the locations of keys."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any

from simulator.scenario.document import REPORTED, Entry, Table, Value, show_value
from simulator.scenario.errors import Location, Problem
from simulator.scenario.fields import MISSING, Key, all_keys, check_value, item_section, keys_of


def check_table(
    table: Table, section: type, prefix: str, location: Location, problems: list[Problem]
) -> dict[str, Any]:
    """Valid values of a section and its subsections by dotted path, including defaults; errors are appended."""
    flat: dict[str, Any] = {}
    keys = keys_of(section, prefix)
    misspelt = set()  # a required key that is only misspelt is not reported as missing as well
    for name, entry in table.entries.items():
        if name not in keys:
            path = f"{prefix}.{name}" if prefix else name
            problems.append(Problem(entry.location, path, _unknown(name, prefix, keys, bool(entry.location.key))))
            misspelt |= set(difflib.get_close_matches(name, keys, n=1))
    for name, key in keys.items():
        found = table.entries.get(name)
        if found and isinstance(found.node, Value) and found.node.data is REPORTED:
            continue
        if key.section:
            if found is None:
                missing = [k.name for k in keys_of(key.section, key.path).values() if k.default is MISSING]
                if missing and name in misspelt:
                    continue
                if missing:
                    problems.append(
                        Problem(location, key.path, f"section is missing; it needs {' and '.join(missing)}")
                    )
                else:
                    flat |= check_table(Table(location), key.section, key.path, location, problems)
            elif isinstance(found.node, Table):
                flat |= check_table(found.node, key.section, key.path, found.location, problems)
            else:
                what = show_value(found.node.data)
                message = f"must be a section with keys, not {what}"
                if found.node.data is None:
                    message += "; remove the line to use the defaults"
                problems.append(Problem(found.location, key.path, message))
        elif found is not None:
            data = found.node.plain() if isinstance(found.node, Table) else found.node.data
            value, message = check_value(key, data)
            if message:
                problems.append(Problem(_location_of_item(key, found), key.path, message))
            else:
                flat[key.path] = value
        elif key.default is MISSING:
            if name in misspelt:  # already reported as the misspelt key
                continue
            problems.append(Problem(location, key.path, "required key is missing"))
        else:
            flat[key.path] = key.default
    return flat


def _location_of_item(key: Key, found: Entry) -> Location:
    """Location of an invalid value; in a list of sections, that of its first invalid item."""
    items = found.node.items if isinstance(found.node, Value) and item_section(key.annotation) else ()
    plain = [item.plain() if isinstance(item, Table) else item.data for item in items]
    wrong = [item.location for item, data in zip(items, plain, strict=True) if check_value(key, [data])[1]]
    return wrong[0] if wrong else found.location


def _unknown(name: str, prefix: str, keys: Mapping[str, Key], option: bool) -> str:
    """Message for a key that is not in its section."""
    homes = [k.path.rpartition(".")[0] for k in all_keys() if k.name == name]
    if name == "base":
        return "unknown key; base belongs to the top level of the file"
    if homes:
        where = " or ".join(f"section '{home}'" if home else "the top level" for home in homes)
        return f"unknown key; it belongs to {where}"
    if close := difflib.get_close_matches(name, keys, n=1):
        return f"unknown key; did you mean '{prefix + '.' if option and prefix else ''}{close[0]}'?"
    elsewhere = {k.name: k.path for k in all_keys()}
    if close := difflib.get_close_matches(name, elsewhere, n=1, cutoff=0.75):
        return f"unknown key; did you mean '{elsewhere[close[0]]}'?"
    return f"unknown key; known here: {', '.join(keys)}"


def location_of(tree: Table, path: str) -> Location:
    """Location of a key, otherwise that of its section, otherwise the file."""
    # A part of the path may have the number of an item of a list, as in heads[1].optics.
    location, node = Location(tree.location.source), tree
    for part in path.split("."):
        name, _, number = part.rstrip("]").partition("[")
        entry = node.entries.get(name)
        if entry is None:
            break
        location, inner = entry.location, entry.node
        if number and isinstance(inner, Value) and int(number) < len(inner.items):
            inner = inner.items[int(number)]
            location = inner.location
        if not isinstance(inner, Table):
            break
        node = inner
    return location


def locations_of(tree: Table, prefix: str = "") -> Iterator[tuple[str, Location]]:
    """Locations of all keys and sections that are written, by dotted path."""
    for name, entry in tree.entries.items():
        yield f"{prefix}{name}", entry.location
        if isinstance(entry.node, Table):
            yield from locations_of(entry.node, f"{prefix}{name}.")
