"""Stress test of the exported C: simulated fields with disturbances, and lists that are not a sky.

python -m benchmarks.integer_tracker [--camera vega|wide|narrow|pleiades] [--n 12500] [--seed 1]

Ten kinds of fields and eight of lists, `n` of each. For each kind one line gives the numbers solved and wrong, the
largest errors and the strongest evidence that was rejected (fields) or found (lists). Exit status 1 if any is wrong.

A solution is wrong if the corners of the image differ by more than WRONG_PX between its attitude and the true one, or
if a named star is further from its point than that (plus the τ of 8 px for unresolved groups).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.integer_lists import PATTERNS, Answer, Camera, Pattern, errors_px, pattern_list, scene
from simulator.randomness import stream
from simulator.study.exported_c.build import Build, compile_export
from simulator.study.exported_c.centroid_lists import list_text
from simulator.theses.yee1999.catalogue import sub_catalog
from startracker.identification.integer_solution import (
    MAX_GROUPS,
    MAX_STARS,
    MAX_TRIADS,
    IntegerCamera,
    IntegerTracker,
)
from startracker.identification.triad_search import TriadLimits
from startracker.integer_export import export_c

WRONG_PX = 4.0
"""Noise of 0.5 px, extrapolated from few stars to the corners, displaces these by at most 2.1 px in 10⁵ fields."""
COMBINED_PX = 8.0
_CHUNK = 2_000
_NORTH, _OUTSIDE, _BORDER = (31.0, 90.0), (-90.0, 24.0), (24.0, 31.0)


@dataclass(frozen=True)
class Case:
    """A camera and its export parameters: magnitude limit, maximum separation, minimum declination, tolerance."""

    camera: Camera
    faintest: float
    longest_deg: float
    lowest_deg: float = 30.0
    tolerance_deg: float = 0.15


CAMERAS = {
    "vega": Case(Camera((9.0130, 6.9049), (427, 319)), 6.0, 12.0),
    "wide": Case(Camera((20.0, 15.0), (640, 480)), 4.8, 26.0),
    "narrow": Case(Camera((7.0, 7.0), (1000, 1000)), 6.5, 10.0),
    "pleiades": Case(Camera((15.0, 15.0), (1020, 1020)), 6.5, 21.0, -90.0, 0.02),
}


@dataclass(frozen=True)
class Kind:
    """Fields: boresights between two declinations, maximum number of false stars (at least one, or 0), missing
    fraction, noise.

    Scaled horizontally and vertically: mirrored, or of another focal length; none of these may be solved.
    """

    declination_deg: tuple[float, float]
    most_false: int = 0
    missing: float = 0.0
    noise_px: float = 0.1
    stretch: tuple[float, float] = (1.0, 1.0)


FIELDS = {
    "perfect": Kind(_NORTH),
    "noise": Kind(_NORTH, noise_px=0.5),
    "false stars": Kind(_NORTH, 5, noise_px=0.3),
    "missing stars": Kind(_NORTH, 0, 0.3, 0.2),
    "everything": Kind(_NORTH, 5, 0.2, 0.5),
    "outside": Kind(_OUTSIDE),
    "outside, false stars": Kind(_OUTSIDE, 5, noise_px=0.3),
    "border": Kind(_BORDER, 5, noise_px=0.3),
    "mirrored": Kind(_NORTH, stretch=(-1.0, 1.0)),
    "8 % smaller": Kind(_NORTH, stretch=(0.92, 0.92)),
}


@dataclass(frozen=True, eq=False)
class Target:
    """A compiled export, and the whole sky: brightest first."""

    build: Build
    camera: Camera
    star_id: NDArray[np.int64]
    directions: NDArray[np.float64]
    v_mag: NDArray[np.float64]


@dataclass(frozen=True)
class Result:
    """Result of `lists`: numbers solved and wrong, largest error of a corner, strongest rejected evidence."""

    lists: int
    solved: int
    wrong: int
    corner_px: float
    strongest: float


def make_target(name: str, folder: Path) -> Target:
    """One of `CAMERAS`, exported and compiled in `folder`."""
    case = CAMERAS[name]
    camera, limits = case.camera, TriadLimits(case.tolerance_deg, three_stars=True)
    stars, every = (sub_catalog(5, case.faintest, lowest, 90.0) for lowest in (case.lowest_deg, -90.0))
    tracker = IntegerTracker.build(
        IntegerCamera(camera.size_px, camera.fov_deg),
        stars.hr,
        stars.ra_deg,
        stars.dec_deg,
        stars.v_mag,
        case.longest_deg,
    )
    export = export_c(tracker, limits, MAX_STARS, MAX_TRIADS, MAX_GROUPS)
    ra, dec = np.radians(every.sky_deg).T
    directions = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    order = np.argsort(every.v_mag, kind="stable")
    return Target(compile_export(export, folder), camera, every.hr[order], directions[order], every.v_mag[order])


def attack_fields(target: Target, kind: str, count: int, seed: int) -> Result:
    """Solve fields of one kind."""
    what, solved, wrong, corner, refused = FIELDS[kind], 0, 0, 0.0, -np.inf
    rng = stream(seed, "fields", list(FIELDS).index(kind))
    for begin in range(0, count, _CHUNK):
        truths = [
            scene(
                target.directions,
                target.v_mag,
                target.camera,
                rng,
                what.declination_deg,
                int(rng.integers(1, what.most_false + 1)) if what.most_false else 0,
                what.missing,
                what.noise_px,
                max_stars=20,
            )
            for _ in range(min(_CHUNK, count - begin))
        ]
        lines = target.build.solve("".join(list_text(truth.xy * what.stretch) for truth in truths))
        for truth, answer in zip(truths, map(Answer.of_line, lines), strict=True):
            if answer.status != "solved":
                refused = max(refused, answer.evidence)
                continue
            off = errors_px(answer, truth, target.camera, target.star_id, target.directions)
            solved += 1
            corner = max(corner, float(off[0]))
            wrong += what.stretch != (1.0, 1.0) or bool((off > WRONG_PX + np.array([0.0, 0.0, COMBINED_PX])).any())
    return Result(count, solved, wrong, corner, refused)


def attack_patterns(target: Target, pattern: Pattern, count: int, seed: int) -> Result:
    """Solve lists of 4 to 24 points that are not a sky; every solution is wrong."""
    solved, strongest = 0, -np.inf
    rng = stream(seed, "patterns", PATTERNS.index(pattern))
    for begin in range(0, count, _CHUNK):
        lists = [
            pattern_list(pattern, target.camera, rng, int(rng.integers(4, 25)))
            for _ in range(min(_CHUNK, count - begin))
        ]
        for answer in map(Answer.of_line, target.build.solve("".join(map(list_text, lists)))):
            solved += answer.status == "solved"
            strongest = max(strongest, answer.evidence)
    return Result(count, solved, solved, 0.0, strongest)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all kinds; returns 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--camera", choices=CAMERAS, default="vega")
    parser.add_argument("--n", type=int, default=12_500, help="lists of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        target = make_target(options.camera, Path(folder))
        print("kind                   lists   solved  wrong  corner px  log2 B  seconds")
        for kind in (*FIELDS, *PATTERNS):
            start = time.perf_counter()
            if kind in FIELDS:
                result = attack_fields(target, kind, options.n, options.seed)
            else:
                result = attack_patterns(target, kind, options.n, options.seed)  # type: ignore[arg-type]  # a Pattern
            wrong += result.wrong
            print(
                f"{kind:20} {result.lists:7} {result.solved:8} {result.wrong:6} {result.corner_px:10.2f} "
                f"{result.strongest:7.1f} {time.perf_counter() - start:8.0f}",
                flush=True,
            )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
