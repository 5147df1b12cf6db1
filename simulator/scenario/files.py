"""Files of a scenario: the file itself, its bases, and the files named by its values."""

from __future__ import annotations

import difflib
import functools
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from simulator.mission.parameters import ATTITUDE_FILES, FILES
from simulator.scenario.alternatives import layered
from simulator.scenario.document import REPORTED, Entry, Table, Value, parse_document, read_text, show_value
from simulator.scenario.errors import Location, Problem
from simulator.scenario.overrides import merge

ALWAYS_FILES = (
    *(f"orbit.{key}" for key in FILES),
    *(f"pointing.track.spacecraft.{key}" for key in FILES),
    "pointing.jitter.series",
    *(f"pointing.attitude.{key}" for key in (*ATTITUDE_FILES, "sclk")),
    "sky.satellites.file",
    "sequence.recording",
)
"""Keys that name a file, relative to the scenario file, or for ``--set`` to the working folder."""
FILE_KEYS = (
    "optics.transmission",
    "detector.quantum_efficiency",
    "optics.baffle.pst",
    "pointing.jitter.table",
    *ALWAYS_FILES,
)
"""Keys that may name a file: `ALWAYS_FILES`, and keys whose value is a CSV file or something else."""


def find_scenario(path: str | Path) -> Path:
    """The file `path` if it exists; otherwise the included scenario of that name, such as ``sunsat`` or ``moon``."""
    return _file_or_shipped(Path(path), str(path))


@functools.cache
def included_scenarios() -> dict[str, Path]:
    """Files of the included scenarios by name. Files of the gallery have two names, such as ``moon`` and
    ``gallery/moon``."""
    here = Path(__file__).resolve().parent
    folder = next(path for path in (here / "shipped", here.parents[1] / "scenarios") if path.is_dir())
    found = {file.stem: file for file in sorted(folder.glob("*.yaml"))}
    for file in sorted((folder / "gallery").glob("*.yaml")):
        found |= {file.stem: file, f"gallery/{file.stem}": file}
    return found


def _file_or_shipped(file: Path, written: str) -> Path:
    """`file` if it exists; otherwise the included scenario whose name the user wrote, if there is one."""
    shipped = included_scenarios().get(written)
    return shipped if shipped is not None and (file.is_dir() or not os.path.lexists(file)) else file


def _hint(file: Path) -> str:
    """Suggestion for a message about a file that does not exist."""
    if "\0" in str(file):
        return ""
    known = {name: name for name in included_scenarios()} | {
        path.name: str(path) for path in file.parent.glob("*.yaml")
    }
    for wanted in (file.name, file.stem):
        if close := difflib.get_close_matches(wanted, known, n=1, cutoff=0.7):
            return f"; did you mean '{known[close[0]]}'?"
    if file.suffix or file.parent != Path():
        return ""
    return f"; included are {', '.join(name for name in included_scenarios() if '/' not in name)}"


def read_chain(
    file: Path,
    name: str,
    problems: list[Problem],
    chain: tuple[tuple[str, str], ...] = (),
    named_at: Location | None = None,
) -> Table | None:
    """Tree of a file merged over its base; None if one of them cannot be read, with the reason in `problems`."""
    text = read_text(file, name, named_at, "base" if named_at else "")
    if isinstance(text, Problem):
        missing = text.message.startswith("no such file")
        problems.append(replace(text, message=text.message + _hint(file)) if missing else text)
        return None
    tree = parse_document(text, name, problems)
    return with_base(tree, name, problems, (*chain, (os.path.realpath(file), name))) if tree else None


def with_base(tree: Table, name: str, problems: list[Problem], chain: tuple[tuple[str, str], ...]) -> Table | None:
    """A tree merged over its base; `chain` are the files (real path, name) that refer to it."""
    folder = os.path.dirname(name) if chain else ""
    tree = absolute_files(tree, folder)
    entry = tree.entries.pop("base", None)
    if entry is None:
        return tree
    base = entry.node.data if isinstance(entry.node, Value) else {}
    if base is REPORTED:
        return None
    if not isinstance(base, str) or not base:
        problems.append(Problem(entry.location, "base", f"must be the name of a scenario file, not {show_value(base)}"))
        return None
    # A base is relative to the file that names it. The file system rejects names with a null character by ValueError,
    # so such a name is passed on to `read_text`, which reports it.
    beside = os.path.normpath(os.path.join(folder, base))
    base_name = str(_file_or_shipped(Path(beside), base)) if "\0" not in base else beside
    # Files are compared by their real paths, so that a circle through symbolic links is found.
    real = os.path.realpath(base_name) if "\0" not in base_name else base_name
    known = [seen for seen, _ in chain]
    if real in known:
        circle = " → ".join([n for _, n in chain[known.index(real) :]] + [base_name])
        problems.append(Problem(entry.location, "base", f"the files form a circular chain of bases: {circle}"))
        return None
    below = read_chain(Path(base_name), base_name, problems, chain, entry.location)
    return layered(below, tree) if below else None


def absolute_files(tree: Table, folder: str) -> Table:
    """The tree with names of files as absolute paths, so that they remain valid relative to another folder."""
    # Trees are not modified: a layer with the absolute name is merged over each of them.
    heads = tree.entries.get("heads")
    if heads and isinstance(heads.node, Value) and heads.node.items:
        items = tuple(absolute_files(item, folder) if isinstance(item, Table) else item for item in heads.node.items)
        data = [item.plain() if isinstance(item, Table) else item.data for item in items]
        value = Value(data, heads.node.location, items)
        tree = merge(tree, Table(tree.location, {"heads": Entry(heads.location, value)}))
    for path in FILE_KEYS:
        tables, keys = [tree], path.split(".")
        # The tables down to the one with the key; the list is shorter if a section is missing.
        for key in keys[:-1]:
            inner = tables[-1].entries.get(key)
            if inner and isinstance(inner.node, Table):
                tables.append(inner.node)
        entry = tables[-1].entries.get(keys[-1]) if len(tables) == len(keys) else None
        if entry and isinstance(entry.node, Value) and _is_file_name(entry.node.data, path in ALWAYS_FILES):
            file = os.path.abspath(os.path.join(folder, entry.node.data))
            layer = Table(tables[-1].location, {keys[-1]: Entry(entry.location, Value(file, entry.node.location))})
            for table, key in zip(tables[-2::-1], keys[-2::-1], strict=True):
                layer = Table(table.location, {key: Entry(table.entries[key].location, layer)})
            tree = merge(tree, layer)
    return tree


def _is_file_name(value: Any, always: bool) -> bool:
    named = always or (isinstance(value, str) and (value.lower().endswith(".csv") or "/" in value or os.sep in value))
    return isinstance(value, str) and named
