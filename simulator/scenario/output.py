"""A scenario as YAML including all defaults, and the schema as JSON schema for editors."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from simulator.scenario.fields import MISSING, Key, is_section, item_section, keys_of
from simulator.scenario.schema import ScenarioModel
from simulator.scenario.schema_heads import OVERRIDDEN, HeadSection

SCHEMA_ID = "https://json-schema.org/draft/2020-12/schema"
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./-]*( [A-Za-z0-9_./-]+)*")
_RESERVED = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}


def scenario_yaml(scenario: ScenarioModel, comments: bool = True, origins: Mapping[str, str] | None = None) -> str:
    """Every key with its value, in the order of the schema, optionally with its description and unit as a comment
    above, and with where it is written as a comment beside it (`origins`, by dotted path)."""
    lines: list[str] = []
    _write(scenario, "", 0, comments, origins or {}, lines)
    return "\n".join(lines) + "\n"


def _write(
    section: object, prefix: str, depth: int, comments: bool, origins: Mapping[str, str], lines: list[str]
) -> None:
    indent = "  " * depth
    kind: Any = type(section) if prefix else ScenarioModel
    for name, key in keys_of(kind, prefix).items():
        value = getattr(section, name)
        if comments:
            if key.section and depth == 0:
                lines.append("")
            lines += [f"{indent}# {line}" for line in textwrap.wrap(_comment(key), 110 - len(indent))]
        if key.section:
            lines.append(f"{indent}{name}:")
            _write(value, key.path, depth + 1, comments, origins, lines)
        else:
            beside = f"  # {origins[key.path]}" if key.path in origins else ""
            lines.append(f"{indent}{name}: {yaml_value(value)}{beside}")


def _comment(key: Key) -> str:
    words = key.description.replace("``", "").replace("`", "")
    unit = f"[{key.unit}]" if key.unit and not key.section and key.unit not in words else ""
    return f"{words} {unit}".strip()


def yaml_value(value: Any) -> str:
    """A value as YAML 1.2 that is read back unchanged."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat().replace("+00:00", "Z")
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(yaml_value, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{yaml_value(name)}: {yaml_value(inner)}" for name, inner in value.items()) + "}"
    kind: Any = type(value)
    if is_section(kind):
        keys = keys_of(kind)
        return "{" + ", ".join(f"{name}: {yaml_value(getattr(value, name))}" for name in keys) + "}"
    # Text without quotes must not look like another YAML type, nor like a word that older parsers take for a bool.
    text = str(value)
    if _PLAIN.fullmatch(text) and text.lower() not in _RESERVED:
        return text
    return '"' + "".join(map(_escaped, text)) + '"'


def cell(value: Any) -> Any:
    """A value of a key for JSON and CSV: numbers and text unchanged, others as YAML."""
    plain = isinstance(value, (int, float, str)) and not isinstance(value, bool)
    return value if plain else yaml_value(value)


def _escaped(character: str) -> str:
    if character in '"\\':
        return "\\" + character
    if character.isprintable():
        return character
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def json_schema() -> dict[str, Any]:
    """JSON schema of a scenario file: titles with units, descriptions, limits, defaults.

    Keys are required only in files without ``base``.
    """
    needed: dict[str, Any] = {"required": [], "properties": {}}
    schema = _object_schema(ScenarioModel, "", needed)
    base = {
        "type": "string",
        "title": "Base",
        "description": "Another scenario, relative to this file, whose keys this one overrides.",
    }
    return {
        "$schema": SCHEMA_ID,
        "title": "boresight scenario",
        "description": "A star camera in orbit, its star tracker, and a Monte Carlo study of both.",
        **schema,
        "properties": {"base": base, **schema["properties"]},
        "if": {"not": {"required": ["base"]}},
        "then": needed,
    }


def _object_schema(section: type, prefix: str, needed: dict[str, Any]) -> dict[str, Any]:
    from pydantic import TypeAdapter

    properties: dict[str, Any] = {}
    for name, key in keys_of(section, prefix).items():
        if key.section:
            # Required keys are collected beside the schema, because a file with a base may omit them.
            inner: dict[str, Any] = {"required": [], "properties": {}}
            body = _object_schema(key.section, key.path, inner)
            if inner["required"]:
                needed["required"].append(name)
                needed["properties"][name] = {"required": inner["required"]}
        else:
            body = _list_schema(key) or _overridden_schema(key) or TypeAdapter(key.annotation).json_schema()
            if key.default is MISSING:
                needed["required"].append(name)
            else:
                body["default"] = list(key.default) if isinstance(key.default, tuple) else key.default
        words = name.removesuffix(key.unit_suffix).replace("_", " ")
        title = words[:1].upper() + words[1:]
        properties[name] = {"title": f"{title} ({key.unit})" if key.unit else title, **body}
        if words := key.description.replace("``", "").replace("`", ""):
            properties[name]["description"] = words
    return {"type": "object", "additionalProperties": False, "properties": properties}


def _overridden_schema(key: Key) -> dict[str, Any] | None:
    """Schema of the keys of a section that a head overrides; None for any other key."""
    if key.owner is not HeadSection or key.name not in OVERRIDDEN:
        return None
    return {"anyOf": [{"$ref": f"#/properties/{key.name}"}, {"type": "null"}]}


def _list_schema(key: Key) -> dict[str, Any] | None:
    """Schema of a list of sections; None for any other key."""
    section = item_section(key.annotation)
    if section is None:
        return None
    needed: dict[str, Any] = {"required": [], "properties": {}}
    items = _object_schema(section, f"{key.path}[]", needed)
    return {"type": "array", "items": {**items, "required": needed["required"]}}
