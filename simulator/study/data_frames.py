"""Results as tables of pandas and astropy."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from startracker.errors import InputError

__all__ = ["UNITS", "Rows"]

UNITS = {
    "deg_s": "deg / s",
    "arcsec": "arcsec",
    "deg2": "deg2",
    "deg": "deg",
    "px": "pix",
    "ms": "ms",
    "mag": "mag",
    "km": "km",
    "dn": "adu",
    "c": "deg_C",
    "s": "s",
}
"""Units of astropy by the ending of a column's name."""


class Rows:
    """A result with one row per trial or frame, which becomes a table of pandas or astropy."""

    def _table(self) -> pa.Table:
        raise NotImplementedError

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
        try:
            import pandas  # noqa: F401
        except ImportError:
            raise InputError("pandas is not installed: pip install pandas (to_astropy() works without it)") from None
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
            out[name].unit = next((unit for ending, unit in UNITS.items() if name.endswith(f"_{ending}")), None)
        return out
