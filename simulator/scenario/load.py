"""Loading of a scenario file and its bases as a frozen `Scenario`; all errors are reported at once, with locations.

Steps: text → tree with locations (`document`) → merged over its base, with options over both (`overrides`) → values
checked against the schema (`fields`) → physical plausibility (`physics`) → `Scenario`. Names of algorithms and curves
belong to later stages; `simulator.checks` passes their checks as `names`.
"""

from __future__ import annotations

import difflib
import hashlib
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr, ValidationError, model_validator

from simulator.scenario import heads, physics
from simulator.scenario.document import REPORTED, Entry, Table, Value, parse_document, show_value
from simulator.scenario.errors import Location, Problem, ScenarioError, Violation
from simulator.scenario.fields import (
    MISSING,
    Key,
    NameChecks,
    all_keys,
    check_value,
    flatten,
    item_section,
    keys_of,
    nest,
)
from simulator.scenario.files import FILE_KEYS, absolute_files, find_scenario, read_chain, with_base
from simulator.scenario.overrides import apply_overrides, merge, set_option, set_values
from simulator.scenario.quantities import as_written
from simulator.scenario.schema import ScenarioModel
from startracker.arguments import file_path, names_of, switch
from startracker.arguments import text as text_of
from startracker.display import described
from startracker.errors import InputError, InputWarning
from startracker.settings.identification import unread_keys

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
    """A complete scenario, checked and frozen. Created by `Scenario.load` from a file, or from its sections.

    Two scenarios are equal if all their values are, independently of their files.
    """

    _path: Path | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        refused = [
            Problem(Location(key), "", message)
            for path, value in flatten(self).items()
            for key, message in [(path, check_value(_KEYS[path], value)[1])]
            if message
        ]
        refused += [Problem(Location(v.key), "", _advice(v)) for v in self._violations() if self._refuses(v)]
        if refused:
            raise ValueError(str(ScenarioError(refused)))
        return self

    def _violations(self) -> list[Violation]:
        return heads.all_violations(flatten(self))

    def _refuses(self, violation: Violation) -> bool:
        return not (violation.overridable and self.allow_unphysical)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ScenarioModel) and flatten(self) == flatten(other)

    def __hash__(self) -> int:
        return hash(tuple(flatten(self).values()))

    def __repr__(self) -> str:
        optics, detector = self.optics, self.detector
        lens = f"{optics.focal_length_mm:g} mm f/{optics.focal_length_mm / optics.aperture_mm:.2g}"
        return described(
            "Scenario",
            self.name,
            lens,
            f"{detector.width}×{detector.height} px",
            f"exposure {detector.exposure_s:g} s",
            self.orbit.described,
            f"{self.study.trials} trials",
            f"seed {self.seed}",
        )

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        overrides: Sequence[str] | Mapping[str, Any] = (),
        seed: int | None = None,
        trials: int | None = None,
        *,
        names: NameChecks | None = None,
    ) -> Scenario:
        """Read a scenario file.

        Parameters
        ----------
        path : str or Path
            YAML file, or the bare name of an included scenario (``sunsat``).
        overrides : sequence of str, or mapping
            ``path=value`` as for ``--set`` on the command line, where the value is YAML; or values by dotted path,
            which may be astropy quantities and times: ``{"optics.aperture_mm": 2 * u.cm}``.
        seed, trials : int, optional
            Replace ``seed`` and ``study.trials``.
        names : mapping, optional
            Checks of names that are defined in later stages: `simulator.checks.NAME_CHECKS`.

        Raises
        ------
        ScenarioError
            With all errors of the file, its bases and the options.
        """
        file = find_scenario(file_path("path", path))
        problems: list[Problem] = []
        tree = read_chain(file, str(path) if file == Path(path) else str(file), problems)
        if tree is None:
            raise ScenarioError(problems)
        scenario = _build(cls, tree, overrides, problems, names=names, seed=seed, trials=trials)
        scenario._path = file
        return scenario

    @classmethod
    def parse(
        cls,
        text: str,
        overrides: Sequence[str] | Mapping[str, Any] = (),
        *,
        name: str = "<text>",
        names: NameChecks | None = None,
    ) -> Scenario:
        """Read a scenario from text; parameters as in `load`. Other files are relative to the working folder."""
        problems: list[Problem] = []
        tree = parse_document(text_of("text", text), text_of("name", name), problems)
        tree = with_base(tree, name, problems, ()) if tree else None
        if tree is None:
            raise ScenarioError(problems)
        return _build(cls, tree, overrides, problems, names=names)

    @property
    def path(self) -> Path | None:
        """The file from which it was loaded."""
        return self._path

    @property
    def base_dir(self) -> Path:
        """Base folder of relative file names: that of the scenario file, or the working folder."""
        return self._path.parent if self._path else Path()

    @property
    def source_name(self) -> str:
        """Argument by which the command line loads the scenario again: the file, or the name if there is none."""
        return str(self._path) if self._path else self.name

    @property
    def unphysical(self) -> tuple[str, ...]:
        """Unphysical values permitted by ``allow_unphysical``, as "key: reason"."""
        return tuple(f"{v.key}: {v.message}" for v in self._violations() if v.overridable)

    def resolved(self) -> dict[str, Any]:
        """Every key with its value, as nested dictionaries that can be written as JSON."""
        return self.model_dump(mode="json")

    def to_yaml(self, comments: bool = True) -> str:
        """Every key with its value as YAML that loads to an equal scenario, with descriptions as comments."""
        from simulator.scenario.output import scenario_yaml

        return scenario_yaml(self, switch("comments", comments))

    def fingerprint(self) -> str:
        """SHA-256 of all values, in hexadecimal: the same for equal scenarios."""
        return hashlib.sha256(self.to_yaml(comments=False).encode()).hexdigest()

    def files(self) -> dict[str, Path]:
        """Existing files that values of the scenario name, by dotted key."""
        flat = flatten(self)
        for k, head in enumerate(self.heads):
            flat |= {f"heads[{k}].{key}": value for key, value in heads.head_values(head).items()}
        keys = [key for key in flat if key.partition("].")[2] in FILE_KEYS or key in FILE_KEYS]
        named = {key: self.base_dir / value for key in keys if isinstance(value := flat[key], str)}
        return {key: file for key, file in named.items() if file.is_file()}

    def with_values(self, *, trials: int | None = None, seed: int | None = None) -> Scenario:
        """The same scenario with another number of trials or another seed; `ScenarioError` for invalid values."""
        problems: list[Problem] = []
        changed: dict[str, Any] = {}
        for option, key, value in (("trials", "study.trials", trials), ("seed", "seed", seed)):
            if value is not None:
                changed[key], message = check_value(_KEYS[key], value)
                problems += [Problem(Location(option), "", message)] if message else []
        if problems:
            raise ScenarioError(problems)
        return self.changed(changed)

    def noiseless(self) -> Scenario:
        """The same scenario without background, noise, saturation, digitisation and detector defects."""
        return self.changed(_NOISELESS)

    def changed(self, values: Mapping[str, Any]) -> Scenario:
        """The same scenario with other values by dotted path, checked again; relative file names remain valid.

        Values may be astropy quantities, as in `load`.
        """
        if not isinstance(values, Mapping) or not all(isinstance(path, str) for path in values):
            raise InputError(f"values must be a mapping of dotted paths to values; got {values!r}")
        written = {path: as_written(path, value, _KEYS) for path, value in values.items()}
        try:
            scenario = type(self).model_validate(nest(flatten(self) | written))
        except ValidationError as error:
            raise ScenarioError(_problems_of(error)) from None
        scenario._path = self._path
        return scenario


def _problems_of(error: ValidationError) -> Iterator[Problem]:
    """Errors of pydantic, each with its dotted path; errors of the whole scenario are lines ``path: reason``."""
    for fault in error.errors():
        path, message = ".".join(str(part) for part in fault["loc"]), fault["msg"].removeprefix("Value error, ")
        for line in message.splitlines():
            key, _, reason = (path, "", line) if path else line.partition(": ")
            yield Problem(Location(key, key=key), key, reason)


_KEYS: dict[str, Key] = {key.path: key for key in all_keys()}


def _build(
    cls: type[Scenario],
    tree: Table,
    overrides: Iterable[str] | Mapping[str, Any],
    problems: list[Problem],
    *,
    names: NameChecks | None,
    seed: int | None = None,
    trials: int | None = None,
) -> Scenario:
    top = tree.location
    if isinstance(overrides, Mapping):
        options = set_values(Table(top), overrides, _KEYS, problems)
    else:
        options = apply_overrides(Table(top), names_of(overrides), problems)
    for option, path, value in (("--seed", "seed", seed), ("--trials", "study.trials", trials)):
        if value is not None:
            options = set_option(options, option, path, value)
    # Files in options are relative to the working folder, files in a scenario to the scenario's folder.
    tree = merge(tree, absolute_files(options, ""))
    flat = _check_table(tree, ScenarioModel, "", Location(top.source), problems)
    # Rules and checks run even if there are invalid values, which are missing in `flat`, so that everything is reported
    # at once.
    for problem in _replaced(tree, flat):
        warnings.warn(str(problem), InputWarning, stacklevel=3)
    allowed = flat.get("allow_unphysical", False)
    for violation in heads.all_violations(flat):
        if not (violation.overridable and allowed):
            problems.append(Problem(_location_of(tree, violation.key), violation.key, _advice(violation)))
    for path, check in (names or {}).items():
        for written, values in ((path, flat), *heads.values_of_heads(path, flat)):
            if path in values and (message := check(values[path], values)):
                problems.append(Problem(_location_of(tree, written), written, message))
    if problems:
        raise ScenarioError(problems)
    for problem in _unread(tree, flat):
        warnings.warn(str(problem), InputWarning, stacklevel=3)
    return cls.model_validate(nest(flat))


def _replaced(tree: Table, flat: dict[str, Any]) -> list[Problem]:
    """Values that have become others, which replace them in `flat`."""
    key = "tracker.identifier"
    if flat.get(key) != "triads_integer":
        return []
    flat[key], flat["tracker.engine"] = "triads", "flight"
    message = "'triads_integer' is the flight build now: used as tracker.engine: flight with tracker.identifier: triads"
    return [Problem(_location_of(tree, key), key, message)]


def _unread(tree: Table, flat: Mapping[str, Any]) -> list[Problem]:
    """Settings of the identification that differ from their defaults but are not used by the identifier."""
    identifier = flat["tracker.identifier"]
    keys = (f"tracker.identification.{name}" for name in unread_keys(identifier))
    message = f"not used by the identifier '{identifier}'"
    return [Problem(_location_of(tree, key), key, message) for key in keys if flat[key] != _KEYS[key].default]


def _advice(violation: Violation) -> str:
    return violation.message + (physics.ALLOW if violation.overridable else "")


def _check_table(
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
                    flat |= _check_table(Table(location), key.section, key.path, location, problems)
            elif isinstance(found.node, Table):
                flat |= _check_table(found.node, key.section, key.path, found.location, problems)
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


def _location_of(tree: Table, path: str) -> Location:
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
