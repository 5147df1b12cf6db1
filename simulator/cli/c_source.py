"""A tracker as C source, and what it takes, for ``boresight export-c``: here the integer tracker for centroids."""

from __future__ import annotations

import dataclasses
import re
import tempfile
from pathlib import Path
from typing import get_type_hints

import numpy as np
from rich.console import Console

from simulator.cli.c_files import compiled_here, memory_table, write_export
from simulator.cli.centroid_list import parse_size
from simulator.cli.requests import ExportRequest
from simulator.randomness import stream
from simulator.study.exported_c.centroid_lists import centroid_list, list_text
from simulator.theses.yee1999.catalogue import SubCatalog, sub_catalog
from startracker.errors import InputError
from startracker.identification.integer_solution import (
    MAX_GROUPS,
    MAX_STARS,
    MAX_TRIADS,
    IntegerCamera,
    IntegerTracker,
)
from startracker.identification.triad_search import TriadLimits
from startracker.integer_export import export_c

_COMMON = ("out", "prefix", "scenario")
_OF_SCENARIO = ("set_values", "arithmetic", "identifier")
"""Options of both kinds of export, and of the flight build alone."""
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
    _check_options(request)
    if request.scenario is None:
        return _export_triads(request)
    from simulator.cli.flight_source import main as export_flight

    return export_flight(request, request.scenario)


def _check_options(request: ExportRequest) -> None:
    """`InputError` for an option of the other kind of export."""
    kinds = get_type_hints(ExportRequest, include_extras=True)
    for given in dataclasses.fields(request):
        if given.name in _COMMON or getattr(request, given.name) in (given.default, []):
            continue
        name = kinds[given.name].__metadata__[0].default  # where typer keeps the name of an annotated option
        if given.name in _OF_SCENARIO and request.scenario is None:
            raise InputError(f"{name}: has no effect without --scenario")
        if given.name not in _OF_SCENARIO and request.scenario is not None:
            raise InputError(f"{name}: has no effect with --scenario; the scenario says it")


def _export_triads(request: ExportRequest) -> int:
    """The integer tracker for lists of centroids."""
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
    folder = write_export(export, request.out)
    console = Console(highlight=False)
    console.print(
        f"{len(export.files)} files in {folder}: {len(tracker.tables):,} stars, {len(tracker.tables.first):,} pairs",
        soft_wrap=True,
    )
    with tempfile.TemporaryDirectory() as name:
        build = compiled_here(export, Path(name))
        table = memory_table(export, build)
        if build is not None:
            time_s = build.time_s(_fields(stars, fov, size), _TIMED_REPETITIONS)
            table.add_row("comparisons of pairs, at most", f"{export.most_steps:,}")
            table.add_row(f"time, mean of {_TIMED_FIELDS} fields", f"{time_s * 1e3:.3f} ms")
    console.print(table)
    return 0


def _fields(stars: SubCatalog, fov: tuple[float, float], size: tuple[int, int]) -> str:
    """Lists of centroids of some fields."""
    ra, dec = np.radians(stars.sky_deg).T
    directions = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    return "".join(
        list_text(centroid_list(directions, stars.v_mag, fov, size, stream(1, "export", k)))
        for k in range(_TIMED_FIELDS)
    )
