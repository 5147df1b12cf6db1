"""Files of a coverage study."""

from __future__ import annotations

from pathlib import Path

from simulator.paths import make_folder
from simulator.scenario import Scenario
from simulator.study.coverage.maps import count_plot, coverage_map, magnitude_plot
from simulator.study.coverage.survey import Coverage
from simulator.study.plots import save_bytes
from simulator.study.result_files import json_text, parquet_bytes, write_files
from simulator.study.results_folder import Identity

RESULT_FILES = ("coverage.json", "coverage.parquet", "map.png", "counts.png", "magnitudes.png")


def write_coverage(result: Coverage, scenario: Scenario, folder: Path, identity: Identity | None = None) -> None:
    """Write ``coverage.json``, ``coverage.parquet`` and the plots."""
    files: dict[str, str | bytes] = {
        "coverage.parquet": parquet_bytes(result.to_table(scenario), compression="zstd"),
        "coverage.json": json_text(result.summary() | {"identity": identity.to_dict() if identity else None}),
    }
    for name, draw in (("map.png", coverage_map), ("counts.png", count_plot), ("magnitudes.png", magnitude_plot)):
        files[name] = save_bytes(draw(result))
    write_files(make_folder(folder), files)
