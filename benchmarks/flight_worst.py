"""The frames and lists of the cubesat's camera that take the flight build most instructions.

Scenes of many kinds, each made from its kind, number and seed, are solved natively with their work counted
(`simulator.study.exported_c.work`); those with the highest estimates are then counted exactly on an emulated Cortex-M4.
What is done is kept in a folder, so that an interrupted run continues.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.flight_lists import FIELDS, field_list, null_list
from benchmarks.frames import CASES as FRAME_CASES
from benchmarks.frames import Bench
from benchmarks.pattern_lists import PATTERNS
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.exported_c.build import Build, compile_export
from simulator.study.exported_c.instructions import InstructionCounts, count_instructions
from simulator.study.exported_c.targets import CORTEX_M4
from simulator.study.exported_c.work import WorkProgram, instruction_weights
from simulator.study.flight.design import flight_design
from simulator.study.flight.program import frame_bytes, list_text
from simulator.study.star_tracker import build_tracker
from startracker import StarTracker
from startracker.core import FloatArray
from startracker.flight.c_text import CExport
from startracker.flight.export import flight_export

SCENARIOS = Path(__file__).resolve().parent.parent / "scenarios"
SEED = 25
KEPT = 20
BATCH = 10
CALIBRATION = 2
"""Scenes of each kind whose instructions are emulated to calibrate the estimate."""
SKY = "study.sampling=sky"
RENDERED: dict[str, tuple[str, tuple[str, ...]]] = {
    "plain": ("cubesat.yaml", (SKY,)),
    "smeared, 6 px": ("cubesat_ideal.yaml", (SKY, "pointing.rate_deg_s=[0.2, 0, 0.2]")),
    "smeared, 36 px": ("cubesat_ideal.yaml", (SKY, "pointing.rate_deg_s=[1.6, 0, 1.6]")),
    "hot pixels": ("gallery/hot_pixels.yaml", (SKY,)),
    "Earth limb": ("gallery/earth_limb.yaml", ()),
    "protons": ("gallery/saa.yaml", (SKY,)),
    "Milky Way": ("cubesat_ideal.yaml", ("pointing.target=[299, 35, 0]", "pointing.error_deg=8")),
    "galactic pole": ("cubesat_ideal.yaml", ("pointing.target=[192.9, 27.1, 0]", "pointing.error_deg=8")),
}
"""Scenario and values of each kind of rendered frames."""
MOON = "Moon at the edge"
WHITE, LEVEL = 4095, 60


@lru_cache(maxsize=2)
def _frames_of(kind: str) -> Callable[[int], Any]:
    if kind == MOON:
        return Bench(FRAME_CASES[MOON], "adaptive").frame
    file, values = RENDERED[kind]
    return Renderer(Scenario.load(SCENARIOS / file, list(values), seed=SEED)).frame


def rendered(kind: str, index: int) -> NDArray[np.uint16]:
    """A frame of the simulator."""
    return np.asarray(_frames_of(kind)(index)[0].image).astype(np.uint16)


def _clipped(image: FloatArray) -> NDArray[np.uint16]:
    return np.clip(np.rint(image), 0, WHITE).astype(np.uint16)


def _noise(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Even noise of 2 to 200 DN."""
    return np.asarray(LEVEL + 10.0 ** rng.uniform(0.3, 2.3) * rng.standard_normal(size))


def _bright_pixels(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Single pixels of random values: 1 to 60 % of all."""
    bright = rng.random(size) < rng.uniform(0.01, 0.6)
    return np.asarray(LEVEL + 4.0 * rng.standard_normal(size) + bright * rng.uniform(100.0, 4000.0, size))


def _images(rng: np.random.Generator, size: tuple[int, int], brightest: float) -> FloatArray:
    """100 to 20,000 images of stars at random positions, of random fluxes up to a brightest one."""
    count = round(10.0 ** rng.uniform(2.0, 4.3))
    frame, (height, width) = LEVEL + 4.0 * rng.standard_normal(size), size
    x, y = rng.uniform(4.0, width - 5.0, count), rng.uniform(4.0, height - 5.0, count)
    flux, reach = brightest * rng.random(count) ** 3, np.arange(-4, 5)
    column, row = np.rint(x).astype(int)[:, None] + reach, np.rint(y).astype(int)[:, None] + reach
    across, down = np.exp(-0.6 * (column - x[:, None]) ** 2), np.exp(-0.6 * (row - y[:, None]) ** 2)
    np.add.at(frame, (row[:, :, None], column[:, None, :]), flux[:, None, None] * down[:, :, None] * across[:, None, :])
    return frame


def _stripes(rng: np.random.Generator, size: tuple[int, int]) -> FloatArray:
    """Rectangles of random sizes and values, as of structured light."""
    frame = LEVEL + 4.0 * rng.standard_normal(size)
    for _ in range(int(rng.integers(20, 4000))):
        y, x = rng.integers(0, size)
        height, width = rng.integers(1, 1 + int(rng.choice([4, 30])), 2)
        frame[y : y + height, x : x + width] += rng.uniform(20.0, 3000.0)
    return frame


MADE: dict[str, Callable[[np.random.Generator, tuple[int, int]], FloatArray]] = {
    "noise": _noise,
    "bright pixels": _bright_pixels,
    "many stars": partial(_images, brightest=4000.0),
    "saturated stars": partial(_images, brightest=80000.0),
    "rectangles": _stripes,
}
"""Frames that are made here."""


class Camera(NamedTuple):
    """The cubesat's camera and its tracker."""

    tracker: StarTracker
    export: CExport

    @classmethod
    def of(cls, arithmetic: str) -> Camera:
        """With the flight build in an arithmetic."""
        scenario = Scenario.load(SCENARIOS / "cubesat.yaml", [SKY], seed=SEED)
        tracker = build_tracker(scenario, Renderer(scenario).camera)
        return cls(tracker, flight_export(flight_design(scenario, arithmetic)))

    def frame(self, kind: str, index: int) -> bytes:
        """A frame by its kind and number."""
        if kind in MADE:
            rng = stream(SEED, f"worst frame {kind}", index)
            size = self.tracker.camera.height, self.tracker.camera.width
            return frame_bytes(_clipped(MADE[kind](rng, size)))
        return frame_bytes(rendered(kind, index))

    def list(self, kind: str, index: int) -> bytes:
        """A list by its kind and number; a third of them have a prior, right or wrong, of 0.3 to 3 degrees."""
        rng = stream(SEED, f"worst list {kind}", index)
        if kind in FIELDS:
            field = field_list(self.tracker, FIELDS[kind], rng)
            stars, matrix = field.stars, field.matrix
        else:
            stars, matrix = null_list(self.tracker, PATTERNS[PATTERNS.index(kind)], rng), np.eye(3)
        if index % 3:
            return list_text(stars).encode()
        if index % 2 == 0:
            matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            matrix = matrix * np.linalg.det(matrix)
        radius = round(np.radians(10.0 ** rng.uniform(-0.5, 0.5)) * (1 << 28))
        rows = np.rint(matrix * (1 << 30)).astype(int)
        return list_text(stars, prior=[*rows.ravel().tolist(), radius]).encode()


class Pool(NamedTuple):
    """Scenes of one type: their kinds, how one is made, how the program reads it."""

    name: str
    kinds: tuple[str, ...]
    make: Callable[[str, int], bytes]
    word: str


def pools(camera: Camera) -> tuple[Pool, Pool]:
    """Frames and lists."""
    return (
        Pool("frames", (*RENDERED, MOON, *MADE), camera.frame, "frames"),
        Pool("lists", (*FIELDS, *PATTERNS), camera.list, "stars"),
    )


class Record:
    """What is done, in ``worst.json`` of a folder.

    Parameters
    ----------
    folder : Path
    digest : str
        Of the export; another one begins from nothing.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / "worst.json"
        held = json.loads(self.path.read_text()) if self.path.exists() else {}
        self.held: dict[str, Any] = held if held.get("digest") == digest else {"digest": digest}

    def __getitem__(self, name: str) -> dict[str, Any]:
        made: dict[str, Any] = self.held.setdefault(name, {})
        return made

    def save(self) -> None:
        """Write the file."""
        self.path.write_text(json.dumps(self.held, indent=1) + "\n", encoding="utf-8")


def calibrate(record: Record, pool: Pool, program: WorkProgram, build: Build) -> FloatArray:
    """Weights of the modules from `CALIBRATION` scenes of each kind."""
    held = record["weights"].get(pool.name)
    if held is None:
        scenes = [pool.make(kind, index) for kind in pool.kinds for index in range(CALIBRATION)]
        work = np.concatenate([program.run(scene, pool.word)[1] for scene in scenes])
        counted = [count_instructions(build, scene, pool.word) for scene in scenes]
        weights, correlation = instruction_weights(program.modules, work, counted)
        ratio = work @ weights / [one.total for one in counted]
        held = {
            "weights": weights.tolist(),
            "correlation": correlation,
            "scenes": len(scenes),
            "least": float(ratio.min()),
            "most": float(ratio.max()),
        }
        record["weights"][pool.name] = held
        record.save()
    text = "{name}: correlation {correlation:.4f} over {scenes} scenes, estimate over count {least:.3f} to {most:.3f}"
    print(text.format(name=pool.name, **held), file=sys.stderr)
    return np.array(held["weights"])


def screen(record: Record, pool: Pool, program: WorkProgram, weights: FloatArray, count: int) -> None:
    """Estimates of the first `count` scenes, the same number of each kind; the highest are kept."""
    each = -(-count // len(pool.kinds))
    held = record[pool.name]
    done, highest = held.setdefault("done", {}), held.setdefault("highest", [])
    for kind in pool.kinds:
        for first in range(done.get(kind, 0), each, BATCH):
            numbers = range(first, min(first + BATCH, each))
            lines, work = program.run(b"".join(pool.make(kind, index) for index in numbers), pool.word)
            for index, line, estimate in zip(numbers, lines, work @ weights, strict=True):
                highest.append([round(float(estimate)), kind, index, line.split()[0]])
            highest.sort(reverse=True)
            del highest[KEPT:]
            done[kind] = numbers[-1] + 1
            record.save()
        print(f"{pool.name}, {kind}: {done[kind]}; most so far {highest[0]}", file=sys.stderr)


class Worst(NamedTuple):
    """A scene with its instructions."""

    kind: str
    number: int
    status: str
    estimate: int
    counts: InstructionCounts


def exact(record: Record, pool: Pool, build: Build, folder: Path) -> list[Worst]:
    """Exact counts of the kept scenes, most first; the first one's input is written to the folder."""
    held = record[pool.name]
    counted = held.setdefault("counted", {})
    found = []
    for estimate, kind, index, status in held["highest"]:
        key = f"{kind} {index}"
        if key not in counted:
            counted[key] = count_instructions(build, pool.make(kind, index), pool.word).modules
            record.save()
        found.append(Worst(kind, index, status, estimate, InstructionCounts(counted[key], ())))
    found.sort(key=lambda one: -one.counts.total)
    data = pool.make(found[0].kind, found[0].number)
    (folder / f"worst_{pool.name}.{'u16' if pool.word == 'frames' else 'txt'}").write_bytes(data)
    return found


def find_worst(folder: Path, arithmetic: str, frames: int, lists: int) -> dict[str, list[Worst]]:
    """Worst frames and lists; the folder holds what is done and the inputs, `solve frames` or `solve stars` reads them.

    Parameters
    ----------
    folder : Path
    arithmetic : str
    frames, lists : int
        Number of scenes, distributed evenly over the kinds.
    """
    camera = Camera.of(arithmetic)
    text = "".join(camera.export.files[name] for name in sorted(camera.export.files) if name.startswith("tracker"))
    record = Record(folder, hashlib.sha256(text.encode()).hexdigest()[:16])
    with tempfile.TemporaryDirectory() as made:
        for name in ("work", "m4"):
            (Path(made) / name).mkdir()
        program = WorkProgram(camera.export, Path(made) / "work")
        build = compile_export(camera.export, Path(made) / "m4", CORTEX_M4)
        found = {}
        for pool, count in zip(pools(camera), (frames, lists), strict=True):
            if count:
                screen(record, pool, program, calibrate(record, pool, program, build), count)
                found[pool.name] = exact(record, pool, build, folder)
    return found
