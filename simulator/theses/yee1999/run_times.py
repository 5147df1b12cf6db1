"""Run times: Tables 4.21 and C.1 to C.6, and her version B on an emulated 68k.

Version B is the fixed-point program without the test of enclosed angles and with room for as many stars as the image
has. Hers finds the stars in the image as well and has no attitude; ours begins with the centroids and ends with the
attitude of the largest group, verified. Both images have the same size, so that the difference of their times leaves
the search for stars in the image out.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from simulator.study.exported_c.build import M68K, Build, compile_export, native_compiler
from simulator.study.exported_c.centroid_lists import list_text
from simulator.theses.printed import Row, Section
from simulator.theses.yee1999.catalogue import printed_rows, sub_catalog
from simulator.theses.yee1999.picture import Picture, deneb, vega
from simulator.theses.yee1999.rows import joined
from startracker.estimation.plate import solve_plate
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.export_c import CExport, export_c
from startracker.identification.integer_solution import MAX_TRIADS, IntegerCamera, IntegerTracker
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import match_triads

__all__ = ["deneb", "run_times", "version_b"]

_MAX_SEPARATION_DEG = 12.0
_A, _B = TriadLimits(), TriadLimits(enclosed_tolerance_deg=None)
_CLOCKS = 25e6
"""A second, of her MC68EN360RC25C."""
_REPETITIONS = 100
_NAMES = {
    "floating, centre": "floating point, with the centre",
    "floating": "floating point, without the centre",
    "A": "fixed point, version A",
    "B": "fixed point, version B",
}
_WHERE = {
    "C.1": "Vega, Visual C++ 4.0",
    "C.2": "Vega, Visual C++ 5.0",
    "C.3": "Vega, MC68360",
    "C.4": "Deneb, Visual C++ 4.0",
    "C.5": "Deneb, Visual C++ 5.0",
    "C.6": "Deneb, MC68360",
}


def version_b(picture: Picture) -> CExport:
    """Her version B of one image in C: room for its stars alone, the largest group alone."""
    stars = sub_catalog(4)
    camera = IntegerCamera(picture.size_px, picture.fov_deg)
    tracker = IntegerTracker.build(camera, stars.hr, stars.ra_deg, stars.dec_deg, stars.v_mag, _MAX_SEPARATION_DEG)
    return export_c(tracker, _B, len(picture.xy_px), MAX_TRIADS, 1)


def run_times() -> Section:
    """Rows of all tables."""
    return Section("Run times", [*_trials(), *_here(), *_emulated()])


def _trials() -> list[Row]:
    """Her averages and run times out of her ten trials."""
    rows = []
    for row in printed_rows("tables_c"):
        trials = [float(row[f"trial_{n}"]) for n in range(1, 11)]
        mean = float(np.mean(trials))
        rows.append(
            joined(
                f"Table {row['table']}",
                f"{_WHERE[row['table']]}: {_NAMES[row['version']]}, average and run-time",
                [row["average"], row["run_time"]],
                [mean, mean / _REPETITIONS],
                unit="s",
                why="from the ten trials printed, of 100 runs each",
            )
        )
    return rows


def _here() -> list[Row]:
    """Table 4.21 on this machine: the Pentium II and its compilers are not to be had."""
    picture, stars = deneb(), sub_catalog(4)
    real = stars.tables(_MAX_SEPARATION_DEG)
    coded = stars.tables(_MAX_SEPARATION_DEG, FixedArithmetic())

    def match(tables: TriadTables, centre: bool) -> Callable[[], None]:
        def solve() -> None:
            best = match_triads(tables, picture.xy_px, picture.scale_deg, _A).best()
            if centre and best is not None:
                solve_plate(picture.xy_px[best.pairs[:, 0]], stars.sky_deg[best.pairs[:, 1]])

        return solve

    export = version_b(picture)
    rows = [
        _timed("floating, centre", "2.317 s, 0.644 s", _best_s(match(real, True)), "Python"),
        _timed("floating", "2.286 s, 0.596 s", _best_s(match(real, False)), "Python"),
        _timed("A", "1.430 s, 0.622 s", _best_s(match(coded, False)), "Python"),
    ]
    host = native_compiler()
    if host is None:
        return [*rows, _not_measured("Table 4.21", "B", "n/a, 0.464 s", "no C compiler is installed")]
    with tempfile.TemporaryDirectory() as folder:
        build = compile_export(export, Path(folder), host)
        spent = build.time_s(list_text(picture.xy_px), 20)
    return [*rows, _timed("B", "n/a, 0.464 s", spent, "C, with a verified attitude")]


def _timed(version: str, printed: str, spent_s: float, how: str) -> Row:
    why = f"{how}, on this machine, without reading the image; hers on a Pentium II of 266 MHz, with it"
    return Row("Table 4.21", f"Deneb: {_NAMES[version]}", printed, f"{spent_s * 1e3:.3g} ms", "input missing", why)


def _not_measured(where: str, version: str, printed: str, why: str) -> Row:
    return Row(where, f"Deneb: {_NAMES[version]}", printed, "not measured", "input missing", why)


def _emulated() -> list[Row]:
    """Tables C.3 and C.6 in instructions of the emulated 68k."""
    names, printed = ("Vega", "Deneb"), (9.41, 23.66)
    quantity = [f"{name} on the 68k: {_NAMES['B']}" for name in names]
    clocks = [f"{seconds} s: {seconds * _CLOCKS / 1e6:.0f} million clocks" for seconds in printed]
    between = f"{(printed[1] - printed[0]) * _CLOCKS / 1e6:.0f} million clocks"
    missing = M68K.missing()
    if missing is not None:
        why = f"{missing} is not installed (Debian: gcc-m68k-linux-gnu, qemu-user)"
        return [
            Row(where, what, text, "not measured", "input missing", why)
            for where, what, text in (
                ("Table C.3", quantity[0], clocks[0]),
                ("Table C.6", quantity[1], clocks[1]),
                ("Tables C.3, C.6", "Deneb less Vega", between),
            )
        ]
    counts, builds = [], []
    for picture in (vega(), deneb()):
        with tempfile.TemporaryDirectory() as folder:
            build = compile_export(version_b(picture), Path(folder), M68K)
            builds.append(build)
            counts.append(build.instructions(list_text(picture.xy_px)))
    why = (
        "instructions of a CPU32, emulated, from the centroids to a verified attitude; hers from the image to the names"
    )
    rows = [
        Row(where, what, text, f"{count / 1e6:.2f} million instructions", "differs", why)
        for where, what, text, count in zip(("Table C.3", "Table C.6"), quantity, clocks, counts, strict=True)
    ]
    step = f"{(counts[1] - counts[0]) / 1e6:.2f} million instructions"
    why = "84 triangles in place of 10; neither counts the search for stars in the image, which is the same in both"
    rows.append(Row("Tables C.3, C.6", "Deneb less Vega", between, step, "differs", why))
    return [*rows, *(_sizes(name, build) for name, build in zip(names, builds, strict=True))]


def _sizes(name: str, build: Build) -> Row:
    computed = (
        f"code {build.code_bytes / 1e3:.1f} kB, tables {build.table_bytes / 1e3:.0f} kB, "
        f"context {build.context_bytes / 1e3:.0f} kB, stack ≤ {build.stack_bytes} B, heap 0"
    )
    why = "her lists of pairs are as long as the catalogue for each pair of stars; ours are ranges of one table"
    printed = "4 MB, its stars renumbered" if name == "Deneb" else "4 MB"
    return Row("4.2.5", f"{name}, memory of version B on the 68k", printed, computed, "differs", why)


def _best_s(function: Callable[[], None]) -> float:
    spent = []
    for _ in range(3):
        start = time.perf_counter()
        function()
        spent.append(time.perf_counter() - start)
    return min(spent)
