"""Files of an environment study."""

from __future__ import annotations

from pathlib import Path

from simulator.study.environment.plots import ageing_figure, particles_figure
from simulator.study.environment.survey import EnvironmentSurvey
from simulator.study.plots import save_bytes
from simulator.study.result_files import json_text, parquet_bytes, write_files
from simulator.study.results_folder import Identity

RESULT_FILES = ("environment.json", "environment.parquet", "particles.png", "ageing.png")


def write_environment(result: EnvironmentSurvey, folder: Path, identity: Identity) -> None:
    """Write ``environment.json``, ``environment.parquet`` and the pictures."""
    files: dict[str, str | bytes] = {
        "environment.parquet": parquet_bytes(result.to_table(), compression="zstd"),
        "environment.json": json_text(result.summary() | {"identity": identity.to_dict()}),
        "particles.png": save_bytes(particles_figure(result)),
        "ageing.png": save_bytes(ageing_figure(result)),
    }
    write_files(folder, files)
