"""The integer tracker beside hers: attitude, memory, time and instructions (section 3.5, Table 4.20)."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.exported_c.build import M68K, Build, compile_export, native_compiler
from simulator.study.exported_c.centroid_lists import centroid_list, list_text
from simulator.study.style import BLUE, ORANGE
from simulator.theses.printed import Row, Section, new_figure
from simulator.theses.yee1999.catalogue import sub_catalog
from simulator.theses.yee1999.fixed_centroids import fixed_centroids
from simulator.theses.yee1999.picture import VEGA_FOV_DEG, VEGA_SIZE_PX, vega
from startracker.estimation.plate import solve_plate
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.attitude import NotSolved, PlateAttitude, plate_attitude
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
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import match_triads

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["attitude_differences", "difference_figure", "integer_build"]

FloatArray = NDArray[np.float64]

_FIELDS = 80
_SLENDER = 2e-3
"""Of second moments, det / trace²: stars nearer to a line have four constants in integers, six in floating point."""
_LIMITS = TriadLimits(three_stars=True)
_MAX_SEPARATION_DEG = 12.0
_THRESHOLD_DN, _LEAST_PIXELS = 51, 10
"""Of a star in the Vega image."""
_CLOSE_DEG = 0.01
_CLOCK_HZ = 25e6
"""Of her MC68EN360RC25C."""


@lru_cache(maxsize=1)
def _tracker() -> IntegerTracker:
    stars = sub_catalog(4)
    camera = IntegerCamera(VEGA_SIZE_PX, VEGA_FOV_DEG)
    return IntegerTracker.build(camera, stars.hr, stars.ra_deg, stars.dec_deg, stars.v_mag, _MAX_SEPARATION_DEG)


def _tables() -> TriadTables:
    return _tracker().tables


def _plate(xy_px: FloatArray) -> tuple[Integers, PlateAttitude] | None:
    """Her answer, the largest group that names three stars, unverified: image and catalogue stars (M, 2), attitude."""
    tables = _tables()
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
    rows = [*fixed_centroids(), _centroids(), *_attitude(), *_run_time()]
    return Section("The integer build", rows, {"integer_attitude": difference_figure})


def _centroids() -> Row:
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
    return Row(
        "Table 4.14",
        "fixed-point and floating-point centroids differ by",
        "0.00001 to 0.00004 px",
        f"{min(off):.6f} to {max(off):.6f} px",
        "input missing",
        f"{len(off)} stars of a rendered picture, whose pixels are not hers; running means of 10.22 with products of "
        "64 bits, where she had to split them into pieces of 32",
    )


def _attitude() -> list[Row]:
    off = attitude_differences()
    plate = _plate(vega().xy_px)
    rows = [
        Row(
            "3.5",
            "attitude in integers",
            "cannot be determined",
            f"centre within {off[:, 0].max():.3f}″ of floating point, roll within {np.abs(off[:, 1]).max():.3f}″",
            "differs",
            f"plate constants in 64-bit integers; {len(off)} simulated fields",
        )
    ]
    if plate is not None:
        found = plate[1]
        center = f"{found.ra / 2**22:.5f}°, {found.dec / 2**22:.5f}°"
        text = "278.45703°, 37.24007°"
        printed = [float(part.rstrip("°")) for part in text.split(", ")]
        near = max(abs(found.ra / 2**22 - printed[0]), abs(found.dec / 2**22 - printed[1])) <= 1.5e-5
        why = "hers in floating point; ours in integers, from centroids of 10.22"
        rows.append(Row("4.2.1", "centre of the Vega image", text, center, "close" if near else "differs", why))
    return rows


def _run_time() -> list[Row]:
    picture, tracker = vega(), _tracker()
    real = sub_catalog(4).tables(_MAX_SEPARATION_DEG)

    def floating() -> None:
        best = match_triads(real, picture.xy_px, picture.scale_deg, _LIMITS).best()
        if best is not None:
            solve_plate(picture.xy_px[best.pairs[:, 0]], sub_catalog(4).sky_deg[best.pairs[:, 1]])

    def fixed() -> None:
        solve_integers(tracker, picture.xy_px, _LIMITS)

    rows = [
        _timed("floating point, with the centre", "0.398 s, 0.232 s", _best_s(floating), "Python"),
        _timed(
            "fixed point",
            "0.243 s, 0.197 s (version A)",
            _best_s(fixed),
            "Python, with a verified attitude",
        ),
    ]
    export = export_c(tracker, _LIMITS, MAX_STARS, MAX_TRIADS, MAX_GROUPS)
    total = sum(export.table_bytes.values())
    with tempfile.TemporaryDirectory() as folder:
        rows += _memory(export, total)
        host = native_compiler()
        if host is not None:
            build = compile_export(export, Path(folder), host)
            spent = build.time_s(list_text(picture.xy_px), 200)
            rows.append(_timed("fixed point in C", "0.189 s, 0.145 s (version B)", spent, "with a verified attitude"))
            rows.append(_buffers(build))
        if M68K.missing() is None:
            build = compile_export(export, Path(folder), M68K)
            count = build.instructions(list_text(picture.xy_px))
            rows.append(
                Row(
                    "Table 4.20",
                    "fixed point in C on the 68k",
                    f"9.41 s: {9.41 * _CLOCK_HZ / 1e6:.0f} million clocks of 25 MHz",
                    f"{count:,} instructions",
                    "differs",
                    "CPU32, emulated; with the enclosed-angle test and a verified attitude; her version B has neither",
                )
            )
            rows.append(_buffers(build))
    return rows


def _timed(what: str, printed: str, spent_s: float, how: str) -> Row:
    why = f"{how}, on this machine, without reading the image; hers on a Pentium II of 266 MHz, with it"
    return Row("Table 4.20", what, printed, f"{spent_s * 1e3:.3g} ms", "differs", why)


def _memory(export: CExport, total: int) -> list[Row]:
    tables = sub_catalog(4).tables(_MAX_SEPARATION_DEG)
    database = enclosed_table(tables.sky.vectors, tables.first, tables.second)
    computed = np.stack(FixedArithmetic().catalog_enclosed(_tables().sky, *database.stars.T), axis=1)
    off = np.abs(computed - database.angles)
    corners = tables.sky.vectors[database.stars]
    shortest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    largest = int(off[shortest > np.radians(_CLOSE_DEG)].max())
    count = f"{database.angles.size:,} enclosed angles, rows of six 16-bit words"
    pairs = sum(export.table_bytes[name] for name in ("pair_separation", "pair_first", "pair_second"))
    return [
        Row("4.2.5", "database of enclosed angles", "about 5 MB", f"{database.bytes / 1e6:.1f} MB", "close", count),
        Row(
            "4.2.5",
            "databases in memory",
            "16 MB would suffice",
            f"{total / 1e3:.0f} kB of tables, {pairs / 1e3:.0f} of them pairs",
            "differs",
            "enclosed angles are computed in 64 bits when they are needed: "
            f"{np.count_nonzero(off)} of {database.angles.size:,} differ from the database, by {largest} in the last "
            f"bit at most unless two stars are within {_CLOSE_DEG}°",
        ),
    ]


def _buffers(build: Build) -> Row:
    sizes = f"code {build.code_bytes / 1e3:.1f} kB, context {build.context_bytes / 1e3:.0f} kB"
    heap = "heap 0" if not build.heap_calls else "heap " + ", ".join(build.heap_calls)
    computed = f"{sizes}, stack ≤ {build.stack_bytes} B, {heap}"
    why = "12 stars, 4,096 triads; the largest lists of pairs that these tables can give"
    return Row("4.2.5", f"memory, {build.target.name}", "4 MB do not suffice for 12 stars", computed, "differs", why)


def _best_s(function: Callable[[], None]) -> float:
    spent = []
    for _ in range(5):
        start = time.perf_counter()
        function()
        spent.append(time.perf_counter() - start)
    return min(spent)


def difference_figure() -> Figure:
    """How far the integer attitude is from the floating-point one."""
    off = np.abs(attitude_differences())
    figure, axes = new_figure()
    edges = np.logspace(np.log10(max(off[off > 0].min(), 1e-5)), 0.0, 25)
    axes.hist(off[:, 0], edges, color=BLUE, alpha=0.75, label="centre")
    axes.hist(off[:, 1], edges, histtype="step", color=ORANGE, lw=1.6, ls="--", label="roll")
    axes.set_xscale("log")
    axes.set_xlabel("integers minus floating point [″]")
    axes.set_ylabel("fields")
    axes.legend(loc="upper right")
    return figure
