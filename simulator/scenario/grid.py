"""Points of a sweep: the values of keys in ``--over`` options, and their combinations.

``path=low:high:count`` is a range of `count` evenly spaced values including both ends; ``,log`` spaces them evenly in
the logarithm. ``path=v1,v2,…`` is a list of values as YAML writes them: numbers, names, lists in brackets. A path may
end with the index of a component, ``pointing.rate_deg_s.0``. Several options form a full grid, in which the last key
varies fastest, or a Latin hypercube.
"""

from __future__ import annotations

import itertools
import math
import re
import types
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np

from simulator.scenario.document import REPORTED, Table, parse_value, show_value
from simulator.scenario.errors import Location, Problem, ScenarioError
from simulator.scenario.fields import Key, NameChecks, all_keys, check_value, component_key
from simulator.scenario.output import yaml_value
from startracker.errors import InputError

MAX_POINTS = 100_000
"""Maximum number of points, each of which is a Monte Carlo run."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER}):({_NUMBER})(?::({_NUMBER}))?(?:,(\w+))?")
_EXPECTED = "must look like section.key=low:high:count, section.key=low:high:count,log or section.key=value,value,…"
_NOT_SWEPT = {
    "study.trials": "is set by --trials, the same at every point",
    "name": "has no effect on results; sweep another key",
    "description": "has no effect on results; sweep another key",
}


@dataclass(frozen=True)
class SweptKey:
    """A key of the scenario and its values."""

    key: Key
    """The key, with its type and unit."""
    values: tuple[Any, ...]
    """The values in order; for a range, the values of the grid."""
    low: float | None = None
    """Start of a range; None for a list."""
    high: float | None = None
    """End of a range; None for a list."""
    log: bool = False
    """Whether the range is logarithmic."""
    whole: bool = False
    """Whether the key is an integer, to which the values of a range are rounded."""

    @property
    def path(self) -> str:
        """Dotted path of the key."""
        return self.key.path

    @property
    def numeric(self) -> bool:
        """Whether every value is a number."""
        return all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in self.values)

    @property
    def label(self) -> str:
        """Path and unit, for display."""
        return f"{self.path} [{self.key.unit}]" if self.key.unit else self.path

    def at(self, fraction: float) -> Any:
        """Value at a fraction in [0, 1) of the range (of its logarithm if logarithmic) or of the list."""
        if self.low is None or self.high is None:
            return self.values[int(fraction * len(self.values))]
        if self.log:
            value = math.exp(math.log(self.low) + fraction * (math.log(self.high) - math.log(self.low)))
            value = min(max(value, self.low), self.high)  # rounding of exp(log(x)) may leave the range
        elif self.whole:  # + 1 so that every integer from low to high has the same probability
            return math.floor(self.low + fraction * (self.high - self.low + 1))
        else:
            value = self.low + fraction * (self.high - self.low)
        return round(value) if self.whole else value


def parse_swept_keys(texts: Iterable[str], names: NameChecks | None = None) -> tuple[SweptKey, ...]:
    """Every ``--over`` option, parsed and checked against the schema.

    Parameters
    ----------
    texts : iterable of str
        Values of ``--over``.
    names : mapping, optional
        Checks of names that are defined in later stages: `simulator.checks.NAME_CHECKS`.

    Raises
    ------
    ScenarioError
        With all errors: unknown keys, invalid values, keys given twice.
    InputError
        If there is nothing to sweep.
    """
    swept: dict[str, SweptKey] = {}
    problems: list[Problem] = []
    keys = {key.path: key for key in all_keys() if not key.section}
    for text in texts:
        path, equals, written = (part.strip() for part in text.partition("="))
        location = Location(f"--over {path}", key=path)
        if not equals or not path or not written:
            problems.append(Problem(Location(f"--over {text}"), "", _EXPECTED))
        elif path in swept:
            problems.append(Problem(location, path, "given twice; put all values into one --over"))
        elif path in _NOT_SWEPT:
            problems.append(Problem(location, path, _NOT_SWEPT[path]))
        elif path not in keys and component_key(path, keys) is None:
            problems.append(Problem(location, path, _unknown(path, keys)))
        else:
            found = _parse(component_key(path, keys) or keys[path], written, location, problems)
            if found and _check(found, location, names or {}, problems):
                swept[path] = found
    if problems:
        raise ScenarioError(problems)
    if not swept:
        raise InputError(f"--over: nothing to sweep; {_EXPECTED}")
    return tuple(swept.values())


def grid(swept: Sequence[SweptKey]) -> list[tuple[Any, ...]]:
    """All combinations of the values; the last key varies fastest.

    Raises
    ------
    InputError
        For more than `MAX_POINTS`, or a range without a count.
    """
    for axis in swept:
        if not axis.values:
            raise InputError(f"--over {axis.path}: a grid needs the number of values, low:high:count")
    count = math.prod(len(axis.values) for axis in swept)
    _limit(count)
    return list(itertools.product(*(axis.values for axis in swept)))


def latin_hypercube(swept: Sequence[SweptKey], count: int, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """Latin hypercube sample of the ranges and lists (McKay, Beckman & Conover 1979, Technometrics 21, 239).

    Each range is divided into `count` equal parts (of its logarithm if logarithmic), each of which contains exactly one
    point; the parts of different keys are combined at random. Each value of a list is used equally often, to within
    one. The count of a range is ignored.

    Parameters
    ----------
    swept : sequence of SweptKey
        Keys and their values.
    count : int
        Number of points, at least 1.
    rng : numpy.random.Generator
        Source of the positions and pairings.

    Raises
    ------
    InputError
        For a count below 1 or above `MAX_POINTS`.
    """
    from scipy.stats import qmc

    if count < 1:
        raise InputError(f"--lhs: must be at least 1, not {count}")
    _limit(count)
    sample = qmc.LatinHypercube(len(swept), rng=rng).random(count)
    return [tuple(axis.at(float(u)) for axis, u in zip(swept, row, strict=True)) for row in sample]


def overrides(swept: Sequence[SweptKey], values: Sequence[Any]) -> list[str]:
    """The values of a point as ``path=value``, the form of ``--set``."""
    return [f"{axis.path}={yaml_value(value)}" for axis, value in zip(swept, values, strict=True)]


def _limit(count: int) -> None:
    if count > MAX_POINTS:
        raise InputError(f"--over: {count} points exceed the maximum of {MAX_POINTS}; use --lhs N")


def _unknown(path: str, keys: Mapping[str, Key]) -> str:
    """Message for a key that cannot be swept: it is a section, or unknown to the scenario's loader."""
    if any(known.startswith(f"{path}.") for known in keys):
        inside = [known for known in keys if known.startswith(f"{path}.")]
        return f"is a section; sweep one of its keys: {', '.join(inside[:12])}{' …' if len(inside) > 12 else ''}"
    from simulator.scenario.load import Scenario

    # The loader finds the section to which a key belongs, or the closest name; its message for this key is used.
    try:
        Scenario.parse("{}", [f"{path}=0"])
    except ScenarioError as error:
        for problem in error.problems:
            if problem.location.source == f"--set {path}":
                return problem.message
    return "unknown key"


def _parse(key: Key, written: str, location: Location, problems: list[Problem]) -> SweptKey | None:
    # A text that is not a range is a list, whose parts are parsed as YAML like values of --set.
    match = _RANGE.fullmatch(written.replace(" ", ""))
    if match:
        return _range(key, match, location, problems)
    values = []
    for text in _split(written):
        node = parse_value(text, location, problems)
        if node is None or isinstance(node, Table):
            problems.append(Problem(location, key.path, f"'{text}' is not a value; {_EXPECTED}"))
            return None
        if node.data is REPORTED:
            return None
        values.append(node.data)
    return SweptKey(key, tuple(values), whole=_whole(key.annotation))


def _range(key: Key, match: re.Match[str], location: Location, problems: list[Problem]) -> SweptKey | None:
    low, high = float(match[1]), float(match[2])
    log, whole = match[4] == "log", _whole(key.annotation)
    count = int(match[3]) if match[3] and match[3].isdigit() else None
    message = ""
    if match[4] not in (None, "log", "lin"):
        message = f"'{match[4]}' is not a spacing; write log or omit it"
    elif match[3] and (count is None or count < 2):
        message = f"a range needs 2 values or more, not {match[3]}"
    elif not (math.isfinite(low) and math.isfinite(high) and low < high):
        message = f"the end of a range must be greater than its start, not from {match[1]} to {match[2]}"
    elif log and low <= 0:
        message = f"a logarithmic range must start above 0, not at {match[1]}"
    elif whole and not (low.is_integer() and high.is_integer()):
        message = "takes integers only; use integers for both ends of the range"
    elif count is not None and count > MAX_POINTS:
        message = f"{count} values exceed the maximum of {MAX_POINTS} points"
    if message:
        problems.append(Problem(location, key.path, message))
        return None
    # Without a count a range serves for a Latin hypercube only.
    values = _spaced(low, high, count, log) if count else ()
    if whole:
        values = tuple(round(v) for v in values)
        if len(set(values)) < len(values):
            message = f"only {len(set(values))} of the {count} values are different integers; use fewer"
            problems.append(Problem(location, key.path, message))
            return None
    return SweptKey(key, values, low, high, log, whole)


def _spaced(low: float, high: float, count: int, log: bool) -> tuple[float, ...]:
    """Evenly spaced values with exact ends, and with rounding errors removed from the others."""
    inner = (np.geomspace if log else np.linspace)(low, high, count)[1:-1]
    return (low, *(float(f"{v:.12g}") for v in inner), high)


def _split(text: str) -> list[str]:
    """Parts of a text between its commas, except for commas within brackets or quotes."""
    parts, depth, quote = [""], 0, ""
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        depth += (character in "[{") - (character in "]}") if not quote else 0
        if character == "," and not depth and not quote:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def _whole(annotation: Any) -> bool:
    """Whether a key takes integers only."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, types.UnionType):
        branches = [part for part in get_args(annotation) if part is not type(None)]
        return all(map(_whole, branches))
    return annotation is int


def _check(axis: SweptKey, location: Location, names: NameChecks, problems: list[Problem]) -> bool:
    """Check each value against its key; physical plausibility of the combination is checked later."""
    # Limits of keys are intervals, so a range without values is valid if both of its ends are.
    ends: tuple[Any, ...] = () if axis.low is None else (axis.low, axis.high)
    candidates = axis.values or (tuple(map(round, ends)) if axis.whole else ends)
    before = len(problems)
    for n, value in enumerate(candidates):
        _, message = check_value(axis.key, value)
        if not message and axis.path in names:
            message = names[axis.path](value, {}) or ""
        if not message and value in candidates[:n]:
            message = f"{show_value(value)} is given twice"
        if message:
            problems.append(Problem(location, axis.path, message))
    return len(problems) == before
