"""The flight build of a scenario's camera as C source, and what it takes, for ``boresight export-c --scenario``."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from rich.console import Console

from simulator.checks import load_scenario
from simulator.cli.c_files import compiled_here, memory_table, write_export
from simulator.cli.requests import ExportRequest
from simulator.study.exported_c.build import Build
from simulator.study.flight.design import flight_design
from startracker.flight.export import flight_export
from startracker.flight.unit_scenes import SEED, scene_rows, unit_scenes

_TIMED_FRAMES = 5


def main(request: ExportRequest, scenario_file: Path) -> int:
    """Write the files, and print what they take; compiles where there is a compiler."""
    scenario = load_scenario(scenario_file, request.set_values or ())
    design = flight_design(scenario, request.arithmetic, request.identifier)
    export = flight_export(design, request.prefix)
    folder = write_export(export, request.out)
    camera = design.camera
    console = Console(highlight=False)
    console.print(
        f"{len(export.files)} files in {folder}: {design.name}, {camera.width} x {camera.height} pixels, "
        f"{len(design.guide):,} guide stars, {design.arithmetic}, {design.identifier}",
        soft_wrap=True,
    )
    with tempfile.TemporaryDirectory() as name:
        build = compiled_here(export, Path(name))
        table = memory_table(export, build)
        if build is not None:
            frame = scene_rows(design, unit_scenes(design)[0], SEED).astype("<u2").tobytes()
            table.add_row("time of a frame here", f"{_frame_time_s(build, frame) * 1e3:.1f} ms")
        console.print(table)
    console.print(f"build: make -C {folder}; tests: make -C {folder} test; read {folder / 'README.md'}", soft_wrap=True)
    return 0


def _frame_time_s(build: Build, frame: bytes) -> float:
    """Seconds of a frame, from runs with one and with several."""
    spent = []
    for count in (1, 1 + _TIMED_FRAMES):
        begun = time.perf_counter()
        build.run(frame * count, "frames")
        spent.append(time.perf_counter() - begun)
    return max(spent[1] - spent[0], 0.0) / _TIMED_FRAMES
