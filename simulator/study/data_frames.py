"""Results as tables of pandas and astropy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from importlib.util import find_spec
from typing import Any

import pyarrow as pa

from simulator.units import UNITS, unit_suffix
from startracker.errors import InputError


class Rows(ABC):
    """A result with one row per trial or frame, which becomes a table of pandas or astropy."""

    @abstractmethod
    def _table(self) -> pa.Table:
        """The rows."""

    def _meta(self) -> dict[str, Any]:
        """Origin of the table: name of the scenario, seed, version."""
        return {}

    def to_pandas(self) -> Any:
        """The rows as a ``pandas.DataFrame``, with the columns of the Parquet file.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        if find_spec("pandas") is None:
            raise InputError("pandas is not installed: pip install pandas (to_astropy() works without it)")
        frame = self._table().to_pandas()
        frame.attrs.update(self._meta())
        return frame

    def to_astropy(self) -> Any:
        """The rows as an ``astropy.table.Table`` with units; scenario, seed and version are in its ``meta``.

        Strings and truth values that are missing are masked.
        """
        from astropy.table import MaskedColumn, Table

        rows, out = self._table(), Table(meta=self._meta())
        for name in rows.column_names:
            values = rows[name].to_pylist()
            missing = [value is None for value in values]
            if any(missing):
                filler = "" if pa.types.is_string(rows.schema.field(name).type) else 0
                values = MaskedColumn([filler if value is None else value for value in values], mask=missing)
            out[name] = values
            ending = unit_suffix(name)
            out[name].unit = UNITS[ending].astropy if ending else None
        return out
