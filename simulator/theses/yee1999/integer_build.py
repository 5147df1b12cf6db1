"""The flight build in integers, from centroids and with triads, compared with the program of the thesis: attitude,
memory, time and instructions (section 3.5, Table 4.20)."""

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
from simulator.study.exported_c.instructions import count_instructions
from simulator.study.exported_c.targets import M68K, Target, native_compiler
from simulator.study.flight.design import camera_design
from simulator.study.flight.program import ProgramAnswer, list_text, parse_answer
from simulator.theses.figures import figures
from simulator.theses.printed import Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import sub_catalog
from simulator.theses.yee1999.centroid_lists import centroid_list
from simulator.theses.yee1999.fixed_point.arithmetic import FixedArithmetic
from simulator.theses.yee1999.fixed_point.centroid import running_centroid
from simulator.theses.yee1999.fixed_point.formats import CENTROID
from simulator.theses.yee1999.fixed_point.tables import enclosed_table
from simulator.theses.yee1999.integers import fixed_centroids
from simulator.theses.yee1999.picture import VEGA_FOV_DEG, VEGA_SIZE_PX, Picture, vega
from startracker import StarTracker
from startracker._compiled import clock
from startracker.core import FloatArray
from startracker.estimation.plate import solve_plate
from startracker.flight.c_text import CExport
from startracker.flight.design import FlightDesign
from startracker.flight.export import flight_export
from startracker.flight.stars import StarList
from startracker.geometry.attitude import Attitude
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import match_triads
from startracker.settings import TriadSettings

FITTED_FOV_DEG = (9.238, 7.008)
"""Field of view that fits the centroids of the Vega image best, by a scan; the printed one is 2.5 % and 1.5 %
smaller."""
CENTROID_ERROR_PX = 0.3
"""Standard error of a centroid on one axis that the lists state."""
MAX_SEPARATION_DEG = 12.0
_DECLINATION_DEG = (30.0, 90.0)
_FIELDS, _STARS = 80, 7
_LIMITS = TriadLimits(three_stars=True)
_THRESHOLD_DN, _LEAST_PIXELS = 51, 10
"""Centroid error of a star in the Vega image."""
_CLOSE_DEG = 0.01
_ARCSEC = 206264.806


def picture_design(
    picture: Picture, fov_deg: tuple[float, float] | None = None, settings: TriadSettings | None = None
) -> FlightDesign:
    """Flight build for the camera of a picture, or for another field of view, with the stars of the thesis."""
    return camera_design(
        picture.size_px, fov_deg or picture.fov_deg, settings or TriadSettings(), declination_deg=_DECLINATION_DEG
    )


def pixels_of(xy_px: FloatArray, design: FlightDesign) -> FloatArray:
    """Image positions (N, 2), columns and rows, of centroids with x right and y up from the image's centre."""
    return np.array([design.camera.cx, design.camera.cy]) + xy_px * [1.0, -1.0]


def star_text(xy_px: FloatArray, design: FlightDesign) -> str:
    """Centroids, x right and y up from the centre and brightest first, as the exported program reads them."""
    count = len(xy_px)
    stars = StarList.of(pixels_of(xy_px, design), np.arange(count, 0, -1), np.full(count, CENTROID_ERROR_PX**2))
    return list_text(stars)


def answers_of(design: FlightDesign, texts: list[str]) -> list[ProgramAnswer]:
    """Answers of the compiled C; none without a compiler."""
    data = "".join(texts).encode()
    found = measured(flight_export(design), native_compiler(), lambda build: build.run(data, "stars").decode())
    return [parse_answer(line) for one in found for line in one["measured"].splitlines()]


@lru_cache(maxsize=1)
def attitude_differences() -> FloatArray:
    """Attitudes of the C in integers minus those of `StarTracker` in double precision, arcseconds (F, 3): distance of
    the boresights, difference of the rolls, and standard error of the boresight; of simulated fields of Vega's size.
    """
    design = picture_design(vega())
    guide = design.guide
    fields = [
        centroid_list(
            guide.directions, guide.v_mag, VEGA_FOV_DEG, VEGA_SIZE_PX, stream(1, "yee integers", k), max_stars=_STARS
        )
        for k in range(_FIELDS)
    ]
    tracker = StarTracker(design.camera, catalog=guide.catalog, magnitude_limit=6.0, identifier="triads")
    out = []
    answers = answers_of(design, [star_text(xy, design) for xy in fields])
    for xy, answer in zip(fields, answers, strict=bool(answers)):
        flux = np.arange(len(xy), 0, -1)
        solution = tracker.solve_centroids(pixels_of(xy, design), flux, sigma_px=CENTROID_ERROR_PX)
        if answer.attitude is not None and solution.attitude is not None and solution.covariance is not None:
            turn = _ARCSEC * _rotation(answer.attitude, solution.attitude)
            error = _ARCSEC * float(np.sqrt(np.trace(solution.covariance[:2, :2])))
            out.append([float(np.hypot(*turn[:2])), float(turn[2]), error])
    return np.array(out).reshape(-1, 3)


def _rotation(one: Attitude, other: Attitude) -> FloatArray:
    """Rotation vector (3,) of the small turn between two attitudes, camera axes."""
    m = one.as_matrix() @ other.as_matrix().T
    return 0.5 * np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])


def integer_build() -> Section:
    """Rows, and the figure of the attitudes' differences."""
    off = np.abs(attitude_differences())
    values = {"centroids": _centroid_differences(), "attitudes": _attitudes(off), "centre": _centre()}
    rows = [*fixed_centroids(), *table_rows("yee1999/integer_build", values | _run_time())]
    least, most = (max(off[off > 0].min(), 1e-3), off[:, :2].max()) if len(off) else (1e-3, 1.0)
    shown = {"centre": off[:, 0], "roll": off[:, 1], "edges": np.logspace(np.log10(least), np.log10(most), 25)}
    return Section("The integer build", rows, figures("yee1999/integer_build", shown))


def _attitudes(off: FloatArray) -> list[Values]:
    """Summary of the differences; empty without a compiler."""
    if not len(off):
        return []
    median, most = np.median(off, axis=0), off.max(axis=0)
    return [{"fields": len(off), "median_arcsec": median[0], "most_arcsec": most[0], "error_arcsec": median[2]}]


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
    """Centre of the Vega image at the field that fits it; empty without a compiler."""
    design = picture_design(vega(), FITTED_FOV_DEG)
    found = []
    for answer in answers_of(design, [star_text(vega().xy_px, design)]):
        if answer.attitude is not None:
            x, y, z = answer.attitude.as_matrix()[2]
            ra_deg, dec_deg = float(np.degrees(np.arctan2(y, x)) % 360.0), float(np.degrees(np.arcsin(z)))
            off = np.array([(ra_deg - 278.45703) * np.cos(np.radians(dec_deg)), dec_deg - 37.24007])
            off_px = float(np.hypot(*(off / vega().scale_deg)))
            found.append({"ra_deg": ra_deg, "dec_deg": dec_deg, "off_px": off_px, "near": off_px < 1.0})
    return found


def match_floating(
    picture: Picture, tables: TriadTables, limits: TriadLimits = TriadLimits(), *, centre: bool = True
) -> None:
    """The program of the thesis in floating point (or in integers, by tables), with or without the centre, for
    timing."""
    best = match_triads(tables, picture.xy_px, picture.scale_deg, limits).best()
    if centre and best is not None:
        solve_plate(picture.xy_px[best.pairs[:, 0]], sub_catalog(4).sky_deg[best.pairs[:, 1]])


def measured(export: CExport, target: Target | None, measure: Callable[[Build], Any]) -> list[Values]:
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
    picture, design = vega(), picture_design(vega())
    real, coded = (sub_catalog(4).tables(MAX_SEPARATION_DEG, kind) for kind in (None, FixedArithmetic()))
    floating_ms = best_ms(lambda: match_floating(picture, real, _LIMITS))
    fixed_ms = best_ms(lambda: match_floating(picture, coded, _LIMITS, centre=False))
    export, stars = flight_export(design), star_text(picture.xy_px, design).encode()
    return {
        "timed": [
            {"what": "floating point, with the centre", "hers": "0.398 s, 0.232 s", "ms": floating_ms, "how": "Python"},
            {"what": "fixed point", "hers": "0.243 s, 0.197 s (version A)", "ms": fixed_ms, "how": "Python"},
        ],
        "compiled": measured(export, native_compiler(), lambda build: 1e3 * build.time_s(stars, 200, "stars")),
        "emulated": measured(export, M68K, lambda build: count_instructions(build, stars, "stars").total),
    } | _memory(export)


def _memory(export: CExport) -> Values:
    """The database of enclosed angles planned in the thesis, and the tables used instead."""
    tables = sub_catalog(4).tables(MAX_SEPARATION_DEG)
    database = enclosed_table(tables.sky.vectors, tables.first, tables.second)
    sky = sub_catalog(4).tables(MAX_SEPARATION_DEG, FixedArithmetic()).sky
    computed = np.stack(FixedArithmetic().catalog_enclosed(sky, *database.stars.T), axis=1)
    off = np.abs(computed - database.angles)
    corners = tables.sky.vectors[database.stars]
    shortest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    pairs = sum(export.table_bytes[f"search_{name}"] for name in ("first", "second", "bin_start"))
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
