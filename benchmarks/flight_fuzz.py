"""Fuzzing of the flight build (libFuzzer): its stages one by one and together, in both arithmetics.

    python -m benchmarks.flight_fuzz [--seconds 600] [--jobs 2] [--what front stars ...] [--arithmetic fixed float]
                                     [--identifier triads] [--corpus DIR]

The code is that of every camera; the constants are smaller, so that an execution is short and limits are reached: few
pixels, 12 stars, guide stars of two parts of the sky, searches of at most 25,000 steps. Executions are added up in
``executions.json`` of the corpus every minute, so that an interrupted run counts and the next one continues from its
inputs; a change of the C code begins a new count. Exits with 1 if anything is found; the inputs are in ``findings``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np

from benchmarks.flight_fuzz_seeds import SEEDS
from simulator.study.exported_c.fuzz import FuzzResult, build_fuzzers, run_fuzzer
from startracker import Camera, DetectionSettings, StarTracker
from startracker.flight.c_text import CExport
from startracker.flight.design import IDENTIFIERS, DetectorNumbers, FlightDesign
from startracker.flight.export import Part, assemble, flight_parts, flight_tables
from startracker.flight.search_export import SEARCHES

LONGEST = {"front": 300, "frames": 300, "stars": 120, "search": 120, "pose": 120, "filter": 196, "session": 336}
"""Fuzzers, and their longest inputs, bytes."""
SLICE_S = 60
SMALLER = {
    "FRONT_RUNS": 8,
    "FRONT_HOT": 6,
    "FRONT_OBJECTS": 8,
    "SEARCH_MOST_VOTES": 96,
    "SEARCH_MOST_KEPT": 512,
    "SEARCH_MOST_CANDIDATES": 10,
    "SEARCH_KEPT": 4,
    "FOLLOWING_WINDOW": 6,
    "TRIAD_ROOM": 96,
    "TRIAD_GROUPS": 8,
    "TRIAD_NAMED": 24,
}
"""Limits that frames and lists of this size would not reach."""
SKY_PARTS = ((1.0, 0.2, 0.0), (0.1, 0.0, 1.0))
"""Middles of the two parts of the sky that have guide stars: on both sides of the equator, and at the pole."""


class Small(NamedTuple):
    """A camera: field of view, size, faintest guide stars and radius of the parts of the sky, steps of a search."""

    fov_deg: float
    width: int
    height: int
    magnitude: float
    radius_deg: float
    steps: int


FRONT = Small(4.6, 40, 32, 7.0, 6.0, 0)
FRAMES = Small(6.0, 72, 60, 7.0, 8.0, 25_000)
LISTS = Small(12.0, 512, 480, 5.7, 24.0, 20_000)
"""Few pixels for the front end; for frames, more; for lists, pixels small enough to identify them soon."""
CAMERAS = {"front": FRONT, "frames": FRAMES} | dict.fromkeys(list(LONGEST)[2:], LISTS)
"""Camera of each fuzzer."""


def fuzz_design(camera: Small, arithmetic: str, identifier: str = "adaptive") -> FlightDesign:
    """A camera with about ten guide stars in its fields."""
    optics = Camera.from_fov(camera.fov_deg, camera.width, camera.height)
    tracker = StarTracker(optics, magnitude_limit=camera.magnitude, identifier=identifier)
    guide = tracker.guide
    axes = np.array(SKY_PARTS) / np.linalg.norm(SKY_PARTS, axis=1)[:, None]
    near = np.flatnonzero((guide.directions @ axes.T).max(axis=1) > np.cos(np.radians(camera.radius_deg)))
    guide = replace(
        guide,
        catalog=guide.catalog.select(near),
        directions=guide.directions[near],
        pattern=guide.pattern[near],
        _motion=[],
        _pairs={},
        _grid=[],
    )
    detection = DetectionSettings(max_stars=12, background_tile_px=16, max_pixels=60)
    numbers, settings = DetectorNumbers(1.0, 5.0, 4095), (detection, tracker.centroid, tracker.identification)
    return FlightDesign(tracker.camera, guide, numbers, 0.9, *settings, arithmetic, name="fuzz", identifier=identifier)


def fuzz_export(camera: Small, arithmetic: str, identifier: str = "adaptive") -> CExport:
    """The export of a camera, with searches that end early and smaller limits."""
    design = fuzz_design(camera, arithmetic, identifier)
    parts = [_smaller(part, camera.steps) for part in flight_parts(flight_tables(design))]
    return assemble(design, parts, "tracker", "")


def _smaller(part: Part, most_steps: int) -> Part:
    """A part with the limits of `SMALLER` and the searches' steps, their last column, cut, and the bound on all."""
    constants = {name: min(value, SMALLER.get(name, value)) for name, value in part.constants.items()}
    arrays = {table.name: table for table in part.arrays}
    if "search_row" in arrays:
        steps = arrays["search_row"].values
        cut = np.hstack([steps[:, :-1], np.minimum(steps[:, -1:], most_steps)])
        constants["SEARCH_MOST_STEPS"] -= SEARCHES * int((steps - cut).sum())
        arrays["search_row"] = replace(arrays["search_row"], values=cut)
    return part._replace(constants=constants, arrays=list(arrays.values()))


class Tally(NamedTuple):
    """Executions of one fuzzer on one state of the code."""

    executions: int = 0
    seconds: float = 0.0
    edges: int = 0
    finding: str = ""

    def added(self, result: FuzzResult) -> Tally:
        """With one more run."""
        done, spent = self.executions + result.executions, self.seconds + result.seconds
        return Tally(done, round(spent, 1), result.edges, result.finding)

    def __str__(self) -> str:
        rate = self.executions / max(self.seconds, 1.0)
        return f"{self.executions:12,} {rate:10,.0f} {self.edges:8,}  {self.finding or 'nothing'}"


class Tallies:
    """``executions.json``: the executions by digest of the code and fuzzer.

    Parameters
    ----------
    folder : Path
        Of the corpus.
    digest : str
        Of the code.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self.path, self.digest = folder / "executions.json", digest
        self._lock = Lock()
        kept = json.loads(self.path.read_text()) if self.path.exists() else {}
        self.all: dict[str, dict[str, Tally]] = {
            code: {name: Tally(**one) for name, one in of.items()} for code, of in kept.items()
        }
        self.now = self.all.setdefault(digest, {})

    def add(self, name: str, result: FuzzResult) -> Tally:
        """Count a run and write the file."""
        with self._lock:
            self.now[name] = self.now.get(name, Tally()).added(result)
            text = {code: {of: one._asdict() for of, one in named.items()} for code, named in self.all.items()}
            self.path.write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")
            return self.now[name]

    @property
    def executions(self) -> int:
        """Of this code."""
        return sum(one.executions for one in self.now.values())

    @property
    def earlier(self) -> int:
        """Of other states of it."""
        return sum(one.executions for named in self.all.values() for one in named.values()) - self.executions


def code_digest(export: CExport) -> str:
    """Digest of the modules without tables and what surrounds them: that of the code fuzzed."""
    named = [f"{export.prefix}_{module}.c" for module in export.modules]
    return hashlib.sha256("".join(export.files[name] for name in named).encode()).hexdigest()[:12]


def write_seeds(what: str, corpus: Path) -> None:
    """Inputs to begin with."""
    corpus.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(SEEDS[what]()):
        (corpus / f"seed{number}").write_bytes(data)


def fuzz(
    program: Path, what: str, corpus: Path, seconds: int, counted: Callable[[FuzzResult], object] = lambda _: None
) -> FuzzResult:
    """Run a fuzzer in slices, each of which is counted; the sum, ended by a finding.

    Parameters
    ----------
    program : Path
        From `build_fuzzers`.
    what : str
        Its name.
    corpus : Path
        Folder of its inputs.
    seconds : int
        In all.
    counted : callable
        Called with each slice.
    """
    write_seeds(what, corpus)
    executions, spent = 0, 0.0
    while True:
        limit = max(1, min(SLICE_S, seconds - round(spent)))
        result = run_fuzzer(program, corpus, limit, LONGEST[what], corpus.parent / "findings")
        counted(result)
        executions, spent = executions + result.executions, spent + result.seconds
        if result.finding or spent >= seconds:
            return FuzzResult(executions, spent, result.edges, result.finding)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns 1 if something is found."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.flight_fuzz", description=__doc__.splitlines()[0])
    made.add_argument("--seconds", type=int, default=600, help="of each fuzzer")
    made.add_argument("--jobs", type=int, default=1, help="fuzzers at a time")
    made.add_argument("--what", nargs="*", default=list(LONGEST), choices=list(LONGEST))
    made.add_argument("--arithmetic", nargs="*", default=["fixed", "float"], choices=["fixed", "float"])
    made.add_argument("--identifier", choices=IDENTIFIERS, default="adaptive")
    made.add_argument("--corpus", type=Path, help="folder that keeps inputs and executions")
    options = made.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        corpus: Path = options.corpus or Path(temporary) / "corpus"
        corpus.mkdir(parents=True, exist_ok=True)
        programs: dict[str, Path] = {}
        named = "" if options.identifier == "adaptive" else f"{options.identifier}_"
        for arithmetic in options.arithmetic:
            for number, camera in enumerate(dict.fromkeys(CAMERAS[what] for what in options.what)):
                folder = Path(temporary) / f"{arithmetic}{number}"
                folder.mkdir()
                export = fuzz_export(camera, arithmetic, options.identifier)
                built = build_fuzzers(export, [what for what in options.what if CAMERAS[what] == camera], folder)
                programs |= {f"{what}_{named}{arithmetic}": program for what, program in built.items()}
        tallies = Tallies(corpus, code_digest(export))

        def run(name: str) -> None:
            what = name.partition("_")[0]
            fuzz(programs[name], what, corpus / name, options.seconds, lambda result: tallies.add(name, result))
            print(f"{name:20} {tallies.now[name]}", flush=True)

        print("fuzzer                 executions per second    edges  found", flush=True)
        with ThreadPoolExecutor(options.jobs) as pool:
            list(pool.map(run, programs))
        print(f"{tallies.executions:,} executions of this code, {tallies.earlier:,} of earlier states of it")
        return int(any(tallies.now[name].finding for name in programs))


if __name__ == "__main__":
    sys.exit(main())
