"""Result files: tables and values as bytes, written atomically."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from simulator.paths import write_atomically


def now_utc() -> str:
    """Current date and time, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def json_text(values: Any) -> str:
    """Values as the text of a JSON file."""
    return json.dumps(values, indent=2, allow_nan=False) + "\n"


def parquet_bytes(table: pa.Table, **options: Any) -> bytes:
    """A table as the bytes of a Parquet file; `options` as for `pyarrow.parquet.write_table`."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, **options)
    data: bytes = sink.getvalue().to_pybytes()
    return data


def write_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write files by name; `InputError` if one cannot be written."""
    for name, data in files.items():
        write_atomically(folder / name, data)
