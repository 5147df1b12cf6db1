"""Range checks of settings."""

from __future__ import annotations

import dataclasses
import math
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np

from startracker.arguments import ABOVE_0, of_kind, shown, switch, text
from startracker.errors import InputError

T = TypeVar("T")
FORBID = {"extra": "forbid"}  # read by pydantic, which this package does not import

BELOW_1 = math.nextafter(1.0, 0.0)
POSITIVE, COUNT, FROM_0 = (ABOVE_0, math.inf), (1, math.inf), (0.0, math.inf)


def settings_or_default(name: str, given: T | None, kind: type[T]) -> T:
    """Argument as settings of a class; its defaults for None.

    Raises
    ------
    InputError
        For anything else, such as a mapping or the settings of another stage.
    """
    return kind() if given is None else of_kind(name, given, kind)


def check_settings(settings: Any, **limits: tuple[float, float]) -> None:
    """Check the values of a dataclass by the types of its fields, and numbers by their limits (inclusive).

    None is accepted where the type permits it.

    Raises
    ------
    InputError
        With the setting's name, its value and its limits.
    """
    for field in dataclasses.fields(settings):
        name, kind, value = field.name, str(field.type), getattr(settings, field.name)
        if value is None and "None" in kind:
            continue
        if kind == "bool":
            switch(name, value)
        elif kind.startswith("str"):
            text(name, value)
        elif name in limits:
            _check_number(name, value, *limits[name], whole=kind.startswith("int"))


def _check_number(name: str, value: Any, least: float, most: float, *, whole: bool) -> None:
    # Python counts a truth value as an integer; as a setting it is a mistake.
    good = isinstance(value, Integral if whole else Real) and not isinstance(value, bool | np.bool_)
    if not (good and least <= value <= most):
        within = f"at least {least:g}" if most == math.inf else f"from {least:g} to {most:g}"
        number = "number" if good or not whole else "whole number"
        raise InputError(f"{name} is {shown(value)}; it must be a {number} {within}")
