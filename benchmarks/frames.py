"""End-to-end benchmark: frames are rendered, detected, identified and solved, lost in space.

    python -m benchmarks.frames [--case WORD ...] [--identifier NAME] [--n 200] [--workers 1] [--out FILE.md]

The camera is that of ``scenarios/cubesat_ideal.yaml``; attitudes are uniformly random over the sky, and the tracker has
no prior. Body rates are perpendicular to the boresight, where the trails are longest.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import chosen
from benchmarks.oracle import rotation_error
from benchmarks.report import OK, SHORT, Table, show, write_markdown
from benchmarks.score import ENOUGH, IDENTIFIED, RAISED, WRONG, WRONG_CROSS_PX, WRONG_ROLL_DEG
from simulator.frame import Frame, FrameTruth
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.sky.ephemeris import observe
from simulator.sky.instants import solar_system
from simulator.study.star_tracker import build_tracker
from simulator.study.statistics import wilson_interval
from simulator.study.trials.trial import solve_frame
from startracker.geometry.attitude import Attitude
from startracker.tracker import StarTracker

FloatArray = NDArray[np.float64]

CUBESAT = Path(__file__).resolve().parent.parent / "scenarios" / "cubesat_ideal.yaml"
SEED = 4
COSMIC_RAYS = 15
DAY_S = 86_400.0
LEAST_ELONGATION_DEG = 30.0
"""Closer to the Sun no camera can be used."""
_ACROSS = math.sqrt(0.5)
_CHUNK = 10
_WARM_UP = 1_000_000  # a frame that no run reaches


@dataclass(frozen=True)
class FrameCase:
    """One row.

    Parameters
    ----------
    name : str
        Also the key of the random streams.
    target : float, optional
        Minimum fraction to be identified.
    rate_deg_s : float
        Body rate perpendicular to the boresight.
    exposure_s : float, optional
        Replaces that of the scenario.
    cosmic_rays : float
        Mean number of cosmic rays that cross the detector in an exposure.
    bodies : tuple of str
        Bodies on the image: their midpoint is at a random position, or on the border with `edge`.
    days : (float, float)
        Range of times of such frames after the scenario's epoch.
    """

    name: str
    target: float | None = 0.99
    rate_deg_s: float = 0.0
    exposure_s: float | None = None
    cosmic_rays: float = 0.0
    bodies: tuple[str, ...] = ()
    edge: bool = False
    days: tuple[float, float] = (0.0, 365.0)

    def scenario(self, identifier: str) -> Scenario:
        """The cubesat scenario, modified for this case."""
        across = _ACROSS * self.rate_deg_s  # the boresight is the body's Y axis
        overrides = [
            "study.sampling=sky",
            "tracker.prior=false",
            f"tracker.identifier={identifier}",
            f"pointing.rate_deg_s=[{across}, 0, {across}]",
        ]
        if self.exposure_s is not None:
            overrides.append(f"detector.exposure_s={self.exposure_s}")
        if self.cosmic_rays:
            detector = Scenario.load(CUBESAT).detector
            pitch_x, pitch_y = detector.pitch_um
            area_cm2 = detector.width * pitch_x * detector.height * pitch_y * 1e-8
            rate = self.cosmic_rays / (area_cm2 * (self.exposure_s or detector.exposure_s))
            overrides.append(f"detector.cosmic_rays.rate_cm2_s={rate}")
        return Scenario.load(CUBESAT, overrides, seed=SEED)


_ALL = (
    FrameCase("0 deg/s"),
    FrameCase("1 deg/s", rate_deg_s=1.0),
    FrameCase("3 deg/s", rate_deg_s=3.0),
    FrameCase("10 deg/s", target=0.90, rate_deg_s=10.0),
    FrameCase("10 deg/s, 0.05 s", target=None, rate_deg_s=10.0, exposure_s=0.05),
    FrameCase("Moon at the edge", bodies=("Moon",), edge=True),
    FrameCase("Jupiter in the field", bodies=("Jupiter",)),
    FrameCase("Venus in the field", bodies=("Venus",)),
    # the conjunction of 2026-06-09
    FrameCase("Jupiter and Venus in the field", bodies=("Jupiter", "Venus"), days=(78.0, 82.0)),
    FrameCase(f"{COSMIC_RAYS} cosmic rays", cosmic_rays=COSMIC_RAYS),
)
CASES = {case.name: case for case in _ALL}


@dataclass(frozen=True)
class FrameRow:
    """Outcome of one frame."""

    index: int
    outcome: str
    true_stars: int
    cross_arcsec: float
    roll_arcsec: float
    solve_ms: float


class Bench:
    """Renders and solves the frames of one case."""

    def __init__(self, case: FrameCase, identifier: str) -> None:
        self.case = case
        self.renderer = Renderer(case.scenario(identifier))
        self.tracker: StarTracker = build_tracker(self.renderer.scenario, self.renderer.camera)
        solve_frame(self.tracker, self.renderer.frame(_WARM_UP)[0])

    def frame(self, index: int) -> tuple[Frame, FrameTruth]:
        """Render frame `index`."""
        at_s, attitude = self._placed(index) if self.case.bodies else (None, None)
        return self.renderer.frame(index, at_s=at_s, attitude=attitude)

    def row(self, index: int) -> FrameRow:
        """Render, solve and score frame `index`."""
        frame, truth = self.frame(index)
        start = time.process_time()
        try:
            solution = solve_frame(self.tracker, frame)
        except Exception:  # counted as such
            return FrameRow(index, RAISED, 0, math.nan, math.nan, math.nan)
        solve_ms = 1e3 * (time.process_time() - start)
        seen = truth.sources
        bright = (seen.kind == "star") & (seen.v_mag <= self.renderer.scenario.tracker.magnitude_limit)
        stars = int(np.count_nonzero(bright & frame.camera.contains(seen.xy)))
        if solution.attitude is None:
            return FrameRow(index, str(solution.status), stars, math.nan, math.nan, solve_ms)
        error = rotation_error(truth.attitude.as_matrix(), solution.attitude.as_matrix())
        cross, roll = math.hypot(error[0], error[1]), abs(float(error[2]))
        right = cross <= WRONG_CROSS_PX * frame.camera.pixel_rad and roll <= math.radians(WRONG_ROLL_DEG)
        arcsec = 3600.0 * math.degrees(1.0)
        return FrameRow(index, IDENTIFIED if right else WRONG, stars, arcsec * cross, arcsec * roll, solve_ms)

    def _placed(self, index: int) -> tuple[float, Attitude]:
        """A time, and an attitude with random roll that puts the midpoint of the bodies where the case requires it."""
        case, camera = self.case, self.renderer.camera
        rng = stream(SEED, f"benchmark frames {case.name}", index)
        while True:
            at_s = DAY_S * float(rng.uniform(*case.days))
            *directions, sun = self._directions([*case.bodies, "Sun"], at_s)
            middle = np.sum(directions, axis=0)
            middle /= np.linalg.norm(middle)
            if float(middle @ sun) < math.cos(math.radians(LEAST_ELONGATION_DEG)):
                break
        centre = rng.uniform([-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5])
        if case.edge:
            side = int(rng.integers(4))
            centre[side % 2] = -0.5 if side < 2 else (camera.width, camera.height)[side % 2] - 0.5
        in_camera, in_sky = _triad(camera.unproject(centre)[0], rng), _triad(middle, rng)
        return at_s, Attitude.from_matrix(in_camera @ in_sky.T)

    def _directions(self, names: list[str], at_s: float) -> list[FloatArray]:
        scenes = self.renderer.scenes
        observer = observe(scenes.clock, at_s, *scenes.orbit.state(at_s))
        bodies = solar_system(scenes.clock, at_s, observer, self.renderer.scenario.sky)
        return [bodies.direction[bodies.name.tolist().index(name)] for name in names]


def _triad(axis: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Rotation matrix (3, 3) with `axis` as its last column and a random rotation about it."""
    first = np.cross(axis, rng.standard_normal(3))
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


@lru_cache(maxsize=1)
def _bench(case: FrameCase, identifier: str) -> Bench:
    return Bench(case, identifier)


def run_chunk(case: FrameCase, identifier: str, indices: range) -> list[FrameRow]:
    """Rows of some frames."""
    bench = _bench(case, identifier)
    return [bench.row(index) for index in indices]


def run_case(case: FrameCase, identifier: str, n: int, pool: ProcessPoolExecutor | None) -> list[FrameRow]:
    """Rows of the frames 0 to n − 1."""
    chunks = [range(k, min(k + _CHUNK, n)) for k in range(0, n, _CHUNK)]
    work = partial(run_chunk, case, identifier)
    done: Iterable[list[FrameRow]] = map(work, chunks) if pool is None else pool.map(work, chunks)
    return [row for rows in done for row in rows]


COLUMNS = [
    "case",
    "n",
    "identified %",
    "95 %",
    "wrong",
    "not identified",
    f"under {ENOUGH} true %",
    "cross ″ p50",
    "roll ″ p50",
    "cross ″ p95",
    "solve CPU ms p50",
    "p95",
    "target",
    "verdict",
]


def table_row(case: FrameCase, rows: list[FrameRow]) -> list[str]:
    """One row of the table."""
    n = len(rows)
    outcomes = [row.outcome for row in rows]
    good, wrong, raised = (outcomes.count(name) for name in (IDENTIFIED, WRONG, RAISED))
    low, high = wilson_interval(good, n)
    right = [row for row in rows if row.outcome == IDENTIFIED]
    cross, roll = ([getattr(row, name) for row in right] or [math.nan] for name in ("cross_arcsec", "roll_arcsec"))
    others = {name: outcomes.count(name) for name in sorted(set(outcomes) - {IDENTIFIED, WRONG})}
    times = [row.solve_ms for row in rows]
    met = wrong + raised == 0 and (case.target is None or good / n >= case.target)
    return [
        case.name,
        str(n),
        f"{100 * good / n:.1f}",
        f"{100 * low:.1f}–{100 * high:.1f}",
        str(wrong),
        ", ".join(f"{count} {name}" for name, count in others.items()) or "–",
        f"{100 * np.mean([row.true_stars < ENOUGH for row in rows]):.1f}",
        f"{np.median(cross):.1f}",
        f"{np.median(roll):.1f}",
        f"{np.percentile(cross, 95):.1f}",
        f"{np.nanmedian(times):.1f}",
        f"{np.nanpercentile(times, 95):.1f}",
        "0 wrong" if case.target is None else f"≥ {100 * case.target:g}, 0 wrong",
        OK if met else SHORT,
    ]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns 1 if a target is missed."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.frames", description=__doc__.splitlines()[0])
    made.add_argument("--case", nargs="*", default=[], metavar="WORD", help="cases whose name contains a word")
    made.add_argument("--identifier", default="adaptive")
    made.add_argument("--n", type=int, default=200, help="frames a case")
    made.add_argument("--workers", type=int, default=1, help="processes; timings are cleanest with 1")
    made.add_argument("--failures", action="store_true", help="list the frames not identified")
    made.add_argument("--out", type=Path, help="Markdown file to write")
    options = made.parse_args(arguments)
    rates: list[list[str]] = []
    failed: list[list[str]] = []
    pool = ProcessPoolExecutor(options.workers) if options.workers > 1 else None
    try:
        for case in (CASES[name] for name in chosen(options.case, list(CASES))):
            started = time.monotonic()
            rows = run_case(case, options.identifier, options.n, pool)
            rates.append(table_row(case, rows))
            failed += [
                [case.name, str(row.index), row.outcome, str(row.true_stars)]
                for row in rows
                if row.outcome != IDENTIFIED
            ]
            taken = f"{time.monotonic() - started:.0f} s"
            print(f"{case.name}: {rates[-1][2]} % identified, {rates[-1][4]} wrong; {taken}", file=sys.stderr)
    finally:
        if pool is not None:
            pool.shutdown()
    tables: list[Table] = [(f"Frames from end to end · {options.identifier}", COLUMNS, rates)]
    if options.failures:
        tables.append(("Not identified", ["case", "index", "outcome", "true stars"], failed))
    show(tables)
    if options.out is not None:
        notes = [
            "Frames of `scenarios/cubesat_ideal.yaml`, lost in space: see `benchmarks/frames.py`. A solved frame is",
            f"wrong if it is off by more than {WRONG_CROSS_PX:g} px across or {WRONG_ROLL_DEG:g}° about the boresight.",
        ]
        write_markdown(options.out, "Frames", notes, tables)
    return int(any(row[-1] == SHORT for row in rates))


if __name__ == "__main__":
    sys.exit(main())
