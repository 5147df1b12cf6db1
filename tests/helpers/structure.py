"""The rooms of the house with their lines, and the files that one frame visits.

    python tests/helpers/structure.py            prints the tables of docs/architecture.md
    python tests/helpers/structure.py --write    writes them into the page

Lines are those of the files, of Python and of C. A file is visited if one of its Python functions is called, which a
profiler sees; compiled kernels call each other unseen.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "architecture.md"
if __name__ == "__main__":
    sys.path[:0] = [str(ROOT)]

ROOMS = {
    "startracker": {
        "tracker, front_end, field_solution, unexplained": "the stages in order; one acceptance; the solution made",
        "solution, inputs, observer, explain": "what users give and get, and explanations of each stage",
        "settings": "settings of every stage with their ranges, and algorithms by name",
        "geometry": "attitude, camera, lens and its fit; linear algebra of kernels",
        "catalog": "catalogues, guide stars, bodies, names",
        "images, annotation, wcs": "image files; annotated pictures; FITS headers",
        "detection": "from pixels to star candidates",
        "centroid": "from candidates to positions and their covariances",
        "trails": "stars trailed by the camera's motion",
        "identification": "which star is which, and its false-alarm probability",
        "blind, free_search": "unknown focal length (`identification/unknown_scale`)",
        "estimation": "attitude and covariance from identified stars",
        "tracking": "attitudes from frame to frame",
        "fusion": "several heads and a gyro",
        "calibration": "cameras from photographs, and in flight",
        "flight": "the tracker of one camera as C",
    },
    "simulator": {
        "scenario, checks, build": "the YAML file, its checks, and the physics made from it",
        "mission": "time, orbit, pointing, motion",
        "sky": "stars, bodies and background as seen from the spacecraft",
        "environment": "radiation and its effects",
        "optics": "point-spread functions, smear, distortion, stray light",
        "detector": "from photo-electrons to digital numbers",
        "scene, focal_plane, light, exposure, renderer, frame, fits": "one frame, from an instant to its file",
        "study": "trials, sequences, sweeps, datasheet, reports",
        "live": "missions that run live; the stimulator",
        "theses": "two theses recomputed",
        "cli": "the commands",
    },
}
"""Packages: rooms, each one or several modules of the top, and what is in them. Other modules are shared helpers."""
HELPERS = "shared helpers"


def lines_of(path: Path) -> int:
    """Lines of Python and C of a file or folder."""
    files = [path] if path.is_file() else [file for kind in ("*.py", "*.c", "*.h") for file in path.rglob(kind)]
    return sum(len(file.read_bytes().splitlines()) for file in files)


def rooms(package: str) -> dict[str, int]:
    """Lines of each room of a package, the helpers last."""
    folder, found = ROOT / package, {}
    known = {name for room in ROOMS[package] for name in room.split(", ")}
    for room in ROOMS[package]:
        paths = [folder / name if (folder / name).is_dir() else folder / f"{name}.py" for name in room.split(", ")]
        found[room] = sum(map(lines_of, paths))
    others = [path for path in folder.glob("*") if path.suffix == ".py" or (path / "__init__.py").is_file()]
    found[HELPERS] = sum(lines_of(path) for path in others if path.stem not in known)
    return found


def visited(call: Callable[[], object]) -> list[str]:
    """Our files of which a function is called, relative to the checkout."""
    found: set[str] = set()
    ours = tuple(f"{ROOT / package}/" for package in ROOMS)

    def seen(frame: object, event: str, _: object) -> None:
        if event == "call" and (name := frame.f_code.co_filename).startswith(ours):  # type: ignore[attr-defined]
            found.add(name[len(str(ROOT)) + 1 :])

    before = sys.getprofile()
    sys.setprofile(seen)
    try:
        call()
    finally:
        sys.setprofile(before)
    return sorted(found)


def visits() -> dict[str, list[str]]:
    """Files visited by the second frame of the scenario ``cubesat`` and by its solution."""
    from simulator import Renderer, Scenario
    from simulator.study.star_tracker import build_tracker

    scenario = Scenario.load("cubesat")
    renderer = Renderer(scenario)
    tracker, (frame, _) = build_tracker(scenario, renderer.camera), renderer.frame(0)
    assert tracker.solve(frame).solved
    return {
        "Renderer.frame": visited(lambda: renderer.frame(1)),
        "StarTracker.solve": visited(lambda: tracker.solve(frame)),
    }


def table_of_rooms() -> str:
    rows = ["| room | lines | what it holds |", "|---|---|---|"]
    for package, names in ROOMS.items():
        lines = rooms(package)
        rows.append(f"| **`{package}/`** | {sum(lines.values()):,} | |")
        rows += [f"| {_code(room)} | {lines[room]:,} | {what} |" for room, what in names.items()]
        rows.append(f"| {HELPERS} | {lines[HELPERS]:,} | arguments, errors, compilation, constants, files |")
    return "\n".join(rows)


def _code(room: str) -> str:
    return " ".join(f"`{name}`" for name in room.split(", "))


def table_of_visits() -> str:
    found = visits()
    rows = ["| call | our files visited |", "|---|---|"]
    return "\n".join([*rows, *(f"| `{name}` | {len(files)} |" for name, files in found.items())])


def written(page: str, name: str, table: str) -> str:
    """The page with the table between the comments ``<!-- name -->`` and ``<!-- end -->``."""
    pattern = rf"(<!-- {name} -->\n).*?(<!-- end -->)"
    assert re.search(pattern, page, re.DOTALL), name
    return re.sub(pattern, lambda match: f"{match[1]}{table}\n{match[2]}", page, flags=re.DOTALL)


def main() -> None:
    tables = {"rooms": table_of_rooms(), "visits": table_of_visits()}
    print("\n\n".join(tables.values()))
    if "--write" in sys.argv:
        page = PAGE.read_text(encoding="utf-8")
        for name, table in tables.items():
            page = written(page, name, table)
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
