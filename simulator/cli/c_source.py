"""The tracker of one camera as C source, and what it takes, for ``boresight export-c``."""

from __future__ import annotations

import dataclasses
import re
import tempfile
import warnings
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from rich.console import Console

from simulator.checks import load_scenario
from simulator.cli.c_files import compiled_here, memory_table, write_export
from simulator.cli.centroid_list import parse_size
from simulator.cli.requests import ExportRequest
from simulator.study.exported_c.build import Build
from simulator.study.flight.design import camera_design, flight_design
from simulator.study.flight.program import list_text
from startracker.errors import InputError, InputWarning
from startracker.flight.design import FlightDesign
from startracker.flight.export import flight_export
from startracker.flight.stars import StarList
from startracker.flight.unit_scenes import SEED, scene_rows, unit_field, unit_scenes
from startracker.settings import IdentificationSettings, TriadSettings

_ALWAYS = ("out", "prefix", "source", "scenario", "arithmetic", "identifier")
_OF_SCENARIO = ("set_values",)
_OF_TRIADS = ("tolerance_deg", "rotation_tolerance_deg", "enclosed_tolerance_deg", "vote_number")
_WITHOUT_EFFECT = {
    "max_separation_deg": "pairs are as long as the field of view allows",
    "centroid_error_px": "each star of a list states its own variance",
    "resolution_px": "stars that the camera does not resolve are merged",
    "edition": "the stars are those of the fifth edition",
}
"""Options of the former integer tracker, and why the flight build does not need them."""
_SOURCES = ("frames", "centroids")
_TIMED_FRAMES, _TIMED_LISTS, _REPETITIONS = 5, 20, 5
_LIST_SIGMA_PX = 0.1


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
    design = _scenario_design(request) if request.scenario else _camera_design(request)
    export = flight_export(design, request.prefix)
    folder = write_export(export, request.out)
    camera, what = design.camera, f"{design.name}, " if design.name else ""
    console = Console(highlight=False)
    console.print(
        f"{len(export.files)} files in {folder}: {what}{camera.width} x {camera.height} pixels, "
        f"{len(design.guide):,} guide stars, {design.arithmetic}, {design.identifier}"
        f"{'' if design.takes_frames else ', from centroids'}",
        soft_wrap=True,
    )
    with tempfile.TemporaryDirectory() as name:
        build = compiled_here(export, Path(name))
        table = memory_table(export, build)
        if build is not None and design.takes_frames:
            table.add_row("time of a frame here", f"{_frame_time_s(build, design) * 1e3:.1f} ms")
        elif build is not None:
            table.add_row(f"time here, mean of {_TIMED_LISTS} lists", f"{_list_time_s(build, design) * 1e3:.2f} ms")
        console.print(table)
    console.print(f"build: make -C {folder}; tests: make -C {folder} test; read {folder / 'README.md'}", soft_wrap=True)
    return 0


def _check_options(request: ExportRequest) -> None:
    """`InputError` for an option that contradicts another one, `InputWarning` for one that has no effect any more."""
    source = request.source or ("centroids" if request.scenario is None else "frames")
    if source not in _SOURCES:
        raise InputError(f"--from: must be {' or '.join(_SOURCES)}, not '{source}'")
    if source == "frames" and request.scenario is None:
        raise InputError("--from frames: needs --scenario, which has the detector")
    for given in dataclasses.fields(request):
        if given.name in _ALWAYS or getattr(request, given.name) in (given.default, []):
            continue
        name = _name_of(given.name)
        if given.name in _WITHOUT_EFFECT:
            warnings.warn(f"{name}: has no effect any more; {_WITHOUT_EFFECT[given.name]}", InputWarning, stacklevel=2)
        elif given.name in _OF_SCENARIO:
            if request.scenario is None:
                raise InputError(f"{name}: has no effect without --scenario")
        elif request.scenario is not None:
            raise InputError(f"{name}: has no effect with --scenario; the scenario says it")
        elif given.name in _OF_TRIADS and request.identifier == "adaptive":
            raise InputError(f"{name}: has no effect with --identifier adaptive")


def _name_of(field: str) -> str:
    """Option of a field: typer keeps the name of an annotated option as its default."""
    hint: Any = get_type_hints(ExportRequest, include_extras=True)[field]
    return str(hint.__metadata__[0].default)


# ------------------------------------------------------------------ designs
def _scenario_design(request: ExportRequest) -> FlightDesign:
    """The camera, stars, detector and settings of a scenario."""
    assert request.scenario is not None
    scenario = load_scenario(request.scenario, request.set_values or ())
    design = flight_design(scenario, request.arithmetic, request.identifier)
    return dataclasses.replace(design, detector=None) if request.source == "centroids" else design


def _camera_design(request: ExportRequest) -> FlightDesign:
    """A camera without distortion, and the stars of the Bright Star Catalogue within a range of declinations."""
    size, fov = parse_size(request.size), parse_pair(request.fov, "--fov", "x")
    if not all(0.0 < angle < 90.0 for angle in fov):
        raise InputError(f"--fov: must be between 0° and 90° across and down, not {fov[0]:g} by {fov[1]:g}")
    identifier = request.identifier or "triads"
    return camera_design(
        size,
        fov,
        _settings(request, identifier),
        identifier,
        request.arithmetic or "fixed",
        parse_pair(request.declination, "--declination", ":"),
        request.magnitude_limit,
    )


def _settings(request: ExportRequest, identifier: str) -> IdentificationSettings:
    if identifier == "adaptive":
        return IdentificationSettings(false_alarm_rate=request.false_alarm_rate)
    return TriadSettings(
        false_alarm_rate=request.false_alarm_rate,
        separation_tolerance_deg=request.tolerance_deg,
        rotation_tolerance_deg=request.rotation_tolerance_deg,
        grouping_tolerance_deg=request.rotation_tolerance_deg,
        enclosed_tolerance_deg=request.enclosed_tolerance_deg or None,
        vote_number=request.vote_number,
    )


# ------------------------------------------------------------------ times
def _frame_time_s(build: Build, design: FlightDesign) -> float:
    """Seconds of a frame."""
    frame = scene_rows(design, unit_scenes(design)[0], SEED).astype("<u2").tobytes()
    return build.time_s(frame, _TIMED_FRAMES, "frames")


def _list_time_s(build: Build, design: FlightDesign) -> float:
    """Seconds of a list, the mean of fields of guide stars."""
    lists = ""
    for index in range(_TIMED_LISTS):
        field = unit_field(design, index)
        flux = 4000.0 * 10.0 ** (-0.4 * field.v_mag)
        lists += list_text(StarList.of(field.xy, flux, np.full(len(flux), _LIST_SIGMA_PX**2)))
    return build.time_s(lists.encode(), _REPETITIONS, "stars") / _TIMED_LISTS
