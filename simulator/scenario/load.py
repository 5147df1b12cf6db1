"""Loading of a scenario file and its bases as a frozen `Scenario`; all errors are reported at once, with locations.

Steps: text → tree with locations (`document`) → over its base, options over both, without the keys that these replace
(`alternatives`) → values checked against the schema (`tables`) → physical plausibility (`physics`) → `Scenario`. Names
of algorithms and curves belong to later stages; `simulator.checks` passes their checks as `names`.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from pydantic import PrivateAttr, ValidationError, model_validator

from simulator.scenario import heads, physics
from simulator.scenario.alternatives import layered, with_sampling
from simulator.scenario.document import Table, parse_document
from simulator.scenario.errors import Location, Problem, ScenarioError, Violation
from simulator.scenario.fields import (
    Key,
    NameChecks,
    all_keys,
    check_value,
    component_key,
    flatten,
    nest,
)
from simulator.scenario.files import FILE_KEYS, absolute_files, find_scenario, included_scenarios, read_chain, with_base
from simulator.scenario.overrides import apply_overrides, set_option, set_values, with_component, with_components
from simulator.scenario.quantities import as_written
from simulator.scenario.schema import ScenarioModel
from simulator.scenario.tables import check_table, location_of, locations_of
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
    _locations: dict[str, Location] = PrivateAttr(default_factory=dict)

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
        """Base folder of relative file names: the scenario file's, or the working folder."""
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

    def origins(self) -> dict[str, str]:
        """Where the values that are not defaults are written, by dotted path: file and line, or the option."""
        included = {str(file): file.name for file in included_scenarios().values()}
        names = {at.source: included.get(os.path.abspath(at.source), at.source) for at in self._locations.values()}
        return {path: f"{names[at.source]}:{at.line}" if at.line else at.source for path, at in self._locations.items()}

    @contextmanager
    def located(self, key: str) -> Iterator[None]:
        """Within it, an `InputError` becomes that of `error_at`."""
        try:
            yield
        except InputError as error:
            raise self.error_at(key, error) from error

    def error_at(self, key: str, error: InputError) -> ScenarioError:
        """An error with the location of the key that its message names, or of `key`; of its section, if the key is not
        written."""
        if isinstance(error, ScenarioError):
            return error
        named, _, message = str(error).partition(": ")
        if named not in _KEYS:
            named, message = key, str(error)
        path = named
        while path and path not in self._locations:
            path = path.rpartition(".")[0]
        return ScenarioError([Problem(self._locations.get(path, Location(self.source_name)), named, message)])

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

        Values may be astropy quantities, as in `load`. Keys that exclude the new ones, such as the width of another
        model of the star images, return to their defaults.
        """
        if not isinstance(values, Mapping) or not all(isinstance(path, str) for path in values):
            raise InputError(f"values must be a mapping of dotted paths to values; got {values!r}")
        written = {path: as_written(path, value, _KEYS) for path, value in values.items()}
        for path in [path for path in written if component_key(path, _KEYS)]:
            above, _, index = path.rpartition(".")
            whole = written.get(above, flatten(self)[above])
            written[above] = with_component(whole, int(index), written.pop(path))
            if written[above] is None:
                raise InputError(f"{path}: {above} is {whole!r}, which has no such component")
        try:
            scenario = type(self).model_validate(nest(heads.overlaid(flatten(self), written)))
        except ValidationError as error:
            raise ScenarioError(_problems_of(error)) from None
        scenario._path = self._path
        scenario._locations = {key: location for key, location in self._locations.items() if key not in written}
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
    options = with_components(options, tree, _KEYS, problems)
    # Files in options are relative to the working folder, files in a scenario to the scenario's folder.
    tree = with_sampling(layered(tree, absolute_files(options, "")))
    flat = check_table(tree, ScenarioModel, "", Location(top.source), problems)
    # Rules and checks run even if there are invalid values, which are missing in `flat`, so that everything is reported
    # at once.
    for problem in _replaced(tree, flat):
        warnings.warn(str(problem), InputWarning, stacklevel=3)
    allowed = flat.get("allow_unphysical", False)
    for violation in heads.all_violations(flat):
        if not (violation.overridable and allowed):
            problems.append(Problem(location_of(tree, violation.key), violation.key, _advice(violation)))
    for path, check in (names or {}).items():
        for written, values in ((path, flat), *heads.values_of_heads(path, flat)):
            if path in values and (message := check(values[path], values)):
                problems.append(Problem(location_of(tree, written), written, message))
    if problems:
        raise ScenarioError(problems)
    for problem in _unread(tree, flat):
        warnings.warn(str(problem), InputWarning, stacklevel=3)
    scenario = cls.model_validate(nest(flat))
    scenario._locations = dict(locations_of(tree))
    return scenario


def _replaced(tree: Table, flat: dict[str, Any]) -> list[Problem]:
    """Values that have become others, which replace them in `flat`."""
    key = "tracker.identifier"
    if flat.get(key) != "triads_integer":
        return []
    flat[key], flat["tracker.engine"] = "triads", "flight"
    message = "'triads_integer' is the flight build now: used as tracker.engine: flight with tracker.identifier: triads"
    return [Problem(location_of(tree, key), key, message)]


def _unread(tree: Table, flat: Mapping[str, Any]) -> list[Problem]:
    """Settings of the identification that differ from their defaults but are not used by the identifier."""
    identifier = flat["tracker.identifier"]
    keys = (f"tracker.identification.{name}" for name in unread_keys(identifier))
    message = f"not used by the identifier '{identifier}'"
    return [Problem(location_of(tree, key), key, message) for key in keys if flat[key] != _KEYS[key].default]


def _advice(violation: Violation) -> str:
    return violation.message + (physics.ALLOW if violation.overridable else "")
