"""A scenario file, and what it is based on, into a frozen `Scenario`; every mistake at once, each with its place.

The way of a file: text → tree with places (`document`) → laid over its base, options over both (`overrides`) → each
value against the schema (`fields`) → physics (`physics`) → `Scenario`. Names of algorithms and curves belong to later
stages; `simulator.checks` hands their checks in as `names`.
"""

from __future__ import annotations

import difflib
import hashlib
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr, model_validator

from simulator.scenario import physics
from simulator.scenario.document import TOLD, Entry, Table, Value, parse_document, read_text, show_value
from simulator.scenario.errors import Place, Problem, ScenarioError
from simulator.scenario.fields import MISSING, Key, NameChecks, all_keys, check_value, flatten, keys_of, nest
from simulator.scenario.overrides import apply_overrides, merge, set_option
from simulator.scenario.schema import ScenarioModel
from startracker.errors import InputWarning
from startracker.identification_settings import unread_keys

FILE_KEYS = ("optics.transmission", "detector.quantum_efficiency", "optics.baffle.pst", "pointing.jitter.table")
"""Keys that may name a CSV file; relative to the file that says so, or for ``--set`` to the working folder."""

_NOISELESS: dict[str, Any] = {
    "sky.background": False,
    "detector.intensifier.gain": 0.0,
    "detector.shot_noise": False,
    "detector.dark_current_e_s": 0.0,
    "detector.dsnu": 0.0,
    "detector.prnu": 0.0,
    "detector.hot_pixel_fraction": 0.0,
    "detector.read_noise_e": 0.0,
    "detector.reset_capacitance_ff": 0.0,
    "detector.full_well_e": 1e15,
    "detector.gain_e_per_dn": 1.0,
    "detector.offset_dn": 0.0,
    "detector.video.noise_dn": 0.0,
    "detector.video.line_blur_px": 0.0,
    "detector.adc_bits": None,
}


class Scenario(ScenarioModel):
    """A whole scenario, checked and frozen. Made by `Scenario.load` from a file, or directly from its sections.

    Two scenarios are equal when all their keys are, wherever they were read from.
    """

    _path: Path | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        refused = [
            Problem(Place(key), "", message)
            for path, value in flatten(self).items()
            for key, message in [(path, check_value(_KEYS[path], value)[1])]
            if message
        ]
        refused += [Problem(Place(v.key), "", _advice(v)) for v in self._violations() if self._refuses(v)]
        if refused:
            raise ValueError(str(ScenarioError(refused)))
        return self

    def _violations(self) -> list[physics.Violation]:
        return physics.violations(flatten(self))

    def _refuses(self, violation: physics.Violation) -> bool:
        return not (violation.overridable and self.allow_unphysical)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ScenarioModel) and flatten(self) == flatten(other)

    def __hash__(self) -> int:
        return hash(tuple(flatten(self).values()))

    @classmethod
    def load(
        cls,
        path: str | Path,
        overrides: Sequence[str] = (),
        seed: int | None = None,
        trials: int | None = None,
        *,
        names: NameChecks | None = None,
    ) -> Scenario:
        """Read a scenario file.

        Parameters
        ----------
        path : str or Path
            YAML file, or the bare name of a scenario that ships (``sunsat``).
        overrides : sequence of str
            ``path=value`` as after ``--set`` on the command line; the value is YAML.
        seed, trials : int, optional
            In place of ``seed`` and ``study.trials``.
        names : mapping, optional
            Checks of the values that name something of a later stage: `simulator.checks.NAME_CHECKS`.

        Raises
        ------
        ScenarioError
            With every mistake of the file, its bases and the options.
        """
        file = find_scenario(path)
        problems: list[Problem] = []
        tree = _read_chain(file, str(path) if file == Path(path) else str(file), problems)
        if tree is None:
            raise ScenarioError(problems)
        scenario = _build(cls, tree, overrides, problems, names=names, seed=seed, trials=trials)
        scenario._path = file
        return scenario

    @classmethod
    def parse(
        cls, text: str, overrides: Sequence[str] = (), *, name: str = "<text>", names: NameChecks | None = None
    ) -> Scenario:
        """Read a scenario from text, as `load` does from a file; other files are looked up from the working folder."""
        problems: list[Problem] = []
        tree = parse_document(text, name, problems)
        tree = _with_base(tree, name, problems, ()) if tree else None
        if tree is None:
            raise ScenarioError(problems)
        return _build(cls, tree, overrides, problems, names=names)

    @property
    def path(self) -> Path | None:
        """The file it was loaded from."""
        return self._path

    @property
    def base_dir(self) -> Path:
        """Folder that relative file names are relative to: the scenario file's, or the working folder."""
        return self._path.parent if self._path else Path()

    @property
    def source_name(self) -> str:
        """What to give the command line to load it again: the file, or the name where there is none."""
        return str(self._path) if self._path else self.name

    @property
    def unphysical(self) -> tuple[str, ...]:
        """What cannot be and was let pass by ``allow_unphysical``, as "key: reason"."""
        return tuple(f"{v.key}: {v.message}" for v in self._violations() if v.overridable)

    def resolved(self) -> dict[str, Any]:
        """Every key with its value, as nested plain dictionaries that JSON can hold."""
        return self.model_dump(mode="json")

    def to_yaml(self, comments: bool = True) -> str:
        """Every key with its value as YAML that loads to an equal scenario; each key's meaning as a comment."""
        from simulator.scenario.output import scenario_yaml

        return scenario_yaml(self, comments)

    def fingerprint(self) -> str:
        """SHA-256 of all values, in hexadecimal: the same for equal scenarios."""
        return hashlib.sha256(self.to_yaml(comments=False).encode()).hexdigest()

    def files(self) -> dict[str, Path]:
        """Files that its values name, by dotted key."""
        flat = flatten(self)
        named = {key: self.base_dir / value for key in FILE_KEYS if isinstance(value := flat[key], str)}
        return {key: file for key, file in named.items() if file.is_file()}

    def with_values(self, *, trials: int | None = None, seed: int | None = None) -> Scenario:
        """The same with another number of trials or another seed; ScenarioError where it may not be."""
        problems: list[Problem] = []
        changed: dict[str, Any] = {}
        for option, key, value in (("trials", "study.trials", trials), ("seed", "seed", seed)):
            if value is not None:
                changed[key], message = check_value(_KEYS[key], value)
                problems += [Problem(Place(option), "", message)] if message else []
        if problems:
            raise ScenarioError(problems)
        return self.changed(changed)

    def noiseless(self) -> Scenario:
        """The same without background, noise, saturation, digitisation and flaws of the detector."""
        return self.changed(_NOISELESS)

    def changed(self, values: Mapping[str, Any]) -> Scenario:
        """The same with other values of keys, by dotted path, checked anew; files it names are still found."""
        scenario = type(self).model_validate(nest(flatten(self) | dict(values)))
        scenario._path = self._path
        return scenario


_KEYS: dict[str, Key] = {key.path: key for key in all_keys()}


def find_scenario(path: str | Path) -> Path:
    """The file itself, or for a bare name such as ``sunsat`` that is no file here, the scenario that ships."""
    return _file_or_shipped(Path(path), str(path))


def _file_or_shipped(file: Path, written: str) -> Path:
    """`file`, or where it does not exist and the user wrote a bare name, the scenario of that name that ships."""
    bare = not Path(written).suffix and Path(written).parent == Path() and written not in ("", ".", "..")
    if bare and "\0" not in written and (file.is_dir() or not os.path.lexists(file)):
        here = Path(__file__).resolve().parent
        for folder in (here / "shipped", here.parents[1] / "scenarios"):
            shipped = folder / f"{written}.yaml"
            if shipped.is_file():
                return shipped
    return file


def _read_chain(
    file: Path,
    name: str,
    problems: list[Problem],
    chain: tuple[tuple[str, str], ...] = (),
    named_at: Place | None = None,
) -> Table | None:
    """Tree of a file laid over its base; None, with the reason among `problems`, where one of them cannot be read."""
    text = read_text(file, name, named_at, "base" if named_at else "")
    if isinstance(text, Problem):
        problems.append(text)
        return None
    tree = parse_document(text, name, problems)
    return _with_base(tree, name, problems, (*chain, (os.path.realpath(file), name))) if tree else None


def _with_base(tree: Table, name: str, problems: list[Problem], chain: tuple[tuple[str, str], ...]) -> Table | None:
    folder = os.path.dirname(name) if chain else ""
    tree = _absolute_files(tree, folder)
    entry = tree.entries.pop("base", None)
    if entry is None:
        return tree
    base = entry.node.data if isinstance(entry.node, Value) else {}
    if base is TOLD:
        return None
    if not isinstance(base, str) or not base:
        problems.append(Problem(entry.place, "base", f"must be the name of a scenario file, not {show_value(base)}"))
        return None
    beside = os.path.normpath(os.path.join(folder, base))
    base_name = str(_file_or_shipped(Path(beside), base)) if "\0" not in base else beside
    real = os.path.realpath(base_name) if "\0" not in base_name else base_name
    known = [seen for seen, _ in chain]
    if real in known:
        circle = " → ".join([n for _, n in chain[known.index(real) :]] + [base_name])
        problems.append(Problem(entry.place, "base", f"the files are based on each other in a circle: {circle}"))
        return None
    below = _read_chain(Path(base_name), base_name, problems, chain, entry.place)
    return merge(below, tree) if below else None


def _absolute_files(tree: Table, folder: str) -> Table:
    """Names of CSV files made absolute, so that they are still found from elsewhere: from a base, or once resolved."""
    for path in FILE_KEYS:
        tables, keys = [tree], path.split(".")
        for key in keys[:-1]:
            inner = tables[-1].entries.get(key)
            if inner and isinstance(inner.node, Table):
                tables.append(inner.node)
        entry = tables[-1].entries.get(keys[-1]) if len(tables) == len(keys) else None
        if entry and isinstance(entry.node, Value) and _is_file_name(entry.node.data):
            file = os.path.abspath(os.path.join(folder, entry.node.data))
            layer = Table(tables[-1].place, {keys[-1]: Entry(entry.place, Value(file, entry.node.place))})
            for table, key in zip(tables[-2::-1], keys[-2::-1], strict=True):
                layer = Table(table.place, {key: Entry(table.entries[key].place, layer)})
            tree = merge(tree, layer)
    return tree


def _is_file_name(value: Any) -> bool:
    return isinstance(value, str) and (value.lower().endswith(".csv") or "/" in value or os.sep in value)


def _build(
    cls: type[Scenario],
    tree: Table,
    overrides: Iterable[str],
    problems: list[Problem],
    *,
    names: NameChecks | None,
    seed: int | None = None,
    trials: int | None = None,
) -> Scenario:
    top = tree.place
    options = apply_overrides(Table(top), overrides, problems)
    for option, path, value in (("--seed", "seed", seed), ("--trials", "study.trials", trials)):
        if value is not None:
            options = set_option(options, option, path, value)
    tree = merge(tree, _absolute_files(options, ""))
    flat = _check_table(tree, ScenarioModel, "", Place(top.source), problems)
    allowed = flat.get("allow_unphysical", False)
    for violation in physics.violations(flat):
        if not (violation.overridable and allowed):
            problems.append(Problem(_place_of(tree, violation.key), violation.key, _advice(violation)))
    for path, check in (names or {}).items():
        if path in flat and (message := check(flat[path], flat)):
            problems.append(Problem(_place_of(tree, path), path, message))
    if problems:
        raise ScenarioError(problems)
    for problem in _unread(tree, flat):
        warnings.warn(str(problem), InputWarning, stacklevel=3)
    return cls.model_validate(nest(flat))


def _unread(tree: Table, flat: Mapping[str, Any]) -> list[Problem]:
    """What is asked of the identification, other than its defaults, and not read by the identifier."""
    identifier = flat["tracker.identifier"]
    keys = (f"tracker.identification.{name}" for name in unread_keys(identifier))
    message = f"the identifier '{identifier}' does not read it"
    return [Problem(_place_of(tree, key), key, message) for key in keys if flat[key] != _KEYS[key].default]


def _advice(violation: physics.Violation) -> str:
    return violation.message + (physics.ALLOW if violation.overridable else "")


def _check_table(table: Table, section: type, prefix: str, place: Place, problems: list[Problem]) -> dict[str, Any]:
    """Valid values of a section and its subsections by dotted path, defaults filled in; mistakes are appended."""
    flat: dict[str, Any] = {}
    keys = keys_of(section, prefix)
    misspelt = set()
    for name, entry in table.entries.items():
        if name not in keys:
            path = f"{prefix}.{name}" if prefix else name
            problems.append(Problem(entry.place, path, _unknown(name, prefix, keys, bool(entry.place.key))))
            misspelt |= set(difflib.get_close_matches(name, keys, n=1))
    for name, key in keys.items():
        found = table.entries.get(name)
        if found and isinstance(found.node, Value) and found.node.data is TOLD:
            continue
        if key.section:
            if found is None:
                missing = [k.name for k in keys_of(key.section, key.path).values() if k.default is MISSING]
                if missing and name in misspelt:
                    continue
                if missing:
                    problems.append(Problem(place, key.path, f"section is missing; it needs {' and '.join(missing)}"))
                else:
                    flat |= _check_table(Table(place), key.section, key.path, place, problems)
            elif isinstance(found.node, Table):
                flat |= _check_table(found.node, key.section, key.path, found.place, problems)
            else:
                what = show_value(found.node.data)
                message = f"must be a section with keys of its own, not {what}"
                if found.node.data is None:
                    message += "; take the line out to keep the defaults"
                problems.append(Problem(found.place, key.path, message))
        elif found is not None:
            data = found.node.plain() if isinstance(found.node, Table) else found.node.data
            value, message = check_value(key, data)
            if message:
                problems.append(Problem(found.place, key.path, message))
            else:
                flat[key.path] = value
        elif key.default is MISSING:
            if name in misspelt:  # told already, as what was written in its place
                continue
            problems.append(Problem(place, key.path, "required key is missing"))
        else:
            flat[key.path] = key.default
    return flat


def _unknown(name: str, prefix: str, keys: Mapping[str, Key], option: bool) -> str:
    """What to say of a key that is not in its section."""
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


def _place_of(tree: Table, path: str) -> Place:
    """Where a key was written, or its section, or the file where it was not."""
    place, node = Place(tree.place.source), tree
    for part in path.split("."):
        entry = node.entries.get(part)
        if entry is None:
            break
        place = entry.place
        if not isinstance(entry.node, Table):
            break
        node = entry.node
    return place
