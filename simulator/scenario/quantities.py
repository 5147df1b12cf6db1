"""Conversion of values given in Python for scenario keys: astropy quantities and times, NumPy arrays, paths."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC
from pathlib import Path
from typing import Any

from simulator.scenario.fields import Key
from simulator.units import UNITS, unit_suffix
from startracker.arguments import is_time, plain


def as_written(path: str, value: Any, keys: Mapping[str, Key]) -> Any:
    """Convert a value to what a YAML file would contain: a number in the unit of the key, and lists.

    Parameters
    ----------
    path : str
        Dotted path of the key.
    value : Any
        A plain value, an astropy ``Quantity`` or ``Time``, an array or number of NumPy, or a path.
    keys : mapping
        The keys of the schema by dotted path.

    Raises
    ------
    InputError
        For a quantity whose unit cannot be converted to the key's.
    """
    # An unknown path is left to the loader, which reports it.
    if path in keys:
        ending = unit_suffix(keys[path].name)
        value = plain(value, (ending and UNITS[ending].astropy) or "", path)
    if is_time(value):
        return value.utc.to_datetime(timezone=UTC)
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [as_written(path, item, keys) for item in value]
    return str(value) if isinstance(value, Path) else value
