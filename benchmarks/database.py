"""Time and memory of the guide database."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

COLUMNS = ["what", "guide stars", "build s", "first solve s", "later tracker ms", "MB"]


def database_row(identifier: str) -> list[str]:
    """One row, measured in a separate process, where nothing is cached in memory.

    The first solve is included because some tables are built on first use.
    """
    answer = subprocess.run(
        [sys.executable, "-m", "benchmarks.database", identifier], check=True, capture_output=True, text=True
    )
    return [identifier, *json.loads(answer.stdout)]


def measure(identifier: str) -> list[str]:
    """Times and size in this process."""
    from benchmarks.cases import CASES
    from benchmarks.scenes import SceneMaker
    from startracker import StarTracker, load_catalog

    case = CASES["10deg 6.5, 0.1 px"]
    scene = SceneMaker(case).scene(0)
    load_catalog("hipparcos")

    def tracker() -> StarTracker:
        return StarTracker(case.camera(), magnitude_limit=case.magnitude_limit, identifier=identifier)

    start = time.perf_counter()
    made = tracker()
    built = time.perf_counter()
    made.solve_centroids(scene.xy, scene.flux)
    solved = time.perf_counter()
    tracker()
    again = time.perf_counter()
    size = megabytes(made.guide)
    return [
        str(len(made.guide)),
        f"{built - start:.2f}",
        f"{solved - built:.2f}",
        f"{1e3 * (again - solved):.2f}",
        f"{size:.1f}",
    ]


def megabytes(thing: Any) -> float:
    """Total size of all arrays of an object, each counted once."""
    seen: dict[int, int] = {}

    def visit(part: Any) -> None:
        if id(part) in seen:
            return
        if isinstance(part, np.ndarray):
            if part.base is not None and isinstance(part.base, np.ndarray):
                visit(part.base)
                return
            seen[id(part)] = part.nbytes
            return
        seen[id(part)] = 0
        if isinstance(part, dict):
            parts = list(part.values())
        elif isinstance(part, list | tuple):
            parts = list(part)
        elif is_dataclass(part):
            parts = [getattr(part, f.name) for f in fields(part)] + list(getattr(part, "__dict__", {}).values())
        else:
            return
        for inner in parts:
            visit(inner)

    visit(thing)
    return sum(seen.values()) / 1e6


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1])))
