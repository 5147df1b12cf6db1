"""The flight build in C compared with `StarTracker`: rendered frames and lists of stars, lost in space.

    python -m benchmarks.flight [--frames 200] [--lists 2000] [--case WORD ...] [--arithmetic fixed float]
                                [--identifier triads] [--keep DIR] [--out FILE.md]

Both get the same pixels or the same list, the calibrated camera, the velocity of the observer and the epoch. An
attitude is correct within the limits of the other benchmarks. The ratio of the errors is that of their rms across the
boresight, over what both identify, with an interval by bootstrap.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.cases import CASES as LIST_CASES
from benchmarks.cases import chosen
from benchmarks.frames import CASES as FRAME_CASES
from benchmarks.frames import Bench
from benchmarks.oracle import rotation_error
from benchmarks.report import OK, SHORT, Table, provenance, show, write_markdown
from benchmarks.scenes import Case, Scene, SceneMaker
from benchmarks.score import IDENTIFIED, WRONG, WRONG_CROSS_PX, WRONG_ROLL_DEG
from simulator.frame import Frame, FrameTruth
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.flight.design import flight_design
from simulator.study.flight.library import FlightLibrary, Known, compiled_library
from simulator.study.flight.program import velocity_of
from simulator.study.star_tracker import build_tracker
from simulator.study.statistics import wilson_interval
from simulator.study.trials.trial import solve_frame
from startracker import StarTracker
from startracker.core import FloatArray
from startracker.flight.apparent import epoch_of
from startracker.flight.design import IDENTIFIERS, DetectorNumbers, FlightDesign
from startracker.flight.stars import StarList

SCENARIOS = Path(__file__).resolve().parent.parent / "scenarios"
SEED = 20
DEFAULT = "adaptive"
MOON = "Moon at the edge"
LIST_FLUX_DN = 1e6
"""Of magnitude 0 in the lists, of which only ratios count."""
RESAMPLES = 2000
LIMITS = {"fixed": 1.1, "float": 1.05}
"""Largest ratio of the errors."""
ALLOWED = 0.01
"""Largest share of what `StarTracker` identifies and the C does not."""
_DEFAULTS: tuple[str, ...] = (
    "tracker.detector=components",
    "tracker.centroider=least_squares",
    "tracker.centroid={}",
    "tracker.identification={}",
)
"""The methods of the flight build, in place of those of the thesis."""
FRAMES: dict[str, tuple[str, tuple[str, ...]]] = {
    "cubesat": ("cubesat.yaml", ()),
    "TC211": ("tc211.yaml", _DEFAULTS),
    "smeared": ("cubesat_ideal.yaml", ("pointing.rate_deg_s=[0.2, 0, 0.2]",)),
    "hot pixels": ("gallery/hot_pixels.yaml", ()),
    MOON: ("cubesat_ideal.yaml", ()),
}
"""Scenario and values of each kind of frames."""
LISTS = (
    "10deg 6.5, 0.1 px",
    "10deg 6.5, 0.3 px, 3 false, 20% dropped",
    "10deg 6.5, 1 px, 5 false, 20% dropped",
    "20deg 5.5, 0.3 px, 3 false, 20% dropped",
    "25 random points",
)


class Outcome(NamedTuple):
    """Status and error (3,) of an attitude, rad, camera axes; NaN if there is none."""

    status: str
    error: FloatArray


class Given(NamedTuple):
    """A frame, what is known of it, its true attitude, and the answer of `StarTracker`."""

    image: FloatArray
    velocity: tuple[int, ...]
    truth: FloatArray
    outcome: Outcome
    epoch: int


def outcome_of(
    status: str, truth: FloatArray, matrix: FloatArray | None, pixel_rad: float, sky: bool = True
) -> Outcome:
    """Score an answer."""
    if matrix is None:
        return Outcome(status, np.full(3, math.nan))
    error = rotation_error(truth, matrix)
    cross, roll = math.hypot(error[0], error[1]), abs(float(error[2]))
    right = sky and cross <= WRONG_CROSS_PX * pixel_rad and roll <= math.radians(WRONG_ROLL_DEG)
    return Outcome(IDENTIFIED if right else WRONG, error)


# ------------------------------------------------------------------ frames
def scenario_of(name: str, identifier: str) -> Scenario:
    """Scenario of a kind of frames, lost in space."""
    file, values = FRAMES[name]
    common = ["study.sampling=sky", "tracker.prior=false", f"tracker.identifier={identifier}"]
    return Scenario.load(SCENARIOS / file, [*common, *values], seed=SEED)


def rendered(name: str, identifier: str, count: int, keep: Path | None) -> Iterator[Given]:
    """Frames with the answers of `StarTracker`, from `keep` if they are there."""
    scenario = scenario_of(name, identifier)
    folder = name.replace(" ", "_") + ("" if identifier == DEFAULT else f"_{identifier}")
    make: list[Callable[[int], tuple[Frame, FrameTruth]]] = []
    solver: list[StarTracker] = []
    for index in range(count):
        file = None if keep is None else keep / folder / f"{index}.npz"
        if file is None or not file.exists():
            if not make:
                renderer = Renderer(scenario)
                make.append(Bench(FRAME_CASES[MOON], "adaptive").frame if name == MOON else renderer.frame)
                solver.append(build_tracker(scenario, renderer.camera))
            given = _solved(solver[0], *make[0](index))
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                np.savez(file, *given[:3], given.outcome.status, given.outcome.error, given.epoch)
        else:
            with np.load(file) as held:
                image, velocity, truth, status, error, epoch = (held[f"arr_{k}"] for k in range(6))
            given = Given(image, tuple(velocity.tolist()), truth, Outcome(str(status), error), int(epoch))
        yield given


def _solved(tracker: StarTracker, frame: Frame, truth: FrameTruth) -> Given:
    solution = solve_frame(tracker, frame)
    matrix = None if solution.attitude is None else solution.attitude.as_matrix()
    true = truth.attitude.as_matrix()
    outcome = outcome_of(str(solution.status), true, matrix, frame.camera.pixel_rad)
    observer = frame.observer
    velocity, epoch = velocity_of(observer.velocity_km_s), epoch_of(observer.epoch_jyear)
    return Given(np.asarray(frame.image), velocity, true, outcome, epoch)


def compare_frames(
    name: str, identifier: str, arithmetics: list[str], count: int, keep: Path | None
) -> list[list[str]]:
    """A row for each arithmetic."""
    scenario = scenario_of(name, identifier)
    designs = {arithmetic: flight_design(scenario, arithmetic) for arithmetic in arithmetics}
    libraries = {arithmetic: FlightLibrary(compiled_library(design)) for arithmetic, design in designs.items()}
    python: list[Outcome] = []
    compiled: dict[str, list[Outcome]] = {arithmetic: [] for arithmetic in arithmetics}
    for given in rendered(name, identifier, count, keep):
        python.append(given.outcome)
        for arithmetic, library in libraries.items():
            library.read(np.ascontiguousarray(given.image, dtype=np.uint16), Known(given.velocity, given.epoch))
            answer, _ = library.finish()
            matrix = None if answer.attitude is None else answer.attitude.as_matrix()
            pixel = designs[arithmetic].camera.pixel_rad
            compiled[arithmetic].append(outcome_of(answer.status, given.truth, matrix, pixel))
    return [row_of(name, arithmetic, python, compiled[arithmetic]) for arithmetic in arithmetics]


# ------------------------------------------------------------------ lists
def list_design(case: Case, identifier: str, arithmetic: str) -> tuple[FlightDesign, StarTracker]:
    """Design of the camera of a benchmark case, and the tracker that it is compared with."""
    tracker = StarTracker(case.camera(), magnitude_limit=case.magnitude_limit, identifier=identifier)
    design = FlightDesign(
        tracker.camera,
        tracker.guide,
        DetectorNumbers(1.0, 10.0, 65535),
        1.0,
        tracker.detection,
        tracker.centroid,
        tracker.identification,
        arithmetic,
        name=case.name,
        identifier=identifier,
    )
    return design, tracker


def scene_stars(scene: Scene, most: int) -> StarList:
    """The `most` brightest stars of a scene, of unknown errors."""
    xy, flux = scene.xy[:most], LIST_FLUX_DN * scene.flux[:most]
    stars = StarList.of(xy, flux, np.ones(len(xy)))
    return stars._replace(variance=np.zeros(len(xy), dtype=np.int64))


def compare_lists(name: str, identifier: str, arithmetics: list[str], count: int) -> list[list[str]]:
    """A row for each arithmetic."""
    case = LIST_CASES[name]
    maker, pixel = SceneMaker(case, SEED), case.camera().pixel_rad
    scenes = [maker.scene(index) for index in range(count)]
    rows = []
    python: list[Outcome] = []
    for arithmetic in arithmetics:
        design, tracker = list_design(case, identifier, arithmetic)
        if not python:
            for scene in scenes:
                solution = tracker.solve_centroids(scene.xy, scene.flux)
                matrix = None if solution.attitude is None else solution.attitude.as_matrix()
                python.append(outcome_of(str(solution.status), scene.matrix, matrix, pixel, case.sky))
        library = FlightLibrary(compiled_library(design))
        answers = [library.solve_stars(scene_stars(scene, library.most_stars), Known())[0] for scene in scenes]
        found = [None if answer.attitude is None else answer.attitude.as_matrix() for answer in answers]
        compiled = [
            outcome_of(answer.status, scene.matrix, matrix, pixel, case.sky)
            for answer, scene, matrix in zip(answers, scenes, found, strict=True)
        ]
        rows.append(row_of(name, arithmetic, python, compiled))
    return rows


# ------------------------------------------------------------------ tables
COLUMNS = ["case", "C", "n", "Python %", "C %", "95 %", "only Python", "only C", "Python wrong", "wrong"]
COLUMNS += ["error ratio", "95 %", "verdict"]


def row_of(name: str, arithmetic: str, python: list[Outcome], compiled: list[Outcome]) -> list[str]:
    """One row: shares, differences, ratio of the errors, verdict."""
    n = len(python)
    ours = np.array([one.status == IDENTIFIED for one in compiled])
    theirs = np.array([one.status == IDENTIFIED for one in python])
    wrong, wrong_python = (sum(one.status == WRONG for one in outcomes) for outcomes in (compiled, python))
    low, high = wilson_interval(int(ours.sum()), n)
    both = ours & theirs
    ratio, interval = error_ratio(
        np.array([one.error for one in compiled])[both], np.array([one.error for one in python])[both]
    )
    met = wrong == 0 and int(theirs.sum()) - int(ours.sum()) <= ALLOWED * n
    met = met and (math.isnan(ratio) or ratio <= LIMITS[arithmetic])
    return [
        name,
        arithmetic,
        str(n),
        f"{100 * theirs.mean():.1f}",
        f"{100 * ours.mean():.1f}",
        f"{100 * low:.1f}–{100 * high:.1f}",
        str(int((theirs & ~ours).sum())),
        str(int((ours & ~theirs).sum())),
        str(wrong_python),
        str(wrong),
        "–" if math.isnan(ratio) else f"{ratio:.3f}",
        "–" if math.isnan(ratio) else f"{interval[0]:.3f}–{interval[1]:.3f}",
        OK if met else SHORT,
    ]


def error_ratio(compiled: FloatArray, python: FloatArray) -> tuple[float, tuple[float, float]]:
    """Ratio of the rms errors across the boresight of (N, 3) rotation vectors, and its bootstrap interval (95 %)."""
    if len(compiled) == 0:
        return math.nan, (math.nan, math.nan)
    square = np.array([(one[:, :2] ** 2).sum(axis=1) for one in (compiled, python)])
    rows = stream(SEED, "error ratio", 0).integers(0, len(compiled), (RESAMPLES, len(compiled)))
    sums = square[:, rows].sum(axis=2)
    low, high = np.percentile(np.sqrt(sums[0] / sums[1]), [2.5, 97.5])
    return float(np.sqrt(square[0].sum() / square[1].sum())), (float(low), float(high))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns 1 if a target is missed."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.flight", description=__doc__.splitlines()[0])
    made.add_argument("--frames", type=int, default=200, help="frames of a kind")
    made.add_argument("--lists", type=int, default=2000, help="lists of a case")
    made.add_argument("--case", nargs="*", default=[], metavar="WORD", help="cases whose name contains a word")
    made.add_argument("--arithmetic", nargs="*", default=list(LIMITS), choices=list(LIMITS))
    made.add_argument("--identifier", choices=IDENTIFIERS, default=DEFAULT)
    made.add_argument("--keep", type=Path, help="folder for the rendered frames, used again if they are there")
    made.add_argument("--render", action="store_true", help="only render the frames, into the folder of --keep")
    made.add_argument("--out", type=Path, help="Markdown file to write")
    options = made.parse_args(arguments)
    frames: list[list[str]] = []
    lists: list[list[str]] = []
    for name in chosen(options.case, [*FRAMES, *LISTS]):
        if options.render:
            kept = rendered(name, options.identifier, options.frames, options.keep) if name in FRAMES else ()
            solved = [one.outcome.status for one in kept]
            print(f"{name}: {len(solved)} frames, {solved.count(IDENTIFIED)} identified", file=sys.stderr)
        elif name in FRAMES:
            frames += compare_frames(name, options.identifier, options.arithmetic, options.frames, options.keep)
            print(*frames[-len(options.arithmetic) :], sep="\n", file=sys.stderr)
        elif options.lists:
            lists += compare_lists(name, options.identifier, options.arithmetic, options.lists)
            print(*lists[-len(options.arithmetic) :], sep="\n", file=sys.stderr)
    tables: list[Table] = [("Frames", COLUMNS, frames), ("Lists of stars", COLUMNS, lists)]
    tables = [table for table in tables if table[2]]
    show(tables)
    if options.out is not None:
        write_markdown(options.out, "The flight build compared with StarTracker", provenance(), tables)
    return int(any(row[-1] == SHORT for row in [*frames, *lists]))


if __name__ == "__main__":
    sys.exit(main())
