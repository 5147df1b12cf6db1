"""Values of scenario keys given in Python: quantities and times of astropy, arrays and numbers of NumPy, paths."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC
from pathlib import Path
from typing import Any

from simulator.scenario.fields import Key
from startracker.interop import is_time, plain

__all__ = ["as_written"]

_UNITS = {
    "deg_s": "deg/s",
    "deg_s2": "deg/s2",
    "deg_h": "deg/h",
    "deg_sqrt_h": "deg/h(1/2)",
    "deg": "deg",
    "arcsec": "arcsec",
    "mas": "mas",
    "mas_yr": "mas/yr",
    "km": "km",
    "mm": "mm",
    "um": "um",
    "um_k": "um/K",
    "nm": "nm",
    "px": "pix",
    "h": "h",
    "hz": "Hz",
    "us": "us",
    "s": "s",
    "c": "deg_C",
    "ff": "fF",
    "e": "electron",
    "e_s": "electron/s",
    "e_per_dn": "electron/adu",
    "dn": "adu",
    "bits": "bit",
}
"""Units of astropy by the ending of a key's name."""


def as_written(path: str, value: Any, keys: Mapping[str, Key]) -> Any:
    """A value as YAML would give it: in the key's unit, with lists in place of tuples and arrays.

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
        For a quantity in another kind of unit.
    """
    if path in keys:
        value = plain(value, _UNITS.get(keys[path].unit_suffix[1:], ""), path)
    if is_time(value):
        return value.utc.to_datetime(timezone=UTC)
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [as_written(path, item, keys) for item in value]
    return str(value) if isinstance(value, Path) else value
