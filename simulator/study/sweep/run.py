"""A sweep: the Monte Carlo study of a scenario at many values of some of its keys.

Every point is a run of the engine with the same seed: trial i has the same time, attitude, stars and random numbers at
every point (common random numbers; Law 2015, *Simulation Modeling and Analysis*, section 11.2), so that differences
between points are more accurate than the points themselves. Finished points are stored in one file each in ``points/``
until all are done; if the process is killed, at most the current point is lost.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from simulator.checks import NAME_CHECKS, load_scenario
from simulator.paths import make_folder, write_atomically
from simulator.randomness import stream
from simulator.scenario import Scenario, ScenarioError
from simulator.scenario.grid import SweptKey, grid, latin_hypercube, overrides, parse_swept_keys
from simulator.scenario.output import cell
from simulator.study.data_frames import Rows
from simulator.study.result_files import now_utc
from simulator.study.results_folder import (
    FILES,
    IDENTITY_FILE,
    Identity,
    refuse_other,
    remove_unfinished,
    results_folder,
    scenario_sha256,
    standing,
    unfinished_identity,
)
from simulator.study.specification.requirements import specification_of
from simulator.study.specification.verdicts import frames_needed
from simulator.study.sweep.files import point_files, write_point, write_results
from simulator.study.trials.arrow import read_columns
from simulator.study.trials.checked_files import fault_of, set_aside
from simulator.study.trials.engine import MAX_ROUNDS, Trials, run_trials
from simulator.study.trials.process_pool import WorkerPool
from simulator.study.trials.trial import TrialRunner
from startracker._compiled import clock
from startracker._version import __version__
from startracker.display import described
from startracker.errors import BoresightError, InputError

POINTS_FOLDER = "points"


class Where(NamedTuple):
    """Where trials are run: in local processes, or on a cluster."""

    workers: int
    dask: str | None


Progress = Callable[[int, int, "Point"], None]
"""Called with (trials finished, total trials, current point)."""


@dataclass(frozen=True, eq=False)
class Point:
    """One combination of values."""

    index: int
    """Number, from 0."""
    values: tuple[Any, ...]
    """Values of the swept keys, in order."""
    scenario: Scenario | None
    """Scenario of the point; None if it is unphysical."""
    refused: str = ""
    """Reason, if it is refused."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All points of a sweep, before the run."""

    swept: tuple[SweptKey, ...]
    """Swept keys."""
    points: tuple[Point, ...]
    """Points in the order of the run."""
    kind: str
    """``grid`` or ``latin_hypercube``."""

    @property
    def runnable(self) -> tuple[Point, ...]:
        """Physically possible points."""
        return tuple(point for point in self.points if point.scenario is not None)

    @property
    def scenario(self) -> Scenario:
        """Scenario of the first possible point."""
        scenario = self.runnable[0].scenario
        assert scenario is not None
        return scenario

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the inputs of all points, which must be unchanged to resume."""
        lines = [
            scenario_sha256(point.scenario, trials=point.scenario.study.trials) if point.scenario else point.refused
            for point in self.points
        ]
        keys = [axis.path for axis in self.swept]
        return hashlib.sha256("\n".join([__version__, self.kind, *keys, *lines]).encode()).hexdigest()

    def identity(self, points: int) -> Identity:
        """Identity of a number of points."""
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
    """Points of a sweep, each with its scenario, or with the reason why it is impossible.

    Parameters
    ----------
    path : path
        Scenario file, or the name of an included one.
    over : sequence of str
        ``path=low:high:count[,log]`` or ``path=v1,v2,…``.
    lhs : int, optional
        Number of points of a Latin hypercube, from the scenario's seed; None: the full grid.
    trials, seed : int, optional
        Replace the scenario's.
    set_values : sequence of str
        ``path=value`` at every point.

    Raises
    ------
    InputError
        For errors in the options or the file, or if no point is possible.
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
        load_scenario(path, set_values, trials=trials, seed=seed)  # errors in the file are reported with their line
        raise InputError(f"--over: none of the {len(points)} points are possible; the first: {points[0].refused}")
    return plan


@dataclass(frozen=True, eq=False)
class Sweep(Rows):
    """Result of a sweep."""

    table: dict[str, Any]
    """Content of ``sweep.json``: the points with their values, states and statistics, and their inputs."""
    folder: Path
    """Folder of the files."""
    notes: tuple[str, ...] = ()
    """Messages on damaged files of finished points that were computed again."""

    @property
    def trials(self) -> pa.Table:
        """All trials of all points, in memory."""
        return read_columns(self.folder / "sweep.parquet")

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
        If `out` contains a complete sweep of the *same* plan, return it. Finished points of an interrupted sweep are
        always reused.
    force : bool
        Compute everything again, and replace any results in `out`.
    progress : callable, optional
        Called after every block of trials.

    Raises
    ------
    InputError
        For no workers or an unwritable folder; if `out` contains another sweep; or if another process uses it.
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
    """Progress of a sweep."""

    refused: dict[int, str]
    """Reasons why points are impossible, by number."""
    whole: set[int] = field(default_factory=set)
    """Points with stored trials."""
    notes: list[str] = field(default_factory=list)
    trials_run: int = 0
    interrupted: bool = False


def _run_sweep(
    plan: Plan, folder: Path, where: Where, force: bool, progress: Progress | None, points_standing: int
) -> Sweep:
    """Run the remaining points of a plan and write the results, unless they have fewer points than existing ones."""
    kept = _open_points(plan, folder, force)
    state = _State({point.index: point.refused for point in plan.points if point.scenario is None})
    started = clock()
    _run_points(plan, kept, state, where, progress)
    if not state.whole:
        if state.interrupted:
            raise BoresightError("interrupted before the first point was finished: no results")
        first = state.refused[min(state.refused)]
        raise InputError(f"--over: none of the {len(plan.points)} points are possible; the first: {first}")
    reached = len(state.whole) if state.interrupted else len(plan.points)
    if reached < points_standing:
        raise BoresightError(
            f"interrupted: {len(state.whole)} points are finished and kept for the next run; {folder} still contains "
            f"the results of the earlier sweep of {points_standing} points"
        )
    specification = specification_of(plan.scenario)
    table = {
        "name": plan.scenario.name,
        "scenario_file": plan.scenario.source_name,
        "version": __version__,
        "finished_utc": now_utc(),
        "seed": plan.scenario.seed,
        "trials_per_point": plan.scenario.study.trials,
        "kind": plan.kind,
        "interrupted": state.interrupted,
        "swept": [_describe(axis) for axis in plan.swept],
        "specification_deg": {each.name: each.limit for each in specification.errors},
        "trials_needed": max(map(frames_needed, specification.requirements), default=0),
        "identity": plan.identity(reached).to_dict(),
        "workers": where.workers,
        "elapsed_s": clock() - started,
        "trials_run": state.trials_run,
        "scenario": plan.scenario.resolved(),
    }
    rows = [(point.index, point.values, state.refused.get(point.index)) for point in plan.points]
    scenarios = {point.index: point.scenario for point in plan.points if point.scenario is not None}
    write_results(table, [axis.path for axis in plan.swept], rows, kept, folder, scenarios)
    if not state.interrupted:
        remove_unfinished(kept)
    return Sweep(table, folder, tuple(state.notes))


def _run_points(plan: Plan, kept: Path, state: _State, where: Where, progress: Progress | None) -> None:
    """Run the points that are not stored yet, and again those whose files are damaged at the end."""
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
                except KeyboardInterrupt:  # between points, or after a second Ctrl-C
                    state.interrupted = True
                    break
                if isinstance(trials, str):
                    state.refused[point.index] = trials
                    total -= _trials_of(point)
                elif trials.interrupted:
                    state.interrupted = True
                    break
                else:
                    write_point(plan.swept, point.values, point.index, trials.table, kept)
                    state.trials_run += _trials_of(point)
                    done += _trials_of(point)


def _trials_of(point: Point) -> int:
    return point.scenario.study.trials if point.scenario else 0


def _run_point(
    point: Point, pool: WorkerPool, dask: str | None, progress: Callable[[int, int], None] | None
) -> Trials | str:
    """Trials of a point, or the reason why it is impossible."""
    scenario = point.scenario
    assert scenario is not None
    try:
        if dask is None:
            return run_trials(scenario, scenario.study.trials, workers=pool, progress=progress)
        TrialRunner(scenario)  # impossible scenarios are reported here, separately from missing clusters
    except InputError as error:
        return " ".join(str(error).split())
    return run_trials(scenario, scenario.study.trials, dask=dask, progress=progress)


def _shifted(progress: Progress | None, before: int, total: int, point: Point) -> Callable[[int, int], None] | None:
    """Progress of a point converted to progress of the sweep."""
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


def _open_points(plan: Plan, folder: Path, force: bool) -> Path:
    """Folder of finished points; those of an interrupted sweep of the same plan are kept."""
    kept = folder / POINTS_FOLDER
    identity_file = kept / IDENTITY_FILE
    if kept.exists() and any(kept.iterdir()) and not identity_file.exists():
        raise InputError(f"{kept}: contains files that do not belong to a sweep; choose another --out")
    if force:
        remove_unfinished(kept)
    new = plan.identity(0)
    if (old := unfinished_identity(kept, "sweep")) is not None and old.sha256 != new.sha256:
        refuse_other(folder, old, new, "finished points")
    make_folder(kept)
    write_atomically(identity_file, json.dumps({"identity": plan.identity(len(plan.points)).to_dict()}))
    return kept


def _whole_points(kept: Path, notes: list[str]) -> set[int]:
    """Numbers of the points with stored trials; damaged files are moved aside, with a message each."""
    whole = set()
    for index, path in point_files(kept).items():
        if fault := fault_of(path):
            notes.append(set_aside(path, fault, kept.parent))
        else:
            whole.add(index)
    return whole
