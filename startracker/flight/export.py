"""Files of a flight build: C sources, tables, build files, example, unit tests, fuzzers, and what a team reads.

The stages' modules give their constants and arrays (`Part`); their sources are in ``c/`` here and in its folder of the
identifier. All else is in ``package/``. In every file ``tracker_`` and
``TRACKER_`` become the prefix, and ``@WORD@`` the value of the word; what only frames need is left out of a build from
centroids (`for_input`).
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import NamedTuple

from startracker._version import __version__
from startracker.errors import InputError
from startracker.flight.c_table import CTable
from startracker.flight.c_text import CExport, check_prefix, for_input, prefixed, tables_header, tables_source
from startracker.flight.design import FlightDesign
from startracker.flight.directions import GRID_MODULES, grid_arrays, grid_constants
from startracker.flight.following import (
    FOLLOWING_MODULES,
    FollowingTables,
    following_arrays,
    following_constants,
    following_tables,
)
from startracker.flight.front_tables import FRONT_MODULES, FrontTables, front_arrays, front_constants, front_tables
from startracker.flight.pose import POSE_MODULES, PoseTables, pose_arrays, pose_constants, pose_tables
from startracker.flight.search_export import search_arrays, search_constants, search_modules
from startracker.flight.search_tables import SearchTables, search_tables
from startracker.flight.unexplained import UNEXPLAINED_MODULES, unexplained_arrays, unexplained_constants
from startracker.flight.unit_data import unit_test_data

SATURATED_PART = 20
"""An unsolved frame with more than one saturated pixel in this many is called saturated (`survey.SATURATED_SHARE`)."""
_INCLUDE = re.compile(r'^#include "(tracker\w*\.h)"', re.MULTILINE)
_TESTS = ("test_frames", "test_stars")
_FUZZERS = ("fuzz_front", "fuzz_frames", "fuzz_stars", "fuzz_search", "fuzz_pose", "fuzz_filter", "fuzz_session")
_OF_FRAMES = ("test_frames.c", "fuzz_front.c", "fuzz_frames.c", "fuzz_pixels.h")
"""Files of ``package/`` that a build from centroids does not have."""
_CALLS = {
    True: "for (y = 0; y < TRACKER_HEIGHT; y++)\n *         tracker_row(&context, row);\n"
    " *     tracker_finish(&context, &answer);",
    False: "tracker_solve_stars(&context, star, count, &answer);",
}
"""Example of `flight.h`, with and without frames."""
_GENERATED = ("tracker_tables.h", "tracker.h")
_LICENCE = "/* Copyright (c) 2026, The boresight developers. SPDX-License-Identifier: BSD-3-Clause (see LICENSE). */\n"


class FlightTables(NamedTuple):
    """Tables of all stages of a design."""

    front: FrontTables | None
    """None: a build from centroids, which has no front end."""
    search: SearchTables
    pose: PoseTables
    following: FollowingTables
    max_stars: int
    """Stars of a frame or a list."""


class Part(NamedTuple):
    """What a stage gives to an export."""

    modules: tuple[str, ...]
    """Its sources, ``tracker_<module>.c``."""
    constants: dict[str, int]
    """Macros by name, without the prefix."""
    arrays: list[CTable]


def flight_export(design: FlightDesign, prefix: str = "tracker") -> CExport:
    """Files of a flight build.

    Parameters
    ----------
    design : FlightDesign
        Camera, guide stars, detector, settings, arithmetic and identifier. Without a detector the build has no front
        end, and its program, tests and fuzzers take lists of stars only.
    prefix : str
        Prefix of all names and sources.

    Raises
    ------
    InputError
        A prefix that is not a C identifier; a camera or settings that the integers cannot hold.
    """
    check_prefix(prefix)
    return assemble(design, flight_parts(flight_tables(design)), prefix, unit_test_data(design))


def flight_tables(design: FlightDesign) -> FlightTables:
    """Tables of a design.

    Raises
    ------
    InputError
        For a camera, settings or guide stars that a flight build does not hold.
    """
    following = following_tables(design.motion, design.tracking)
    front = front_tables(design) if design.takes_frames else None
    return FlightTables(front, search_tables(design), pose_tables(design), following, design.detection.max_stars)


def flight_parts(tables: FlightTables) -> list[Part]:
    """What the stages give."""
    front, search, pose, following, max_stars = tables
    grid = pose.grid
    from_lists = [
        Part(GRID_MODULES, grid_constants(grid), grid_arrays(grid)),
        Part(search_modules(search), search_constants(search), search_arrays(search)),
        Part(POSE_MODULES, pose_constants(pose), pose_arrays(pose)),
        Part(UNEXPLAINED_MODULES, unexplained_constants(), unexplained_arrays(max(max_stars, pose.most_field))),
        Part(FOLLOWING_MODULES, following_constants(following), following_arrays(following)),
    ]
    if front is None:
        return [*from_lists, Part(("solver", "frame"), {}, [])]
    frames = Part(FRONT_MODULES, front_constants(front), front_arrays(front))
    return [frames, *from_lists, Part(("solver", "frame"), {"SATURATED_PART": SATURATED_PART}, [])]


def assemble(design: FlightDesign, parts: Sequence[Part], prefix: str, tests: str) -> CExport:
    """Files of these parts, with the header of the unit tests' data."""
    constants, arrays = _collected(design, parts)
    modules = tuple(dict.fromkeys(module for part in parts for module in part.modules))
    sources = {f"tracker_{module}.c": _source(f"tracker_{module}.c", design) for module in modules}
    headers = _headers(sources.values(), design)
    version = _version(design, constants, arrays)
    text = f"const char tracker_version[{len(version) + 1}]"
    declared = [f"extern {text}; /* what these tables were made from, and their digest */"]
    defined = [f'{text} = "{version}";', ""]
    tables = {
        "tracker_tables.h": tables_header(constants, arrays, declared),
        "tracker_tables.c": tables_source(arrays, defined),
    }
    words = _words(design, version, prefix, modules, [*headers, *tables], arrays)
    package = {
        item.name: _filled(for_input(item.read_text("utf-8"), design.takes_frames), words)
        for item in _folder("startracker.flight", "package").iterdir()
        if item.is_file() and (design.takes_frames or item.name not in _OF_FRAMES)
    }
    headers["tracker.h"] = _filled(headers["tracker.h"], words)
    texts = {**sources, **headers, **tables, **package, "test_data.h": tests}
    texts = {prefixed(name, prefix): prefixed(_licensed(name, text), prefix) for name, text in sorted(texts.items())}
    return CExport(prefix, texts, {table.name: table.bytes for table in arrays}, modules)


def _collected(design: FlightDesign, parts: Sequence[Part]) -> tuple[dict[str, int], list[CTable]]:
    """Macros and arrays of all parts; `InputError` for a name that two of them give."""
    width, height = design.camera.width, design.camera.height
    constants = {"WIDTH": width, "HEIGHT": height, "MAX_STARS": design.detection.max_stars}
    if design.arithmetic == "float":
        constants["FLOAT"] = 1
    arrays: dict[str, CTable] = {}
    for part in parts:
        twice = constants.keys() & part.constants.keys() | arrays.keys() & {table.name for table in part.arrays}
        if twice:
            raise InputError(f"flight build: {', '.join(sorted(twice))} is defined by two stages")
        constants |= part.constants
        arrays |= {table.name: table for table in part.arrays}
    return constants, list(arrays.values())


def _folder(package: str, name: str) -> Traversable:
    return files(package) / name


def _source(name: str, design: FlightDesign) -> str:
    """Text of a source or header, from the first folder that has it, for frames or for lists only."""
    flight = _folder("startracker.flight", "c")
    for folder in (flight / design.identifier, flight):
        file = folder / name
        if file.is_file():
            return for_input(file.read_text("utf-8"), design.takes_frames)
    raise InputError(f"flight build: there is no source {name}")


def _headers(sources: Iterable[str], design: FlightDesign) -> dict[str, str]:
    """Headers that the sources include, directly or through others, by name; the interface is ``tracker.h``."""
    found = {"tracker.h": _source("flight.h", design)}
    waiting = [*sources, *found.values()]
    while waiting:
        for name in _INCLUDE.findall(waiting.pop()):
            if name not in found and name not in _GENERATED:
                found[name] = _source(name, design)
                waiting.append(found[name])
    return found


def _version(design: FlightDesign, constants: Mapping[str, int], arrays: Sequence[CTable]) -> str:
    """What the tables were made from, and a digest of what they hold."""
    held = hashlib.sha256(repr(sorted(constants.items())).encode())
    for table in arrays:
        held.update(f"{table.declaration}{table.values.tolist()}".encode())
    origin = f"scenario {design.name or 'unnamed'} {design.digest[:16]}".rstrip()
    kind = f"{design.arithmetic}; {design.identifier}" + ("" if design.takes_frames else "; from centroids")
    return f"boresight {__version__}; {origin}; {kind}; tables {held.hexdigest()[:16]}"


def _words(
    design: FlightDesign,
    version: str,
    prefix: str,
    modules: Sequence[str],
    headers: Sequence[str],
    arrays: Sequence[CTable],
) -> dict[str, str]:
    """Words of the files of ``package/``."""
    width, height, frames = design.camera.width, design.camera.height, design.takes_frames
    flash = sum(table.bytes for table in arrays)
    return {
        "PREFIX": prefix,
        "VERSION": version,
        "NAME": design.name or "unnamed",
        "SIZE": f"{width} × {height}",
        "GUIDES": f"{len(design.guide):,}",
        "ARITHMETIC": design.arithmetic,
        "IDENTIFIER": design.identifier,
        "TABLE_BYTES": f"{flash:,}",
        "OBJECTS": " ".join(f"tracker_{name}.o" for name in ("tables", *modules)),
        "CMAKE_SOURCES": " ".join(f"tracker_{name}.c" for name in ("tables", *modules)),
        "HEADERS": " ".join(headers),
        "INPUT": "rows of a frame" if frames else "a list of stars",
        "INPUTS": "frames or lists of stars" if frames else "lists of stars",
        "MODES": "frames [VX VY VZ [EPOCH]] | stars | follow | version" if frames else "stars | follow | version",
        "CALLS": _CALLS[frames],
        "TESTS": " ".join(name for name in _TESTS if frames or f"{name}.c" not in _OF_FRAMES),
        "FUZZERS": " ".join(name for name in _FUZZERS if frames or f"{name}.c" not in _OF_FRAMES),
    }


def _filled(text: str, words: Mapping[str, str]) -> str:
    return re.sub(r"@([A-Z_]+)@", lambda match: words[match[1]], text)


def _licensed(name: str, text: str) -> str:
    return _LICENCE + text if name.endswith((".c", ".h")) else text
