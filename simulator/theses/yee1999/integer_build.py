"""The integer tracker compared with that of the thesis: attitude, memory, time and instructions (section 3.5, Table
4.20)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.exported_c.build import Build, compile_export
from simulator.study.exported_c.centroid_lists import centroid_list, list_text
from simulator.study.exported_c.instructions import count_instructions
from simulator.study.exported_c.targets import M68K, Target, native_compiler
from simulator.theses.figures import figures
from simulator.theses.printed import Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import sub_catalog
from simulator.theses.yee1999.integers import fixed_centroids
from simulator.theses.yee1999.picture import VEGA_FOV_DEG, VEGA_SIZE_PX, Picture, vega
from startracker._compiled import clock
from startracker.core import FloatArray
from startracker.estimation.plate import solve_plate
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.attitude import IntegerAttitude, NotSolved, plate_attitude
from startracker.fixed_point.centroid import running_centroid
from startracker.fixed_point.formats import CENTROID, Integers
from startracker.fixed_point.tables import enclosed_table
from startracker.flight.c_text import CExport
from startracker.geometry.attitude import radec_to_direction
from startracker.identification.integer_solution import (
    MAX_GROUPS,
    MAX_STARS,
    MAX_TRIADS,
    IntegerCamera,
    IntegerTracker,
    solve_integers,
)
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import match_triads
from startracker.integer_export import export_c

_FIELDS = 80
_SLENDER = 2e-3
"""Limit of det / trace² of the second moments: stars closer to a line have four constants in integers, six in floating
point."""
_LIMITS = TriadLimits(three_stars=True)
MAX_SEPARATION_DEG = 12.0
_THRESHOLD_DN, _LEAST_PIXELS = 51, 10
"""Centroid error of a star in the Vega image."""
_CLOSE_DEG = 0.01


def integer_tracker(picture: Picture) -> IntegerTracker:
    """The stars of the thesis' catalogue in integers, for the camera of a picture."""
    stars = sub_catalog(4)
    camera = IntegerCamera(picture.size_px, picture.fov_deg)
    return IntegerTracker.build(camera, stars.hr, stars.ra_deg, stars.dec_deg, stars.v_mag, MAX_SEPARATION_DEG)


@lru_cache(maxsize=1)
def _tracker() -> IntegerTracker:
    return integer_tracker(vega())


def _plate(xy_px: FloatArray) -> tuple[Integers, IntegerAttitude] | None:
    """Result of the thesis' method, the largest group with three stars, unverified: image and catalogue stars (M, 2),
    attitude."""
    tables = _tracker().tables
    image: Any = tables.arithmetic.image(xy_px, vega().scale_deg)
    best = match_triads(tables, image.xy, image.scale_deg, _LIMITS).best()
    if best is None:
        return None
    try:
        return best.pairs, plate_attitude(image.xy[best.pairs[:, 0]], tables.sky.directions[best.pairs[:, 1]])
    except NotSolved:
        return None


@lru_cache(maxsize=1)
def attitude_differences() -> FloatArray:
    """Integer minus floating-point plate constants of simulated Vega-sized fields (F, 2), arcseconds.

    The distance of the two centres and the difference of the two rolls, for the same matched stars, not collinear.
    """
    stars = sub_catalog(4)
    directions = radec_to_direction(*np.radians(stars.sky_deg).T)
    out = []
    for k in range(_FIELDS):
        xy = centroid_list(
            directions, stars.v_mag, VEGA_FOV_DEG, VEGA_SIZE_PX, stream(1, "yee integers", k), max_stars=7
        )
        found = _plate(xy)
        if found is None:
            continue
        (seen, catalog), attitude = found[0].T, found[1]
        least, most = np.linalg.eigvalsh(np.cov(xy[seen].T))
        if least * most < _SLENDER * (least + most) ** 2:
            continue
        plate = solve_plate(xy[seen], stars.sky_deg[catalog], 1e-9)
        ra_deg, dec_deg = attitude.ra / 2**22, attitude.dec / 2**22
        east = ((ra_deg - plate.center_deg[0] + 180.0) % 360.0 - 180.0) * np.cos(np.radians(dec_deg))
        m = plate.matrix
        # of the rotation closest to the map, as seen on the sky: x to the west
        roll = np.degrees(np.arctan2(m[1, 0] + m[0, 1], m[1, 1] - m[0, 0]))
        turn = (attitude.roll / 2**22 - roll + 180.0) % 360.0 - 180.0
        out.append([3600.0 * np.hypot(east, dec_deg - plate.center_deg[1]), 3600.0 * turn])
    return np.array(out)


def integer_build() -> Section:
    """Rows, and the figure of the attitudes' differences."""
    off = np.abs(attitude_differences())
    values = {
        "centroids": _centroid_differences(),
        "fields": len(off),
        "centre_arcsec": off[:, 0].max(),
        "roll_arcsec": off[:, 1].max(),
        "centre": _centre(),
    }
    rows = [*fixed_centroids(), *table_rows("yee1999/integer_build", values | _run_time())]
    least = max(off[off > 0].min(), 1e-5)
    shown = {"centre": off[:, 0], "roll": off[:, 1], "edges": np.logspace(np.log10(least), 0.0, 25)}
    return Section("The integer build", rows, figures("yee1999/integer_build", shown))


def _centroid_differences() -> Values:
    """Integer centroids of the thesis' method and exact sums, for the stars of a rendered picture."""
    image = Renderer(Scenario.load("xybion")).frame(0)[0].image.astype(np.int64)
    height, width = image.shape
    label, count = ndimage.label(image > _THRESHOLD_DN)
    off = []
    for star in range(1, count + 1):
        rows, columns = np.nonzero(label == star)
        if len(rows) < _LEAST_PIXELS:
            continue
        x, y, signal = columns - width // 2, height // 2 - rows, image[rows, columns]
        exact = np.array([(x * signal).sum(), (y * signal).sum()]) / signal.sum()
        off.append(np.abs(CENTROID.decode(running_centroid(x, y, signal)) - exact).max())
    return {"stars": len(off), "least_px": min(off), "most_px": max(off)}


def _centre() -> list[Values]:
    """Centre of the Vega image in integers; empty if it is not solved."""
    plate = _plate(vega().xy_px)
    if plate is None:
        return []
    ra_deg, dec_deg = plate[1].ra / 2**22, plate[1].dec / 2**22
    near = max(abs(ra_deg - 278.45703), abs(dec_deg - 37.24007)) <= 1.5e-5
    return [{"ra_deg": ra_deg, "dec_deg": dec_deg, "near": near}]


def match_floating(
    picture: Picture, tables: TriadTables, limits: TriadLimits = TriadLimits(), *, centre: bool = True
) -> None:
    """The program of the thesis in floating point (or in integers, by tables), with or without the centre, for
    timing."""
    best = match_triads(tables, picture.xy_px, picture.scale_deg, limits).best()
    if centre and best is not None:
        solve_plate(picture.xy_px[best.pairs[:, 0]], sub_catalog(4).sky_deg[best.pairs[:, 1]])


def measured(export: CExport, target: Target | None, measure: Callable[[Build], float]) -> list[Values]:
    """An export compiled for a target, and its measured value; None if its compiler is not installed."""
    if target is None or target.missing() is not None:
        return []
    with tempfile.TemporaryDirectory() as folder:
        build = compile_export(export, Path(folder), target)
        return [{"build": build, "measured": measure(build)} | _sizes(build)]


def _sizes(build: Build) -> Values:
    sizes = {"code_kb": build.code_bytes, "tables_kb": build.table_bytes, "context_kb": build.context_bytes}
    return {name: size / 1e3 for name, size in sizes.items()} | {"heap": ", ".join(build.heap_calls) or "0"}


def _run_time() -> Values:
    picture, tracker, how = vega(), _tracker(), "Python, with a verified attitude"
    real, stars = sub_catalog(4).tables(MAX_SEPARATION_DEG), list_text(picture.xy_px)
    floating_ms = best_ms(lambda: match_floating(picture, real, _LIMITS))
    fixed_ms = best_ms(lambda: solve_integers(tracker, picture.xy_px, _LIMITS))
    export = export_c(tracker, _LIMITS, MAX_STARS, MAX_TRIADS, MAX_GROUPS)
    return {
        "timed": [
            {"what": "floating point, with the centre", "hers": "0.398 s, 0.232 s", "ms": floating_ms, "how": "Python"},
            {"what": "fixed point", "hers": "0.243 s, 0.197 s (version A)", "ms": fixed_ms, "how": how},
        ],
        "compiled": measured(export, native_compiler(), lambda build: 1e3 * build.time_s(stars, 200)),
        "emulated": measured(export, M68K, lambda build: count_instructions(build, stars.encode()).total),
    } | _memory(export)


def _memory(export: CExport) -> Values:
    """The database of enclosed angles planned in the thesis, and the tables used instead."""
    tables = sub_catalog(4).tables(MAX_SEPARATION_DEG)
    database = enclosed_table(tables.sky.vectors, tables.first, tables.second)
    computed = np.stack(FixedArithmetic().catalog_enclosed(_tracker().tables.sky, *database.stars.T), axis=1)
    off = np.abs(computed - database.angles)
    corners = tables.sky.vectors[database.stars]
    shortest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    pairs = sum(export.table_bytes[name] for name in ("pair_separation", "pair_first", "pair_second"))
    return {
        "database_mb": database.bytes / 1e6,
        "angles": database.angles.size,
        "tables_kb": sum(export.table_bytes.values()) / 1e3,
        "pairs_kb": pairs / 1e3,
        "other_angles": np.count_nonzero(off),
        "largest": off[shortest > np.radians(_CLOSE_DEG)].max(),
        "close_deg": _CLOSE_DEG,
    }


def best_ms(function: Callable[[], object], times: int = 5) -> float:
    """Minimum time of several calls, milliseconds."""
    spent = []
    for _ in range(times):
        start = clock()
        function()
        spent.append(clock() - start)
    return 1e3 * min(spent)
