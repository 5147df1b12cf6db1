"""Result files: tables, values and pictures as bytes, written atomically."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

from simulator.paths import make_folder, write_atomically
from startracker.catalog import load_catalog

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from simulator.scenario import Scenario
    from simulator.study.results_folder import Identity


def now_utc() -> str:
    """Current date and time, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def catalogs_of(scenario: Scenario) -> dict[str, Any]:
    """Provenance of the catalogues of the sky and of the tracker."""
    names = {"sky": scenario.sky.catalog, "tracker": scenario.tracker.catalog}
    return {use: load_catalog(name).provenance.as_dict() for use, name in names.items()}


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


def write_study(
    folder: Path,
    kind: str,
    values: Mapping[str, Any],
    identity: Identity | None,
    figures: Mapping[str, Figure],
    table: pa.Table | None = None,
) -> tuple[str, ...]:
    """Write ``KIND.json`` with the identity, ``KIND.parquet`` if there is a table, and every figure as PNG; returns the
    names of the files."""
    from startracker.images.picture import figure_bytes

    stated = {"identity": identity.to_dict() if identity else None}
    files: dict[str, str | bytes] = {f"{kind}.json": json_text({**values, **stated})}
    if table is not None:
        files[f"{kind}.parquet"] = parquet_bytes(table, compression="zstd")
    files |= {f"{name}.png": figure_bytes(figure, dpi=130) for name, figure in figures.items()}
    write_files(make_folder(folder), dict(reversed(files.items())))  # last the values, which identify the results
    return tuple(files)
