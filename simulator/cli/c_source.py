"""The integer tracker of one camera as C source, and what it takes, for ``boresight export-c``."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from simulator.cli.centroid_list import parse_size
from simulator.cli.requests import ExportRequest
from simulator.paths import make_folder, write_atomically
from simulator.randomness import stream
from simulator.study.exported_c.build import Build, compile_export
from simulator.study.exported_c.centroid_lists import centroid_list, list_text
from simulator.study.exported_c.targets import native_compiler
from simulator.theses.yee1999.catalogue import SubCatalog, sub_catalog
from startracker.errors import InputError
from startracker.fixed_point.export_c import CExport, export_c
from startracker.identification.integer_solution import (
    MAX_GROUPS,
    MAX_STARS,
    MAX_TRIADS,
    IntegerCamera,
    IntegerTracker,
)
from startracker.identification.triad_search import TriadLimits

_TIMED_FIELDS = 20
_TIMED_REPETITIONS = 50


def parse_pair(text: str, option: str, separator: str) -> tuple[float, float]:
    """Two numbers of ``AxB`` or ``A:B``; `InputError` for anything else."""
    number = r"([+-]?\d+(?:\.\d*)?|[+-]?\.\d+)"
    match = re.fullmatch(rf"\s*{number}\s*{separator}\s*{number}\s*", text)
    if match is None:
        raise InputError(f"{option}: must be two numbers with '{separator}' between them, not '{text}'")
    return float(match[1]), float(match[2])


def main(request: ExportRequest) -> int:
    """Write the files, and print what they take; compiles where there is a compiler."""
    size, fov = parse_size(request.size), parse_pair(request.fov, "--fov", "x")
    if not all(0.0 < angle < 90.0 for angle in fov):
        raise InputError(f"--fov: must be between 0° and 90° across and down, not {fov[0]:g} by {fov[1]:g}")
    if not 0.0 < request.max_separation_deg < 32.0:
        raise InputError(
            f"--max-separation: must be above 0° and below 32°, which 6.10 holds, not {request.max_separation_deg:g}"
        )
    stars = sub_catalog(
        request.edition, request.magnitude_limit, *parse_pair(request.declination, "--declination", ":")
    )
    camera = IntegerCamera(size, fov, request.centroid_error_px, request.false_alarm_rate, request.resolution_px)
    tracker = IntegerTracker.build(
        camera, stars.hr, stars.ra_deg, stars.dec_deg, stars.v_mag, request.max_separation_deg
    )
    limits = TriadLimits(
        separation_tolerance_deg=request.tolerance_deg,
        rotation_tolerance_deg=request.rotation_tolerance_deg,
        enclosed_tolerance_deg=request.enclosed_tolerance_deg or None,
        grouping_tolerance_deg=request.rotation_tolerance_deg,
        vote_number=request.vote_number,
        three_stars=True,
    )
    export = export_c(tracker, limits, MAX_STARS, MAX_TRIADS, MAX_GROUPS, request.prefix)
    folder = make_folder(request.out)
    for name, text in export.files.items():
        write_atomically(folder / name, text)
    console = Console(highlight=False)
    console.print(
        f"{len(export.files)} files in {folder}: {len(tracker.tables):,} stars, {len(tracker.tables.first):,} pairs",
        soft_wrap=True,
    )
    console.print(_table(export, *_measured(export, stars, fov, size)))
    return 0


def _measured(
    export: CExport, stars: SubCatalog, fov: tuple[float, float], size: tuple[int, int]
) -> tuple[Build | None, float]:
    """What the machine's compiler makes of it, and seconds for a field; (None, 0) without a compiler."""
    target = native_compiler()
    if target is None:
        return None, 0.0
    ra, dec = np.radians(stars.sky_deg).T
    directions = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    lists = [
        list_text(centroid_list(directions, stars.v_mag, fov, size, stream(1, "export", k)))
        for k in range(_TIMED_FIELDS)
    ]
    with tempfile.TemporaryDirectory() as folder:
        build = compile_export(export, Path(folder), target)
        return build, build.time_s("".join(lists), _TIMED_REPETITIONS)


def _table(export: CExport, build: Build | None, time_s: float) -> Table:
    table = Table(show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    for name, count in export.table_bytes.items():
        table.add_row(f"table {name}", f"{count:,} bytes")
    table.add_row("tables", f"{sum(export.table_bytes.values()):,} bytes", end_section=True)
    if build is None:
        table.add_row("no C compiler here", "not measured")
        return table
    table.add_row("code", f"{build.code_bytes:,} bytes")
    table.add_row("context, given by the caller", f"{build.context_bytes:,} bytes")
    table.add_row("static buffers", f"{build.static_bytes:,} bytes")
    table.add_row("stack, at most", f"{build.stack_bytes:,} bytes")
    table.add_row("heap", "0 bytes" if not build.heap_calls else ", ".join(build.heap_calls))
    table.add_row("comparisons of pairs, at most", f"{export.most_steps:,}")
    table.add_row(f"time, mean of {_TIMED_FIELDS} fields", f"{time_s * 1e3:.3f} ms")
    return table
