"""The integer tracker beside hers: attitude, memory, time and instructions (section 3.5, Table 4.20)."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from scipy import ndimage

from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.exported_c.build import M68K, Build, compile_export, native_compiler
from simulator.study.exported_c.centroid_lists import centroid_list, list_text
from simulator.theses.figures import figures
from simulator.theses.printed import Section
from simulator.theses.tables import FloatArray, Values, table_rows
from simulator.theses.yee1999.catalogue import sub_catalog
from simulator.theses.yee1999.fixed_centroids import fixed_centroids
from simulator.theses.yee1999.picture import VEGA_FOV_DEG, VEGA_SIZE_PX, vega
from startracker.estimation.plate import solve_plate
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.attitude import IntegerAttitude, NotSolved, plate_attitude
from startracker.fixed_point.centroid import running_centroid
from startracker.fixed_point.export_c import CExport, export_c
from startracker.fixed_point.formats import CENTROID, Integers
from startracker.fixed_point.tables import enclosed_table
from startracker.identification.integer_solution import (
    MAX_GROUPS,
    MAX_STARS,
    MAX_TRIADS,
    IntegerCamera,
    IntegerTracker,
    solve_integers,
)
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_votes import match_triads

_FIELDS = 80
_SLENDER = 2e-3
"""Of second moments, det / trace²: stars nearer to a line have four constants in integers, six in floating point."""
_LIMITS = TriadLimits(three_stars=True)
_MAX_SEPARATION_DEG = 12.0
_THRESHOLD_DN, _LEAST_PIXELS = 51, 10
"""Of a star in the Vega image."""
_CLOSE_DEG = 0.01


@lru_cache(maxsize=1)
def _tracker() -> IntegerTracker:
    stars = sub_catalog(4)
    camera = IntegerCamera(VEGA_SIZE_PX, VEGA_FOV_DEG)
    return IntegerTracker.build(camera, stars.hr, stars.ra_deg, stars.dec_deg, stars.v_mag, _MAX_SEPARATION_DEG)


def _plate(xy_px: FloatArray) -> tuple[Integers, IntegerAttitude] | None:
    """Her answer, the largest group that names three stars, unverified: image and catalogue stars (M, 2), attitude."""
    tables = _tracker().tables
    image = tables.arithmetic.image(xy_px, vega().scale_deg)
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

    The distance of the two centres and the difference of the two rolls, of the same matched stars, not in a line.
    """
    stars = sub_catalog(4)
    ra, dec = np.radians(stars.sky_deg).T
    directions = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
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
        # of the rotation nearest to the map, as seen in the sky: x to the west
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
    return Section("The integer build", rows, figures("yee1999/integer_build", {"integer_attitude": lambda: shown}))


def _centroid_differences() -> Values:
    """Her integer centroids beside the sums, of the stars of a rendered picture."""
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
    """Centre of the Vega image in integers; empty where it is not solved."""
    plate = _plate(vega().xy_px)
    if plate is None:
        return []
    ra_deg, dec_deg = plate[1].ra / 2**22, plate[1].dec / 2**22
    near = max(abs(ra_deg - 278.45703), abs(dec_deg - 37.24007)) <= 1.5e-5
    return [{"ra_deg": ra_deg, "dec_deg": dec_deg, "near": near}]


def _run_time() -> Values:
    picture, tracker = vega(), _tracker()
    real = sub_catalog(4).tables(_MAX_SEPARATION_DEG)

    def floating() -> None:
        best = match_triads(real, picture.xy_px, picture.scale_deg, _LIMITS).best()
        if best is not None:
            solve_plate(picture.xy_px[best.pairs[:, 0]], sub_catalog(4).sky_deg[best.pairs[:, 1]])

    timed = [
        {"what": what, "hers": hers, "ms": 1e3 * best_s(solve), "how": how}
        for what, hers, solve, how in (
            ("floating point, with the centre", "0.398 s, 0.232 s", floating, "Python"),
            (
                "fixed point", "0.243 s, 0.197 s (version A)",
                partial(solve_integers, tracker, picture.xy_px, _LIMITS), "Python, with a verified attitude",
            ),
        )
    ]  # fmt: skip
    export = export_c(tracker, _LIMITS, MAX_STARS, MAX_TRIADS, MAX_GROUPS)
    compiled, emulated, stars = [], [], list_text(picture.xy_px)
    with tempfile.TemporaryDirectory() as folder:
        host = native_compiler()
        if host is not None:
            build = compile_export(export, Path(folder), host)
            compiled.append({"build": build, "ms": 1e3 * build.time_s(stars, 200), "buffers": _buffers(build)})
        if M68K.missing() is None:
            build = compile_export(export, Path(folder), M68K)
            count = build.instructions(stars)
            emulated.append({"build": build, "instructions": count, "buffers": _buffers(build)})
    return {"timed": timed, "compiled": compiled, "emulated": emulated} | _memory(export)


def _memory(export: CExport) -> Values:
    """The database of enclosed angles that she foresees, and the tables that stand in for it."""
    tables = sub_catalog(4).tables(_MAX_SEPARATION_DEG)
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


def _buffers(build: Build) -> str:
    sizes = f"code {build.code_bytes / 1e3:.1f} kB, context {build.context_bytes / 1e3:.0f} kB"
    heap = "heap 0" if not build.heap_calls else "heap " + ", ".join(build.heap_calls)
    return f"{sizes}, stack ≤ {build.stack_bytes} B, {heap}"


def best_s(function: Callable[[], object], times: int = 5) -> float:
    """Least time of a call among several, seconds."""
    spent = []
    for _ in range(times):
        start = time.perf_counter()
        function()
        spent.append(time.perf_counter() - start)
    return min(spent)
