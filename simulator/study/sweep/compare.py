"""Comparison of runs: differences of their scenarios, and of their errors.

Runs with the same seed share their trials (times, attitudes and random streams), and are also compared trial by trial:
the ratio of their rms errors over the trials solved by both is more accurate than the separate intervals suggest.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simulator.scenario import ScenarioError
from simulator.scenario.document import parse_document, read_text
from simulator.scenario.errors import Problem
from simulator.scenario.output import cell
from simulator.study.axes import AXES
from simulator.study.intervals import plain, ratios_of_rms
from simulator.study.point_statistics import OUTCOME_COLUMNS, TRIAL_COLUMNS, point_statistics
from simulator.study.trials.arrow import as_array, read_columns
from simulator.study.trials.columns import Columns
from startracker import files
from startracker.display import fields_repr
from startracker.errors import InputError

IGNORED = ("name", "description")
"""Keys without effect on the simulation."""

MAX_RUNS = 200


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """A run, or a point of a sweep, in a comparison."""

    name: str
    """The folder as given, and the number of a point."""
    values: dict[str, Any]
    """All keys of its scenario by dotted path."""
    columns: Mapping[str, NDArray[Any]]
    """Columns `TRIAL_COLUMNS` of its trials."""
    statistics: dict[str, Any]
    """From `simulator.study.point_statistics.point_statistics`."""
    trials_per_second: float | None = None
    """Speed, if recorded."""
    identity: Mapping[str, Any] = field(default_factory=dict)
    """Scenario, seed and version of the results, as in their JSON file."""

    __repr__ = fields_repr


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of runs."""

    runs: tuple[ComparedRun, ...]
    """In the given order; the first is the reference."""
    differences: dict[str, tuple[Any, ...]]
    """Values in each run of every key that differs, by dotted path; None if a run does not have the key."""
    ratios: tuple[dict[str, tuple[float, float | None, float | None]] | None, ...]
    """For every run, by axis: (ratio, low, high) of its rms error relative to the first run, over the trials solved by
    both, with 95 % interval; None for the first run, and if trials cannot be paired."""


def compare(folders: Sequence[str | Path]) -> Comparison:
    """Compare runs by their folders.

    Parameters
    ----------
    folders : sequence of paths
        Results of ``boresight run``, or of ``boresight sweep`` (all points, or with ``DIR:3`` the point of that
        number).

    Raises
    ------
    InputError
        For a folder without results, or fewer than two runs.
    """
    runs = [run for folder in folders for run in _load(str(folder))]
    if len(runs) < 2:
        raise InputError("compare: needs at least two runs; give more folders")
    if len(runs) > MAX_RUNS:
        raise InputError(f"compare: {len(runs)} runs are too many for a page; select points of the sweep, as DIR:3")
    return Comparison(
        tuple(runs), differences([run.values for run in runs]), (None, *(_ratios(runs[0], run) for run in runs[1:]))
    )


def differences(scenarios: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Keys that differ between scenarios, in order of occurrence."""
    paths = dict.fromkeys(path for values in scenarios for path in values)
    rows = {path: tuple(values.get(path) for values in scenarios) for path in paths if path not in IGNORED}
    return {
        path: row
        for path, row in rows.items()
        if any(value != row[0] for value in row) or any(path not in values for values in scenarios)
    }


def _load(given: str) -> list[ComparedRun]:
    folder, _, number = given.rpartition(":")
    if Path(given).is_dir() or not folder or not number.isdigit():
        folder, number = given, ""
    path = Path(folder)
    if (path / "summary.json").is_file() and (path / "trials.parquet").is_file() and not number:
        return [_load_run(path, given)]
    if (path / "sweep.json").is_file() and (path / "sweep.parquet").is_file():
        return _load_points(path, int(number) if number else None)
    what = "no such folder" if not path.is_dir() else "contains no results of boresight run or boresight sweep"
    raise InputError(f"{given}: {what}")


def _load_run(folder: Path, name: str) -> ComparedRun:
    summary = _json(folder / "summary.json")
    values = _resolved(folder / "scenario.resolved.yaml")
    columns = Columns(_trials(folder / "trials.parquet"))
    statistics = point_statistics(columns, int(summary["seed"]))
    return ComparedRun(name, values, columns, statistics, summary.get("trials_per_second"), summary.get("identity", {}))


def _load_points(folder: Path, number: int | None) -> list[ComparedRun]:
    table = _json(folder / "sweep.json")
    done = {point["point"]: point for point in table["points"] if point["status"] == "done"}
    if number is not None and number not in done:
        reasons = [p["reason"] or p["status"] for p in table["points"] if p["point"] == number]
        raise InputError(f"{folder}:{number}: {reasons[0] if reasons else 'the sweep has no such point'}")
    base = _flat(table["scenario"])
    trials = _trials(folder / "sweep.parquet", "point")
    runs = []
    for index in done if number is None else [number]:
        mine = trials.take(np.flatnonzero(as_array(trials["point"]) == index))
        runs.append(
            ComparedRun(
                f"{folder}:{index}",
                base | done[index]["values"],
                Columns(mine),
                done[index]["statistics"],
                identity=table.get("identity", {}),
            )
        )
    return runs


def _ratios(first: ComparedRun, other: ComparedRun) -> dict[str, tuple[float, float | None, float | None]] | None:
    """Ratio of the rms errors over the trials solved by both; None if no trials can be paired."""
    if any(first.values.get(key) != other.values.get(key) for key in ("seed", "study.sampling")):
        return None
    _, mine, theirs = np.intersect1d(first.columns["index"], other.columns["index"], return_indices=True)
    both = (first.columns["status"][mine] == "solved") & (other.columns["status"][theirs] == "solved")
    if not np.any(both):
        return None
    errors, reference = (
        np.stack([run.columns[f"error_{axis}_deg"][rows][both] for axis in AXES], axis=1)
        for run, rows in ((other, theirs), (first, mine))
    )
    if not (np.any(errors, axis=0).all() and np.any(reference, axis=0).all()):
        return None
    ratio, ends = ratios_of_rms(errors, reference, seed=int(first.values.get("seed") or 0))
    found: dict[str, tuple[float, float | None, float | None]] = {}
    for k, axis in enumerate(AXES):
        low, high = plain(None if ends is None else ends[k])
        found[axis] = (float(ratio[k]), low, high)
    return found


def _trials(file: Path, *more: str) -> pa.Table:
    try:
        return read_columns(file, [*more, *TRIAL_COLUMNS], optional=OUTCOME_COLUMNS)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{file}: cannot be read ({str(error).splitlines()[0]})") from error


def _json(file: Path) -> dict[str, Any]:
    text = files.read_text(file, files.RESULT_BYTES, "give the folder of a study")
    try:
        found: dict[str, Any] = json.loads(text)
    except ValueError as error:
        raise InputError(f"{file}: cannot be read ({error})") from error
    return found


def _resolved(file: Path) -> dict[str, Any]:
    """All keys of a resolved scenario, read without the schema, so that runs of other versions can be compared."""
    text = read_text(file, str(file))
    problems = [text] if isinstance(text, Problem) else []
    table = parse_document(text, str(file), problems) if isinstance(text, str) else None
    if table is None or problems:
        raise ScenarioError(problems)
    return _flat(table.plain())


def _flat(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted path to value in the form of `cell`, independent of its origin."""
    flat: dict[str, Any] = {}
    for key, value in nested.items():
        path = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, Mapping):
            flat |= _flat(value, path)
        else:
            flat[path] = cell(value)
    return flat
