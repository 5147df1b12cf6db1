"""A sweep: the Monte Carlo study of a scenario at many values of some of its keys.

Every point is a run of the engine with the same seed: trial i meets the same times, attitudes, stars and noise draws at
every point (common random numbers; Law 2015, *Simulation Modeling and Analysis*, section 11.2), so that a difference
between points is more certain than either point by itself. Finished points are kept one file each in ``points/`` until
all are done; a kill costs the point under way at most.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from simulator.checks import NAME_CHECKS, load_scenario
from simulator.paths import make_folder, write_atomically
from simulator.randomness import stream
from simulator.scenario import Scenario, ScenarioError
from simulator.scenario.grid import SweptKey, grid, latin_hypercube, overrides, parse_swept_keys
from simulator.study.data_frames import Rows
from simulator.study.result_files import parquet_bytes
from simulator.study.results_folder import (
    FILES,
    IDENTITY_FILE,
    Identity,
    refuse_other,
    results_folder,
    scenario_sha256,
    standing,
    unfinished_identity,
)
from simulator.study.statistics import BODY_AXES
from simulator.study.sweep.files import cell, point_files, write_results
from simulator.study.trials.checked_files import fault_of, set_aside, write_checked
from simulator.study.trials.engine import MAX_ROUNDS, Trials, run_trials
from simulator.study.trials.process_pool import WorkerPool
from simulator.study.trials.trial import TrialRunner
from startracker._version import __version__
from startracker.display import described
from startracker.errors import BoresightError, InputError

POINTS_FOLDER = "points"


class Where(NamedTuple):
    """Where trials are run: on processes here, or on the cluster of a scheduler."""

    workers: int
    dask: str | None


Progress = Callable[[int, int, "Point"], None]
"""Called with (trials finished, trials in all, the point under way)."""


@dataclass(frozen=True, eq=False)
class Point:
    """One combination of values."""

    index: int
    """Its number, from 0."""
    values: tuple[Any, ...]
    """Values of the swept keys, in their order."""
    scenario: Scenario | None
    """What is run; None where physics refuses it."""
    refused: str = ""
    """Why, where it is."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All points of a sweep, before anything is run."""

    swept: tuple[SweptKey, ...]
    """What is swept."""
    points: tuple[Point, ...]
    """In the order in which they are run."""
    kind: str
    """``grid`` or ``latin_hypercube``."""

    @property
    def runnable(self) -> tuple[Point, ...]:
        """Points that physics allows."""
        return tuple(point for point in self.points if point.scenario is not None)

    @property
    def scenario(self) -> Scenario:
        """Scenario of the first point that can be."""
        scenario = self.runnable[0].scenario
        assert scenario is not None
        return scenario

    @property
    def fingerprint(self) -> str:
        """SHA-256 of what every point's trials depend on: what has to be the same to go on."""
        lines = [
            scenario_sha256(point.scenario, trials=point.scenario.study.trials) if point.scenario else point.refused
            for point in self.points
        ]
        keys = [axis.path for axis in self.swept]
        return hashlib.sha256("\n".join([__version__, self.kind, *keys, *lines]).encode()).hexdigest()

    def identity(self, points: int) -> Identity:
        """Identity of so many points of it."""
        trials = self.scenario.study.trials
        amounts = {"points": points, "trials each": trials}
        return Identity("sweep", self.scenario.name, self.scenario.seed, self.fingerprint, amounts)


def plan_sweep(
    path: str | Path,
    over: Sequence[str],
    *,
    lhs: int | None = None,
    trials: int | None = None,
    seed: int | None = None,
    set_values: Sequence[str] = (),
) -> Plan:
    """Points of a sweep, each with its scenario, or with the reason why it cannot be.

    Parameters
    ----------
    path : path
        Scenario file, or the name of one that ships.
    over : sequence of str
        ``path=low:high:count[,log]`` or ``path=v1,v2,…``.
    lhs : int, optional
        Number of points of a Latin hypercube, drawn from the scenario's seed; None: the full grid.
    trials, seed : int, optional
        In place of the scenario's own.
    set_values : sequence of str
        ``path=value`` at every point.

    Raises
    ------
    InputError
        For a mistake in the options or the file, or when no point at all can be.
    """
    swept = parse_swept_keys(over, NAME_CHECKS)
    if lhs is None:
        values, kind = grid(swept), "grid"
    else:
        base_seed = load_scenario(path, set_values, trials=trials, seed=seed).seed if seed is None else seed
        values, kind = latin_hypercube(swept, lhs, stream(base_seed, "sweep")), "latin_hypercube"
    points: list[Point] = []
    for index, row in enumerate(values):
        try:
            options = [*set_values, *overrides(swept, row)]
            points.append(Point(index, row, load_scenario(path, options, trials=trials, seed=seed)))
        except ScenarioError as error:
            points.append(Point(index, row, None, "; ".join(p.message for p in error.problems)))
    plan = Plan(swept, tuple(points), kind)
    if not plan.runnable:
        load_scenario(
            path, set_values, trials=trials, seed=seed
        )  # a mistake of the file itself is reported with its line
        raise InputError(f"--over: none of the {len(points)} points can be; the first: {points[0].refused}")
    return plan


@dataclass(frozen=True, eq=False)
class Sweep(Rows):
    """Result of a sweep."""

    table: dict[str, Any]
    """What ``sweep.json`` holds: the points with their values, states and statistics, and how they were made."""
    folder: Path
    """Where the files are."""
    notes: tuple[str, ...] = ()
    """Sentences on files of finished points that were found damaged and computed again."""

    @property
    def trials(self) -> pa.Table:
        """All trials of all points, in memory."""
        return pq.read_table(self.folder / "sweep.parquet")

    def _table(self) -> pa.Table:
        return self.trials

    def __repr__(self) -> str:
        return described("Sweep", f"{len(self.table['points'])} points", str(self.folder))


def run_sweep(
    plan: Plan,
    out: str | Path,
    *,
    workers: int = 1,
    dask: str | None = None,
    resume: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Sweep:
    """Run every point of a plan and write ``sweep.parquet``, ``points.csv``, ``sweep.json``, plots and ``sweep.html``.

    Parameters
    ----------
    plan : Plan
        From `plan_sweep`.
    out : path
        Folder of the results.
    workers : int
        Processes; the rows do not depend on their number.
    dask : str, optional
        Address of a dask.distributed scheduler, to run on its workers instead.
    resume : bool
        Where a sweep of the *same* plan stands whole in `out`, return it. Finished points of one that was interrupted
        are taken over in any case.
    force : bool
        Compute everything again, and replace what stands in `out`, whatever it is.
    progress : callable, optional
        Called for every block of trials.

    Raises
    ------
    InputError
        For no workers, an unwritable folder; where `out` holds another sweep; or where another process is at work
        there.
    """
    if workers < 1:
        raise InputError(f"workers: must be at least 1, not {workers}")
    with results_folder(Path(out), plan.identity(len(plan.points)), resume=resume, force=force) as folder:
        old = None if force else standing(folder, "sweep")
        if resume and old and not (folder / POINTS_FOLDER).exists():
            return Sweep(json.loads((folder / FILES["sweep"]).read_text(encoding="utf-8")), folder)
        return _run_sweep(plan, folder, Where(workers, dask), force, progress, old.amounts["points"] if old else 0)


@dataclass
class _State:
    """How far a sweep has come."""

    refused: dict[int, str]
    """Why a point cannot be, by its number."""
    whole: set[int] = field(default_factory=set)
    """Points whose trials are kept."""
    notes: list[str] = field(default_factory=list)
    trials_run: int = 0
    interrupted: bool = False


def _run_sweep(
    plan: Plan, folder: Path, where: Where, force: bool, progress: Progress | None, points_standing: int
) -> Sweep:
    """Run what is left of a plan and write the results, unless they are fewer points than those that stand there."""
    kept = _open_points(plan, folder, force)
    state = _State({point.index: point.refused for point in plan.points if point.scenario is None})
    started = time.perf_counter()
    _run_points(plan, kept, state, where, progress)
    if not state.whole:
        if state.interrupted:
            raise BoresightError("interrupted before the first point was finished: nothing to report")
        first = state.refused[min(state.refused)]
        raise InputError(f"--over: none of the {len(plan.points)} points can be; the first: {first}")
    reached = len(state.whole) if state.interrupted else len(plan.points)
    if reached < points_standing:
        raise BoresightError(
            f"interrupted: {len(state.whole)} points are finished and kept for the next run; {folder} keeps the "
            f"results of the earlier sweep of {points_standing} points"
        )
    specification = plan.scenario.specification
    table = {
        "name": plan.scenario.name,
        "scenario_file": plan.scenario.source_name,
        "version": __version__,
        "seed": plan.scenario.seed,
        "trials_per_point": plan.scenario.study.trials,
        "kind": plan.kind,
        "interrupted": state.interrupted,
        "swept": [_describe(axis) for axis in plan.swept],
        "specification_deg": {axis: getattr(specification, f"{axis}_deg") for axis in BODY_AXES},
        "identity": plan.identity(reached).to_dict(),
        "workers": where.workers,
        "elapsed_s": time.perf_counter() - started,
        "trials_run": state.trials_run,
        "scenario": plan.scenario.resolved(),
    }
    rows = [(point.index, point.values, state.refused.get(point.index)) for point in plan.points]
    write_results(table, [axis.path for axis in plan.swept], rows, kept, folder)
    if not state.interrupted:
        shutil.rmtree(kept, ignore_errors=True)
    return Sweep(table, folder, tuple(state.notes))


def _run_points(plan: Plan, kept: Path, state: _State, where: Where, progress: Progress | None) -> None:
    """Run the points that are not kept yet, again those whose files are found damaged at the end."""
    with WorkerPool(where.workers) as pool:
        for attempt in itertools.count():
            state.whole = _whole_points(kept, state.notes)
            todo = [p for p in plan.runnable if p.index not in state.whole and p.index not in state.refused]
            done = sum(_trials_of(point) for point in plan.runnable if point.index in state.whole)
            total = sum(_trials_of(point) for point in plan.runnable if point.index not in state.refused)
            if progress and not state.interrupted and (todo or attempt == 0):
                progress(done, total, (todo or plan.runnable)[0 if todo else -1])
            if state.interrupted or not todo:
                return
            if attempt == MAX_ROUNDS:
                raise BoresightError(f"{state.notes[-1]}: damaged {MAX_ROUNDS} times; is the disk failing?")
            for point in todo:
                report = _shifted(progress, done, total, point)
                try:
                    trials = _run_point(point, pool, where.dask, report)
                except KeyboardInterrupt:  # where the engine does not listen: between points, or asked twice
                    state.interrupted = True
                    break
                if isinstance(trials, str):
                    state.refused[point.index] = trials
                    total -= _trials_of(point)
                elif trials.interrupted:
                    state.interrupted = True
                    break
                else:
                    _write_point(plan, point, trials.table, kept)
                    state.trials_run += _trials_of(point)
                    done += _trials_of(point)


def _trials_of(point: Point) -> int:
    return point.scenario.study.trials if point.scenario else 0


def _run_point(
    point: Point, pool: WorkerPool, dask: str | None, progress: Callable[[int, int], None] | None
) -> Trials | str:
    """Trials of a point, or why there can be none."""
    scenario = point.scenario
    assert scenario is not None
    try:
        if dask is None:
            return run_trials(scenario, scenario.study.trials, workers=pool, progress=progress)
        TrialRunner(scenario)  # what cannot be is reported here; a cluster that is not there is another matter
    except InputError as error:
        return " ".join(str(error).split())
    return run_trials(scenario, scenario.study.trials, dask=dask, progress=progress)


def _shifted(progress: Progress | None, before: int, total: int, point: Point) -> Callable[[int, int], None] | None:
    """Progress of a point as progress of the sweep."""
    return (lambda finished, _: progress(before + finished, total, point)) if progress else None


def _describe(axis: SweptKey) -> dict[str, Any]:
    return {
        "path": axis.path,
        "unit": axis.key.unit,
        "log": axis.log,
        "numeric": axis.numeric,
        "range": None if axis.low is None else [axis.low, axis.high],
        "values": [cell(v) for v in axis.values],
    }


def _write_point(plan: Plan, point: Point, trials: pa.Table, kept: Path) -> None:
    """The trials of a point with its number and its values before them."""
    n = trials.num_rows
    columns: dict[str, pa.Array] = {"point": pa.array(np.full(n, point.index, dtype=np.int32))}
    for axis, value in zip(plan.swept, point.values, strict=True):
        if axis.numeric:
            columns[axis.path] = pa.array([value] * n, pa.int64() if axis.whole else pa.float64())
        else:
            columns[axis.path] = pa.array([str(cell(value))] * n, pa.string())
    for name in trials.column_names:
        columns[name] = trials[name]
    write_checked(kept, f"{point.index:06d}", parquet_bytes(pa.table(columns), compression="zstd"))


def _open_points(plan: Plan, folder: Path, force: bool) -> Path:
    """Folder of finished points: those of an interrupted sweep of the same plan stay."""
    kept = folder / POINTS_FOLDER
    identity_file = kept / IDENTITY_FILE
    if kept.exists() and any(kept.iterdir()) and not identity_file.exists():
        raise InputError(f"{kept}: holds files that are no sweep's; choose another --out")
    if force:
        shutil.rmtree(kept, ignore_errors=True)
    new = plan.identity(0)
    if (old := unfinished_identity(kept, "sweep")) is not None and old.sha256 != new.sha256:
        refuse_other(folder, old, new, "finished points")
    make_folder(kept)
    write_atomically(identity_file, json.dumps({"identity": plan.identity(len(plan.points)).to_dict()}))
    return kept


def _whole_points(kept: Path, notes: list[str]) -> set[int]:
    """Numbers of the points whose trials are kept; damaged files are set aside, with a sentence each."""
    whole = set()
    for index, path in point_files(kept).items():
        if fault := fault_of(path):
            notes.append(set_aside(path, fault, kept.parent))
        else:
            whole.add(index)
    return whole
