"""Golden outputs: what the whole of the software answers today, to compare with after a change of structure.

    python tests/helpers/golden_outputs.py            compares all groups with the files in tests/golden/, bit for bit
    python tests/helpers/golden_outputs.py lists      only this group; may be several
    python tests/helpers/golden_outputs.py --write    writes the files

A group is a dictionary of arrays. They are equal bit for bit on the processor that wrote them (named in the files):
vector instructions of another sum in another order, and noise that was drawn may round to another digital number.
A change of structure leaves all of them; a change of the physics or of an algorithm writes them again, and its commit
says why.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":
    sys.path[:0] = [str(ROOT)]

Outputs = dict[str, NDArray[Any]]
FOLDER = ROOT / "tests" / "golden"
TRIALS = {
    "cubesat": 20,
    "cubesat_ideal": 20,
    "greyling1995": 20,
    "sunsat": 20,
    "tc211": 20,
    "xybion": 12,
    "two_heads": 12,
    "cbers2": 12,
}
SEQUENCES = {"orbit": 12, "slew": 20, "thermal": 10, "operation": 20}
"""Scenarios with a sequence, and the number of frames."""
GALLERY_FRAMES = 4
DRAWN = 40
LISTS = 2000
FLIGHT_CAMERAS = ("tc211", "cubesat_ideal", "cubesat")
_SEED = 20261128


# ---------------------------------------------------------------------- arrays of answers
def number_rows(rows: list[list[float]]) -> NDArray[np.float64]:
    return np.array(rows, dtype=np.float64)


def text_rows(rows: list[str]) -> NDArray[np.str_]:
    return np.array(rows, dtype=np.str_)


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def solutions(answers: list[Any]) -> Outputs:
    """Status, reason, attitude, covariance, focal length and stars of solutions."""
    numbers = []
    for answer in answers:
        row = [np.nan] * 4 + [np.nan] * 9 + [np.nan]
        if answer.attitude is not None:
            row[:4] = [float(value) for value in answer.attitude.quat]
        if answer.covariance is not None:
            row[4:13] = [float(value) for value in np.ravel(answer.covariance)]
        if answer.camera is not None:
            row[13] = float(answer.camera.fx)
        numbers.append(row)
    stars = [digest(_bytes_of(answer.stars)) for answer in answers]
    return {
        "status": text_rows([str(answer.status) for answer in answers]),
        "reason": text_rows([answer.reason for answer in answers]),
        "numbers": number_rows(numbers),
        "stars": text_rows(stars),
    }


def _bytes_of(stars: Any) -> bytes:
    """Catalogue numbers and positions of matched stars."""
    if stars is None:
        return b""
    return np.asarray(stars.catalog_id, np.int64).tobytes() + np.asarray(stars.xy, np.float64).tobytes()


def prefixed(name: str, outputs: Mapping[str, NDArray[Any]]) -> Outputs:
    return {f"{name}/{key}": value for key, value in outputs.items()}


def columns_of(columns: Mapping[str, NDArray[Any]]) -> Outputs:
    """Columns of a table but those of times, texts as such."""
    kept = {name: values for name, values in columns.items() if not name.endswith("_ms")}
    return {name: values.astype(np.str_) if values.dtype == object else values for name, values in kept.items()}


# ---------------------------------------------------------------------- groups
def trials() -> Outputs:
    """Rows of trials of eight scenarios."""
    from simulator import Scenario, run

    found: Outputs = {}
    for name, count in TRIALS.items():
        found |= prefixed(name, columns_of(run(Scenario.load(name), trials=count, seed=1).columns))
    return found


def sequences() -> Outputs:
    """Rows of four sequences."""
    from simulator import Scenario
    from simulator.study.sequence.run import run_sequence

    found: Outputs = {}
    for name, frames in SEQUENCES.items():
        study = run_sequence(Scenario.load(name, [f"sequence.frames={frames}"]))
        found |= prefixed(name, columns_of(study.columns))
    return found


def images() -> Outputs:
    """Rendered frames of the gallery, and drawn skies for cameras that are not known: pixels and solutions."""
    from simulator import Renderer, Scenario
    from startracker import solve_unknown_fov

    pixels, answers = [], []
    for path in sorted((ROOT / "scenarios" / "gallery").glob("*.yaml")):
        scenario = Scenario.load(str(path))
        renderer = Renderer(scenario)
        tracker = scenario_tracker(scenario)
        for index in range(GALLERY_FRAMES):
            frame, _ = renderer.frame(index)
            pixels.append(digest(np.ascontiguousarray(frame.image).tobytes()))
            answers.append(tracker.solve(frame))
    for index in range(DRAWN):
        image = drawn_sky(index)
        pixels.append(digest(image.tobytes()))
        answers.append(solve_unknown_fov(image))
    return {"pixels": text_rows(pixels), **solutions(answers)}


def scenario_tracker(scenario: Any) -> Any:
    """The tracker of a scenario, as its trials use it."""
    from simulator.study.trials.trial import TrialRunner

    return TrialRunner(scenario).tracker


def drawn_sky(index: int) -> NDArray[np.uint16]:
    """Stars of the catalogue as spots on noise, for a field of 5° to 60°."""
    from startracker import Camera, load_catalog
    from startracker.geometry.attitude import quat_to_matrix

    rng = np.random.default_rng([_SEED, index])
    camera = Camera.from_fov(float(np.exp(rng.uniform(np.log(5.0), np.log(60.0)))), 640, 480)
    quat = rng.standard_normal(4)
    matrix = quat_to_matrix(quat / np.linalg.norm(quat))
    catalog = load_catalog("hipparcos").brighter_than(8.0)
    seen = catalog.directions(catalog.epoch_jyear) @ matrix.T
    front = seen[:, 2] > 0.3
    xy = camera.project(seen[front])
    inside = camera.contains(xy)
    xy, magnitude = xy[inside], catalog.v_mag[front][inside]
    brightest = np.argsort(magnitude)[:60]
    image = rng.normal(100.0, 3.0, (camera.height, camera.width))
    y, x = np.mgrid[-4:5, -4:5]
    for (px, py), m in zip(xy[brightest], magnitude[brightest], strict=True):
        column, row = round(px), round(py)
        if 4 <= column < camera.width - 4 and 4 <= row < camera.height - 4:
            spot = np.exp(-0.5 * ((x + column - px) ** 2 + (y + row - py) ** 2) / 1.2**2)
            faintest = magnitude[brightest[-1]]
            image[row - 4 : row + 5, column - 4 : column + 5] += 60.0 * 10.0 ** (0.4 * (faintest - m)) * spot
    return np.clip(image, 0.0, 65535.0).astype(np.uint16)


def lists() -> Outputs:
    """Two thousand lists of real fields that do not fit their camera, solved in every mode."""
    from benchmarks.doubtful_lists import GROUPS, doubtful_list
    from benchmarks.integrity import mode_of, solve

    found: Outputs = {}
    for group in GROUPS:
        given = [doubtful_list(group, index, _SEED) for index in range(LISTS // len(GROUPS))]
        found |= prefixed(group, solutions([solve(one, mode_of(one.mode)) for one in given]))
    return found


def exports() -> Outputs:
    """Digests of the files of flight builds, of frames and from centroids."""
    from simulator.checks import load_scenario
    from simulator.study.flight.design import flight_design
    from startracker.flight.export import flight_export

    names, digests = [], []
    for name in FLIGHT_CAMERAS:
        for arithmetic, identifier in flight_kinds():
            export = flight_export(flight_design(load_scenario(Path(name)), arithmetic, identifier))
            for file, text in sorted(export.files.items()):
                names.append(f"{name}/{arithmetic}/{identifier}/{file}")
                digests.append(digest(text.encode()))
    for file, text in sorted(centroid_export_files().items()):
        names.append(f"centroids/{file}")
        digests.append(digest(text.encode()))
    return {"names": text_rows(names), "digests": text_rows(digests)}


def flight_kinds() -> list[tuple[str, str]]:
    """Arithmetic and identifier of the flight builds."""
    from startracker.flight.design import ARITHMETICS, IDENTIFIERS

    return [(arithmetic, identifier) for arithmetic in ARITHMETICS for identifier in IDENTIFIERS]


def centroid_export_files() -> dict[str, str]:
    """Files of the flight build from centroids of a camera without a scenario, by the command."""
    import tempfile

    from typer.testing import CliRunner

    from simulator.cli.application import app

    with tempfile.TemporaryDirectory() as folder:
        done = CliRunner().invoke(app, ["export-c", f"{folder}/tracker"])
        if done.exit_code:
            raise SystemExit(f"export-c failed: {done.output}")
        files = sorted(Path(folder, "tracker").rglob("*"))
        return {file.name: file.read_text(encoding="utf-8") for file in files if file.is_file()}


def flight() -> Outputs:
    """Answers of the compiled flight build after each stage, for three cameras, each arithmetic and identifier."""
    found: Outputs = {}
    for name in FLIGHT_CAMERAS:
        for arithmetic, identifier in flight_kinds():
            found |= flight_answers(name, arithmetic, identifier)
    return found


def flight_answers(camera: str, arithmetic: str, identifier: str, cache: Path | None = None) -> Outputs:
    """Those of one build; its library is kept in a folder, by default that of all of them."""
    from simulator.checks import load_scenario
    from simulator.study.flight.design import flight_design
    from simulator.study.flight.library import FlightLibrary, compiled_library
    from tests.helpers.flight_answers import answers_of

    design = flight_design(load_scenario(Path(camera)), arithmetic, identifier)
    stages = answers_of(design, FlightLibrary(compiled_library(design, cache)))
    lines = {stage: text_rows(lines) for stage, lines in stages}
    return prefixed(f"{camera}/{arithmetic}/{identifier}", lines)


GROUPS: dict[str, Callable[[], Outputs]] = {
    "trials": trials,
    "sequences": sequences,
    "images": images,
    "lists": lists,
    "exports": exports,
    "flight": flight,
}


# ---------------------------------------------------------------------- files
def processor() -> str:
    """The processor as the compiler of the kernels names it, with the vector instructions that it uses."""
    from llvmlite import binding

    features = binding.get_host_cpu_features()
    return f"{binding.get_host_cpu_name()}, avx512f {bool(features.get('avx512f'))}"


def read(group: str) -> tuple[Outputs, str]:
    """Golden outputs of a group, and the processor that wrote them."""
    with np.load(FOLDER / f"{group}.npz", allow_pickle=False) as file:
        outputs = {name: file[name] for name in file.files}
    return outputs, str(outputs.pop("processor"))


def write(group: str, outputs: Outputs) -> None:
    """Write the golden outputs of a group."""
    FOLDER.mkdir(exist_ok=True)
    np.savez_compressed(FOLDER / f"{group}.npz", processor=np.array(processor()), **outputs)


def differences(found: Outputs, kept: Outputs, rtol: float = 0.0) -> list[str]:
    """What differs from the golden outputs by more than a relative error of numbers, a line each."""
    lines = [f"{name}: only now" for name in found.keys() - kept.keys()]
    lines += [f"{name}: only before" for name in kept.keys() - found.keys()]
    for name in kept.keys() & found.keys():
        now, before = found[name], kept[name]
        if now.shape != before.shape:
            lines.append(f"{name}: {now.shape} now, {before.shape} before")
            continue
        is_number = now.dtype.kind == "f"
        equal = np.isclose(now, before, rtol=rtol, atol=0.0, equal_nan=True) if is_number else now == before
        if not np.all(equal):
            first = tuple(int(k) for k in np.argwhere(~equal)[0])
            count = np.count_nonzero(~equal)
            lines.append(
                f"{name}: {count} of {equal.size} differ, first {first}: {now[first]} now, {before[first]} before"
            )
    return sorted(lines)


def main() -> int:
    """Compare or write; 1 if something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="*", choices=[*GROUPS, []], default=[], metavar="GROUP", help=", ".join(GROUPS))
    parser.add_argument("--write", action="store_true", help="write the files")
    parser.add_argument("--rtol", type=float, default=0.0, help="relative error of numbers that is not a difference")
    asked = parser.parse_args()
    different = 0
    for group in asked.groups or GROUPS:
        found = GROUPS[group]()
        if asked.write:
            write(group, found)
            print(f"{group}: {sum(value.size for value in found.values())} values written")
            continue
        kept, where = read(group)
        lines = differences(found, kept, asked.rtol)
        different += len(lines)
        note = "" if where == processor() else f" (written on {where}, this is {processor()})"
        print(f"{group}: {len(lines)} of {len(kept)} arrays differ{note}", *lines[:20], sep="\n    ", flush=True)
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
