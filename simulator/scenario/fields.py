"""The schema as a table of keys: type, limits, default, description and unit.

The loader's messages, `boresight show` and the JSON schema are all generated from it.
"""

from __future__ import annotations

import ast
import dataclasses
import difflib
import inspect
import math
import re
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

from pydantic import BaseModel, TypeAdapter
from pydantic.fields import FieldInfo

from simulator.scenario.document import show_value
from simulator.scenario.schema import LIMITS, ScenarioModel
from simulator.units import UNITS, unit_suffix

MISSING = dataclasses.MISSING

NameChecks = Mapping[str, Callable[[Any, Mapping[str, Any]], str | None]]
"""Check of a key by its dotted path: a function of the value of the key and of the valid values of all keys by dotted
path, which returns an error message, or None."""


@dataclasses.dataclass(frozen=True)
class Key:
    """One key of the schema."""

    path: str
    """Dotted path from the top."""
    annotation: Any
    """Type including its limits."""
    default: Any
    """`MISSING` for required keys."""
    owner: type
    """The class that declares it."""
    section: type | None
    """The class of a section; None for a plain key."""

    @property
    def name(self) -> str:
        """The last part of the path; for a component, the name of its list."""
        above, _, name = self.path.rpartition(".")
        return above.rpartition(".")[2] if name.isdigit() else name

    @property
    def description(self) -> str:
        """One or two sentences, on one line."""
        return _descriptions(self.owner).get(self.name, "")

    @property
    def unit(self) -> str:
        """Unit, spelled out, from the suffix of the name; empty if there is none."""
        return UNITS[ending].words if (ending := unit_suffix(self.name)) else ""

    @property
    def unit_suffix(self) -> str:
        """The suffix of the name that states the unit, including the underscore."""
        ending = unit_suffix(self.name)
        return ending and f"_{ending}"


@cache
def keys_of(section: type, prefix: str = "") -> dict[str, Key]:
    """Keys of a section (a pydantic model or a dataclass) by name, in order."""
    # A pydantic model states limits in its annotations; plain dataclasses, which do not depend on pydantic, have them
    # in `LIMITS`.
    hints = typing.get_type_hints(section, include_extras=True)
    limits = LIMITS.get(section, {})
    keys = {}
    if issubclass(section, BaseModel):
        defaults = {n: MISSING if f.is_required() else f.default for n, f in section.model_fields.items()}
    else:
        defaults = {field.name: field.default for field in dataclasses.fields(cast(Any, section))}
    for name, default in defaults.items():
        annotation = limits.get(name, hints[name])
        base = _strip(annotation)[0]
        path = f"{prefix}.{name}" if prefix else name
        keys[name] = Key(path, annotation, default, section, base if is_section(base) else None)
    return keys


def component_key(path: str, keys: Mapping[str, Key]) -> Key | None:
    """Key of one component of a list of fixed length, such as ``pointing.rate_deg_s.0``; None if there is none."""
    above, _, index = path.rpartition(".")
    if above not in keys or not index.isdecimal():
        return None
    for branch in _branches(keys[above].annotation):
        items = get_args(branch) if get_origin(branch) is tuple else ()
        if Ellipsis not in items and int(index) < len(items):
            return dataclasses.replace(keys[above], path=path, annotation=items[int(index)], default=MISSING)
    return None


def is_section(kind: Any) -> bool:
    """Whether a type is a section: a pydantic model or a dataclass."""
    return isinstance(kind, type) and (issubclass(kind, BaseModel) or dataclasses.is_dataclass(kind))


@cache
def _descriptions(section: type) -> dict[str, str]:
    """Descriptions of the keys of a section: the strings below its fields, or the ``Parameters`` of its docstring."""
    # Strings below fields are not available at run time, so they are read from the source.
    words = {k: v for kind in reversed(section.__mro__) for k, v in _parameter_docs(kind.__doc__ or "").items()}
    for field, below in pairwise(_classes(section.__module__)[section.__name__].body):
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            words[ast.unparse(field.target)] = str(below.value.value)
    return {name: " ".join(text.split()) for name, text in words.items()}


@cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """Syntax trees of the classes of a module. They are parsed together, because `inspect.getsource` of a class would
    parse the whole module for each of them."""
    declared = ast.parse(inspect.getsource(sys.modules[module])).body
    return {each.name: each for each in declared if isinstance(each, ast.ClassDef)}


def all_keys(section: type = ScenarioModel, prefix: str = "") -> Iterator[Key]:
    """Every key of the schema; sections precede their keys."""
    for key in keys_of(section, prefix).values():
        yield key
        if key.section:
            yield from all_keys(key.section, key.path)


def flatten(section: object, prefix: str = "") -> dict[str, Any]:
    """Dotted path to value of every plain key of a section object."""
    flat: dict[str, Any] = {}
    kind: Any = type(section) if prefix else ScenarioModel
    for name, key in keys_of(kind, prefix).items():
        value = getattr(section, name)
        flat |= flatten(value, key.path) if key.section else {key.path: value}
    return flat


def nest(flat: dict[str, Any]) -> dict[str, Any]:
    """The inverse of `flatten`, as plain dictionaries."""
    nested: dict[str, Any] = {}
    for path, value in flat.items():
        *sections, name = path.split(".")
        table = nested
        for part in sections:
            table = table.setdefault(part, {})
        table[name] = value
    return nested


def check_value(key: Key, data: Any) -> tuple[Any, str]:
    """A YAML value converted to the type of the key, and an empty string; or None and the error.

    Strict: text is not a number even if it looks like one, true is not 1, and 1.5 is not an integer. Integers are
    accepted for floats, lists for tuples, and ISO 8601 text for dates.
    """
    # The error quotes the value as it was given; `undated` is the reason if a date does not exist.
    base = _strip(key.annotation)[0]
    given, undated = data, ""
    if base is datetime and isinstance(data, str):
        try:
            data = parse_utc(data)
        except ValueError as error:
            undated = f": {error}" if str(error) else ""
    try:
        return _adapter(key)(tuple(data) if isinstance(data, list) else data), ""
    except ItemError as error:
        return None, f"must be {describe(key.annotation)}; {error}"
    except (ValueError, OverflowError):  # pydantic's error is a ValueError
        hint = undated or _hint(key.annotation, given)
        return None, f"must be {describe(key.annotation)}, not {show_value(given)}{hint}"


def parse_utc(text: str) -> datetime:
    """Date and time in UTC of ISO 8601 text; without a zone it is taken as UTC.

    Raises
    ------
    ValueError
        For anything else. Its text states the reason if the form is correct but the date or time does not exist (30
        February), and is empty otherwise.
    """
    try:
        value = datetime.fromisoformat(text.strip())
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
    except (ValueError, OverflowError) as error:
        formed = re.match(r"\d{4}-\d{2}-\d{2}($|[T ]\d{2}:\d{2})", text.strip())
        raise ValueError(f"no such date or time ({error})" if formed else "") from None


def describe(annotation: Any) -> str:
    """Description of the values that a type permits, such as "a number above 0" or "'j2' or 'sgp4'"."""
    base, limits = _strip(annotation)
    if get_origin(base) is Literal:
        return _join([f"'{word}'" for word in get_args(base)])
    if get_origin(base) in (Union, types.UnionType):
        parts = [describe(part) for part in get_args(base)]
        return _join(["a name" if part == "text" else part for part in parts])
    if section := item_section(annotation):
        names = list(keys_of(section))
        return f"a list of {{{', '.join(names[:4])}{', …' if len(names) > 4 else ''}}}"
    if get_origin(base) is tuple:
        items = get_args(base)
        return f"a list of {len(items)} numbers{_bounds(_strip(items[0])[1])}"
    if "pattern" in limits:
        return "a name of letters, digits, '.', '_' and '-' that starts with a letter or digit"
    if get_origin(base) is dict:
        return "a section with keys"
    words = {
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        str: "text",
        type(None): "null",
        datetime: "a date and time in UTC such as 2026-03-21T12:00:00Z",
    }
    return words[base] + _bounds(limits)


def item_section(annotation: Any) -> type | None:
    """The section of the items if the value of a key is a list of sections; otherwise None."""
    base = _strip(annotation)[0]
    items = get_args(base) if get_origin(base) is tuple else ()
    return items[0] if len(items) == 2 and items[1] is Ellipsis and is_section(items[0]) else None


def _bounds(limits: dict[str, Any]) -> str:
    low, high = (_number(limits.get(a, limits.get(b))) for a, b in (("ge", "gt"), ("le", "lt")))
    if low and high:
        return f" {'from' if 'ge' in limits else 'above'} {low} {'to' if 'le' in limits else 'to below'} {high}"
    if low:
        return f" {'of at least' if 'ge' in limits else 'above'} {low}"
    if high:
        return f" {'of at most' if 'le' in limits else 'below'} {high}"
    return ""


def _number(limit: float | None) -> str:
    return "" if limit is None else str(limit) if isinstance(limit, int) else f"{limit:g}"


def _hint(annotation: Any, value: Any) -> str:
    # Suggestions for common mistakes: misspelt words, quoted numbers and bools, units, decimal commas.
    accepted = {_strip(part)[0] for part in _branches(annotation)}
    if isinstance(value, str):
        choices = [word for part in _branches(annotation) if get_origin(part) is Literal for word in get_args(part)]
        if close := difflib.get_close_matches(value, choices, n=1):
            return f"; did you mean '{close[0]}'?"
        if bool in accepted and value.lower() in ("yes", "no", "on", "off", "true", "false"):
            return f"; write {'true' if value.lower() in ('yes', 'on', 'true') else 'false'}, without quotes"
        if {float, int} & accepted:
            if re.fullmatch(r"[-+]?[0-9.]+([eE][-+]?[0-9]+)?", value):
                return "; remove the quotes"
            if re.fullmatch(r"[-+]?[0-9.]+ *[^\W\d_]\S*", value):
                return "; write the number only, the unit is in the name of the key"
            if re.fullmatch(r"[-+]?[0-9]+,[0-9]+", value):
                return "; write a decimal point, not a comma"
    if int in accepted and isinstance(value, float) and value.is_integer():
        return f"; write {int(value)}" if abs(value) < 1e15 else ""
    return ""


def _branches(annotation: Any) -> tuple[Any, ...]:
    base = _strip(annotation)[0]
    return get_args(base) if get_origin(base) in (Union, types.UnionType) else (base,)


def _strip(annotation: Any) -> tuple[Any, dict[str, Any]]:
    """The bare type, and its limits by name (gt, ge, lt, le, pattern)."""
    limits: dict[str, Any] = {}
    while get_origin(annotation) is Annotated:
        annotation, *extras = get_args(annotation)
        for extra in [m for e in extras for m in (e.metadata if isinstance(e, FieldInfo) else [e])]:
            for name in ("gt", "ge", "lt", "le", "pattern"):
                if (limit := getattr(extra, name, None)) is not None:
                    limits[name] = limit
    return annotation, limits


_ADAPTERS: dict[str, Callable[[Any], Any]] = {}


def _adapter(key: Key) -> Callable[[Any], Any]:
    if key.path not in _ADAPTERS:
        _ADAPTERS[key.path] = _make_adapter(key)
    return _ADAPTERS[key.path]


def _make_adapter(key: Key) -> Callable[[Any], Any]:
    if section := item_section(key.annotation):
        columns = keys_of(section, f"{key.path}[]")
        return lambda items: tuple(_item(section, columns, item, n) for n, item in enumerate(_list(items)))
    adapter: TypeAdapter[Any] = TypeAdapter(key.annotation)

    def validate(data: Any) -> Any:
        # Strict pydantic takes an integer for a float, and NaN and infinity where the annotation is a plain float.
        value = adapter.validate_python(data, strict=True)
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, float) and not math.isfinite(number):
                raise ValueError("not finite")
        return value

    return validate


def _list(items: Any) -> tuple[Any, ...]:
    if not isinstance(items, tuple):
        raise ValueError("not a list")
    return items


class ItemError(ValueError):
    """An item of a list of sections is invalid; the message has its number and the reason."""


def _item(section: type, columns: Mapping[str, Key], item: Any, number: int) -> Any:
    """Item of a list of sections, from a mapping or an object of the section, with each value checked."""
    if not isinstance(item, (dict, section)):
        raise ItemError(f"item {number + 1} is {show_value(item)}")
    given = item if isinstance(item, dict) else {name: getattr(item, name, MISSING) for name in columns}
    values: dict[str, Any] = {}
    for name, key in columns.items():
        data = given.get(name, key.default)
        values[name], message = (None, "is missing") if data is MISSING else check_value(key, data)
        if message:
            raise ItemError(f"item {number + 1}: {name} {message}")
    if unknown := [name for name in given if name not in values]:
        close = difflib.get_close_matches(str(unknown[0]), values, n=1)
        raise ItemError(
            f"item {number + 1}: unknown key '{unknown[0]}'" + (f"; did you mean '{close[0]}'?" if close else "")
        )
    return section(**values)


def _join(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " or " + parts[-1]


def _parameter_docs(doc: str) -> dict[str, str]:
    """Descriptions from a numpydoc ``Parameters`` section."""
    # A line "a, b : type" begins the description of one or several names, an empty line ends it.
    words: dict[str, str] = {}
    names: list[str] = []
    for line in doc.partition("----------\n")[2].splitlines():
        text = line.strip()
        if match := re.fullmatch(r"([a-z_0-9]+(?:, [a-z_0-9]+)*) : .*", text):
            names = match.group(1).split(", ")
        elif text:
            for name in names:
                words[name] = f"{words.get(name, '')} {text}".strip()
        else:
            names = []
    return words
