"""Timings as tables: the targets with their verdicts, how cost grows, and the ratios to other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import OK, SHORT, Table
from benchmarks.speed.workload import SIZES, STARS

NOTES = [
    "Times are those of the processor, one core, kernels compiled: the median of the rounds. Starting up, two cores",
    "and trials per second are by the clock. `python -m benchmarks.speed` (or `make bench`) writes this page; what",
    "each number is measured on stands in `benchmarks/speed/`.",
]
SIZED = ("render", "detect", "centroid", "trial")
UNSIZED = ("scene", "identify", "estimate", "track")
SAYS = {
    "scene": "orbit, pointing, apparent sky",
    "render": "focal plane and detector",
    "detect": "background and star candidates",
    "centroid": "centroids, maximum likelihood",
    "identify": "identification, lost in space",
    "estimate": "attitude from matched stars",
    "track": "tracking update from centroids",
    "trial": "whole trial, a row made",
}


class Timing(NamedTuple):
    """Rounds of one benchmark, ms, and what it adds."""

    rounds: np.ndarray[Any, np.dtype[np.float64]]
    extra: Mapping[str, float]
    group: str | None

    @property
    def ms(self) -> float:
        """Median."""
        return float(np.median(self.rounds))


def tables(benchmarks: Sequence[Mapping[str, Any]], processes: Mapping[str, float]) -> list[Table]:
    """Tables of what pytest-benchmark (its JSON's ``benchmarks``) and `processes.measure` found."""
    timings = {
        entry["name"].removeprefix("test_"): Timing(
            np.array(entry["stats"]["data"]) * 1e3, entry["extra_info"], entry["group"]
        )
        for entry in benchmarks
    }
    made = [_targets(timings, processes), _growth(timings), _peers(timings)]
    return [table for table in made if table[2]]


def _targets(timings: Mapping[str, Timing], processes: Mapping[str, float]) -> Table:
    rows: list[list[str]] = []

    def row(what: str, measured: float, limit: float, unit: str, least: bool = False) -> None:
        good = measured >= limit if least else measured <= limit
        rows.append(
            [what, f"{'≥' if least else '≤'} {limit:g} {unit}", f"{measured:.3g} {unit}", OK if good else SHORT]
        )

    def timed(what: str, name: str, limit: float, share: float = 1.0) -> None:
        if name in timings:
            row(what, timings[name].ms / share, limit, "ms")

    timed("frame of `cubesat_ideal.yaml`, 1024², all detector effects", "cubesat_frame", 6.0)
    timed("200 Gaussian stars, photon and read noise, 12 bits, 1024²", "plain_frame", 4.0)
    if {"draw_boresight", "draw_galsim"} <= timings.keys():
        row(
            "the same against GalSim, same stars and noise",
            timings["draw_galsim"].ms / timings["draw_boresight"].ms,
            25.0,
            "×",
            least=True,
        )
    timed("detection and centroids of a `cubesat_ideal.yaml` frame, 1024²", "detection_and_centroids", 1.5)
    for rate_deg_s, limit in (1, 10.0), (3, 15.0), (10, 25.0):
        timed(f"solve of a frame trailed at {rate_deg_s} deg/s, 1024², lost in space", f"trailed[{rate_deg_s}]", limit)
    if "small_trial" in timings:
        small = timings["small_trial"]
        each = small.ms / small.extra["trials"]
        row(f"whole trial, 512², lost in space, row kept ({small.extra['solved']:.1%} solved)", each, 3.0, "ms")
        row("trials per second and core", 1e3 / each, 300.0, "/s", least=True)
    timed("identification, lost in space, 10°, V ≤ 6: median", "identification", 0.3)
    if "identification" in timings:
        row("its 99th percentile", float(np.percentile(timings["identification"].rounds, 99)), 3.0, "ms")
    timed("solve from centroids, lost in space, 10°, V ≤ 6, 11 stars", "solve_centroids", 0.2)
    timed("the same for the cubesat's camera and an observer, 20 to 40 stars", "solve_centroids_observed", 0.2)
    for points, limit in ((8, 3.0), (15, 10.0), (40, 25.0), (100, 60.0)):
        timed(f"{points} random points, 10°, V ≤ 6.5: refused", f"no_sky[{points}]", limit)
    timed("tracking update from centroids", "tracking", 0.1)
    if "database" in timings:
        database = timings["database"]
        row("database for 10°, V ≤ 6: built and first used", database.ms / 1e3, 2.0, "s")
        row(f"its size ({database.extra['guide_stars']:.0f} guide stars)", database.extra["megabytes"], 2.0, "MB")
    for name, what, limit, unit in (
        ("import_s", "`import startracker`", 0.5, "s"),
        ("help_s", "`boresight --help`", 0.3, "s"),
        ("first_frame_s", "`boresight render cubesat`, a cold process", 5.0, "s"),
        ("run_megabytes", "memory of a process of a run", 400.0, "MB"),
        ("report_megabytes", "the same of a run of `cubesat_ideal.yaml` with its report", 400.0, "MB"),
    ):
        if name in processes:
            row(what, processes[name], limit, unit)
    if "two_cores" in processes:
        row("two processes against one, by the clock", processes["two_cores"], 1.8, "×", least=True)
    return "Targets", ["what", "target", "measured", "verdict"], rows


def _growth(timings: Mapping[str, Timing]) -> Table:
    def cell(name: str) -> str:
        return f"{timings[name].ms:.3g}" if name in timings else "–"

    rows = []
    for stage in (*UNSIZED[:1], *SIZED[:3], *UNSIZED[1:], *SIZED[3:]):
        if stage in SIZED:
            cells = [cell(f"{stage}[{stars}-{size}]") for size in SIZES for stars in STARS]
        else:
            cells = [cell(f"{stage}[{stars}]") for stars in STARS] + [""] * (len(STARS) * (len(SIZES) - 1))
        if any(text not in ("–", "") for text in cells):
            rows.append([SAYS[stage], *cells])
    columns = [f"{size}², {stars} stars" for size in SIZES for stars in STARS]
    return "How cost grows, ms (stages that see no pixels stand under 512²)", ["what", *columns], rows


def _peers(timings: Mapping[str, Timing]) -> Table:
    rows = []
    for group in dict.fromkeys(timing.group for timing in timings.values() if timing.group):
        inside = {name: timing for name, timing in timings.items() if timing.group == group}
        ours = next((timing.ms for name, timing in inside.items() if name.endswith("boresight")), None)
        for name, timing in inside.items():
            ratio = "–" if ours is None else f"{timing.ms / ours:.3g}"
            rows.append([group, name.rsplit("_", 1)[1], f"{timing.ms:.3g}", ratio])
    return "Other programs, side by side in one process", ["what", "program", "ms", "times ours"], rows
