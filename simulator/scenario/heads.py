"""The heads of a scenario: the values that each head overrides, and the rules of these values."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any

from simulator.scenario.alternatives import replaced_keys
from simulator.scenario.document import show_value
from simulator.scenario.errors import Violation, impossible
from simulator.scenario.fields import Key, all_keys, check_value, nest
from simulator.scenario.physics import RULES, violations, violations_of
from simulator.scenario.schema_heads import OVERRIDDEN, HeadSection


def head_values(head: HeadSection) -> dict[str, Any]:
    """Values that a head overrides, by dotted path."""
    values: dict[str, Any] = {}

    def walk(prefix: str, given: Mapping[str, Any]) -> None:
        for name, value in given.items():
            if isinstance(value, Mapping):
                walk(f"{prefix}.{name}", value)
            else:
                values[f"{prefix}.{name}"] = value

    for section in OVERRIDDEN:
        walk(section, getattr(head, section) or {})
    return values


def overlaid(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Values by dotted path with others over them; keys that the others replace have their defaults."""
    values = dict(below)
    for path in replaced_keys(nest(values), nest(dict(above))):
        inside = (key for key in all_keys() if not key.section and f"{key.path}.".startswith(f"{path}."))
        values |= {key.path: key.default for key in inside}
    return {**values, **above}


def values_of_heads(path: str, v: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """For each head that overrides a key: the path of its value, and all values of the scenario of that head."""
    for k, head in enumerate(v.get("heads", ())):
        values = _checked(head)[0]
        if path in values:
            yield f"heads[{k}].{path}", overlaid(v, values)
        elif path == "pointing.mounting":
            yield f"heads[{k}].mounting", {**v, path: head.mounting}


def all_violations(v: Mapping[str, Any]) -> list[Violation]:
    """All violated rules of a scenario: `simulator.scenario.physics.violations` of its camera, and the heads' own."""
    return violations_of((*RULES, _contradictions), v)


def _contradictions(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Violated rules of the ``heads`` section, and invalid values that heads override."""
    heads: tuple[HeadSection, ...] = v["heads"]
    if not heads:
        return
    names = [head.name for head in heads]
    # A head is checked as the camera of a scenario without heads. Violations that the scenario has without the head's
    # values are reported once, for the scenario.
    alone = {**v, "heads": ()}
    common = set(violations(alone))
    step_s = v["sequence.step_s"]
    for k, head in enumerate(heads):
        if head.name in names[:k]:
            yield impossible(f"heads[{k}].name", f"'{head.name}' is the name of another head; each needs its own")
        if head.time_offset_s >= step_s:
            message = f"{head.time_offset_s:g} s is not within the sequence's step of {step_s:g} s"
            yield impossible(f"heads[{k}].time_offset_s", message)
        if not isinstance(head.mounting, str) and not any(head.mounting):
            yield impossible(f"heads[{k}].mounting", "the quaternion is zero; the identity is [0, 0, 0, 1]")
        values, problems = _checked(head)
        for path, message in problems:
            yield impossible(f"heads[{k}].{path}", message)
        if values.get("tracker.in_flight_calibration.use", False):
            yield impossible(
                f"heads[{k}].tracker.in_flight_calibration.use", "is not available for a head; set it to false"
            )
        for violation in violations(overlaid(alone, values)):
            if violation not in common and violation.key.startswith(OVERRIDDEN):
                yield violation._replace(key=f"heads[{k}].{violation.key}")
    # Both need a single camera whose frames they control or calibrate.
    for key in ("sequence.operation.use", "tracker.in_flight_calibration.use"):
        if v[key]:
            yield impossible(key, "is not available with heads; set it to false, or remove heads")


def _checked(head: HeadSection) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Valid values that a head overrides, converted by the schema, and (path, message) of the invalid ones."""
    keys: dict[str, Key] = {key.path: key for key in all_keys()}
    values: dict[str, Any] = {}
    problems = []
    for path, given in head_values(head).items():
        key = keys.get(path)
        if key is None:
            close = difflib.get_close_matches(path, keys, n=1)
            problems.append((path, "unknown key" + (f"; did you mean '{close[0]}'?" if close else "")))
        elif key.section:
            problems.append((path, f"must be a section with keys, not {show_value(given)}"))
        else:
            value, message = check_value(key, given)
            if message:
                problems.append((path, message))
            else:
                values[path] = value
    return values, problems
