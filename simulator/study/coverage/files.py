"""Files of a coverage study."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from simulator.paths import make_folder, write_atomically
from simulator.scenario import Scenario
from simulator.study.coverage.maps import count_plot, coverage_map, magnitude_plot
from simulator.study.coverage.survey import Coverage
from simulator.study.plots import save_bytes
from simulator.study.results_folder import Identity

__all__ = ["RESULT_FILES", "write_coverage"]

RESULT_FILES = ("coverage.json", "coverage.parquet", "map.png", "counts.png", "magnitudes.png")


def write_coverage(result: Coverage, scenario: Scenario, folder: Path, identity: Identity | None = None) -> None:
    """Write ``coverage.json``, ``coverage.parquet`` and the pictures, each moved into place whole."""
    summary = result.summary() | {"identity": identity.to_dict() if identity else None}
    make_folder(folder)
    sink = pa.BufferOutputStream()
    pq.write_table(result.to_table(scenario), sink, compression="zstd")
    write_atomically(folder / "coverage.parquet", sink.getvalue().to_pybytes())
    write_atomically(folder / "coverage.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    for name, draw in (("map.png", coverage_map), ("counts.png", count_plot), ("magnitudes.png", magnitude_plot)):
        write_atomically(folder / name, save_bytes(draw(result)))
