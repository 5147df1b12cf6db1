"""What the flight build takes: flash, RAM, stack and instructions of each stage, on emulated processors.

    python -m benchmarks.flight_cost [--arithmetic fixed float] [--lists 2000] [--targets m4 m7 ...] [--out FILE.md]
    nice python -m benchmarks.flight_cost --worst DIR [--frames 10000] [--lists 10000]

Instructions of one rendered frame of `scenarios/cubesat.yaml` by stage on every processor, and the most that any of the
lists of `benchmarks.flight` takes on a Cortex-M4, with the case and number of that list, which make it again. With
``--worst`` the most that any of many frames and lists takes (`benchmarks.flight_worst`); the folder keeps what is done
and the inputs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import flight_worst
from benchmarks.cases import CASES
from benchmarks.flight import DEFAULT, LISTS, SEED, list_design, scenario_of, scene_stars
from benchmarks.report import Table, provenance, show, write_markdown
from benchmarks.scenes import SceneMaker
from simulator.renderer import Renderer
from simulator.study.exported_c.instructions import InstructionCounts, count_instructions, marked
from simulator.study.exported_c.targets import CORTEX_M4, CORTEX_M7, HOST, M68K, RISCV32, RISCV64, Target
from simulator.study.flight.design import flight_design
from simulator.study.flight.program import FlightProgram, frame_bytes, list_text, velocity_of

TARGETS = {"m4": CORTEX_M4, "m7": CORTEX_M7, "68k": M68K, "rv64": RISCV64, "rv32": RISCV32}
STAGES = {
    "background, detection": (
        "front",
        "hot_pixels",
        "rows",
        "background",
        "components",
        "trails",
        "trail_fit",
        "motion",
    ),
    "centroids": ("stamps", "fit"),
    "identification": (
        *("search", "votes", "pair", "candidates", "confirm", "verify", "evidence"),
        *("triads", "triad_votes", "cordic", "verification"),
    ),
    "attitude": ("pose", "pose_fit", "unexplained", "arithmetic", "following", "attitude_filter", "attitude"),
    "directions, integers, library": ("directions", "integers", "separations", "library", "frame"),
}
"""Modules of each stage; the last are called by several."""


class Worst(NamedTuple):
    """The list that takes most instructions."""

    case: str
    index: int
    instructions: int
    mean: float

    def figures(self, lists: int) -> list[str]:
        """Cells of the table."""
        mean, most = (f"{count / 1e6:.1f}" for count in (self.mean, self.instructions))
        return [str(lists), mean, most, f"seed {SEED}, {self.index}"]


def by_stage(counts: InstructionCounts) -> dict[str, int]:
    """Instructions of each stage; a module that no stage names is under its own name."""
    of_module = {module: stage for stage, modules in STAGES.items() for module in modules}
    found = dict.fromkeys(STAGES, 0)
    for module, count in counts.modules.items():
        stage = of_module.get(module, module)
        found[stage] = found.get(stage, 0) + count
    return found


def frame_costs(arithmetic: str, targets: list[Target]) -> list[list[str]]:
    """Memory, and instructions of one frame by stage: a row a processor."""
    scenario = scenario_of("cubesat", DEFAULT)
    design = flight_design(scenario, arithmetic)
    frame, _ = Renderer(scenario).frame(0)
    words = ("frames", *map(str, velocity_of(frame.observer.velocity_km_s)))
    data = frame_bytes(frame.image)
    rows, expected = [], b""
    for target in (HOST, *targets):
        with tempfile.TemporaryDirectory() as folder:
            build = FlightProgram(design, Path(folder), target).build
            said = build.run(data, *words)
            expected = expected or said
            memory = [build.table_bytes, build.code_bytes, build.context_bytes, build.stack_bytes]
            stages = by_stage(count_instructions(build, data, *words)) if target.emulator else {}
        same = "yes" if said == expected else "NO"
        total = f"{sum(stages.values()) / 1e6:.1f}" if stages else "–"
        counted = [f"{stages[name] / 1e6:.2f}" if stages else "–" for name in STAGES]
        rows.append([target.name, arithmetic, *(f"{n:,}" for n in memory), same, *counted, total])
    return rows


def worst_list(arithmetic: str, count: int) -> list[Worst]:
    """Of each case of lists, the one that takes most instructions on a Cortex-M4."""
    target = marked(CORTEX_M4, "tracker")
    found = []
    for name in LISTS:
        design, _ = list_design(CASES[name], DEFAULT, arithmetic)
        maker = SceneMaker(CASES[name], SEED)
        texts = [list_text(scene_stars(maker.scene(index), design.detection.max_stars)) for index in range(count)]
        with tempfile.TemporaryDirectory() as folder:
            program = FlightProgram(design, Path(folder), target)
            counts = count_instructions(program.build, "".join(texts).encode(), "stars").answers
        index = int(np.argmax(counts))
        found.append(Worst(name, index, counts[index], float(np.mean(counts))))
        print(found[-1], file=sys.stderr)
    return found


def worst_scenes(folder: Path, arithmetic: str, frames: int, lists: int) -> list[Table]:
    """Tables of the worst frames and lists, million instructions by stage, with what the bound on steps gives."""
    tables: list[Table] = []
    columns = ["kind", "number", "status", "estimate", *STAGES, "total, million"]
    for name, found in flight_worst.find_worst(folder, arithmetic, frames, lists).items():
        rows = []
        for one in found[:5]:
            stages = by_stage(one.counts)
            counted = [f"{stages[stage] / 1e6:.2f}" for stage in STAGES]
            total = f"{one.counts.total / 1e6:.1f}"
            rows.append([one.kind, str(one.number), one.status, f"{one.estimate / 1e6:.1f}", *counted, total])
        tables.append((f"{name} that take most on a Cortex-M4, {arithmetic}", columns, rows))
    return tables


FRAME_COLUMNS = ["what", "C", "tables, bytes", "code", "context", "stack", "same bits", *STAGES, "total, million"]
LIST_COLUMNS = ["case", "C", "lists", "mean, million instructions", "most", "list"]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    made = argparse.ArgumentParser(prog="python -m benchmarks.flight_cost", description=__doc__.splitlines()[0])
    made.add_argument("--arithmetic", nargs="*", default=["fixed", "float"])
    made.add_argument("--worst", type=Path, metavar="DIR", help="find the frames and lists that take most")
    made.add_argument("--frames", type=int, default=10000, help="of --worst")
    made.add_argument("--lists", type=int, help="lists of a case, by default 2000, or in all with --worst, 10000")
    made.add_argument("--targets", nargs="*", default=list(TARGETS), choices=list(TARGETS))
    made.add_argument("--out", type=Path, help="Markdown file to write")
    options = made.parse_args(arguments)
    if options.worst is not None:
        lists_in_all = 10000 if options.lists is None else options.lists
        tables = [
            table
            for arithmetic in options.arithmetic
            for table in worst_scenes(options.worst / arithmetic, arithmetic, options.frames, lists_in_all)
        ]
        show(tables)
        if options.out is not None:
            write_markdown(options.out, "What the flight build takes at most", provenance(), tables)
        return 0
    options.lists = 2000 if options.lists is None else options.lists
    targets = [TARGETS[name] for name in options.targets if TARGETS[name].missing() is None]
    frames: list[list[str]] = []
    lists: list[list[str]] = []
    for arithmetic in options.arithmetic:
        frames += frame_costs(arithmetic, targets)
        if options.lists and CORTEX_M4.missing() is None:
            lists += [
                [one.case, arithmetic, *one.figures(options.lists)] for one in worst_list(arithmetic, options.lists)
            ]
    tables = [
        ("One frame of the cubesat, million instructions", FRAME_COLUMNS, frames),
        ("Lists of stars on a Cortex-M4", LIST_COLUMNS, lists),
    ]
    tables = [table for table in tables if table[2]]
    show(tables)
    if options.out is not None:
        write_markdown(options.out, "What the flight build takes", provenance(), tables)
    return 0


if __name__ == "__main__":
    sys.exit(main())
