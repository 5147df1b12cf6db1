"""Columns of Parquet files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from startracker.errors import InputError
from startracker.files import MESSAGE_BYTES, check_file

MOST_ROWS = 2_000_000
"""Most rows of a table: compressed, far more fit into a small file."""


def read_parquet(path: Path) -> dict[str, list[Any]]:
    """Values of all columns by name; dates as text in UTC, ISO 8601.

    Raises
    ------
    InputError
        If the file cannot be read, is not a Parquet table, or has more than `MOST_ROWS` rows.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    check_file(path, MESSAGE_BYTES, "give a Parquet table")
    try:
        rows = pq.read_metadata(path).num_rows
        if rows > MOST_ROWS:
            raise InputError(
                f"{path}: has {rows:,} rows, more than the {MOST_ROWS:,} that are read; give a shorter table"
            )
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        reason = getattr(error, "strerror", None)
        what = f"cannot be read ({reason})" if reason else "is not a Parquet table, or is truncated"
        raise InputError(f"{path}: {what}") from error
    return {name: _values(column) for name, column in zip(table.column_names, table.columns, strict=True)}


def _values(column: Any) -> list[Any]:
    import pyarrow as pa

    if not pa.types.is_timestamp(column.type):
        return list(column.to_pylist())
    # The cast drops the time zone, in which Arrow stores UTC, and NumPy writes ISO 8601.
    return [str(value) for value in column.cast(pa.timestamp("ns")).to_numpy()]
