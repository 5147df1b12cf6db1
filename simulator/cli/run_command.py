"""``boresight run``: progress on a terminal, the statistics table, the files."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from simulator.checks import load_scenario
from simulator.paths import make_folder
from simulator.study.run import RESULT_FILES, Study, run
from simulator.study.statistics import AXES, BODY_AXES, deg_text
from startracker.errors import InputError

if TYPE_CHECKING:
    from simulator.scenario import Scenario


def run_study(
    path: Path,
    trials: int | None,
    seed: int | None,
    set_values: list[str],
    workers: int | None,
    out: Path | None,
    resume: bool,
    dask: str | None = None,
) -> int:
    """Run the study; exit status 0, or 130 where it was interrupted."""
    if trials is not None and trials < 1:
        raise InputError(f"--trials: must be at least 1, not {trials}")
    if seed is not None and seed < 0:
        raise InputError(f"--seed: must be 0 or more, not {seed}")
    if workers is not None and workers < 1:
        raise InputError(f"--workers: must be at least 1, not {workers}")
    if workers is not None and dask is not None:
        raise InputError("--workers and --dask: give one of the two; a cluster has workers of its own")
    scenario = load_scenario(path, set_values, trials=trials, seed=seed)
    folder = make_folder(out or Path("out") / scenario.name)
    processes = workers or _usable_cores(scenario.study.trials)
    study = _run_with_progress(scenario, processes, folder, resume, dask)
    _print(study, Console(highlight=False, width=None if sys.stdout.isatty() else 110))
    return 130 if study.summary["interrupted"] else 0


def _usable_cores(trials: int) -> int:
    """Cores of this machine that are worth a process of their own: starting one costs as much as 100 trials."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, trials // 100))


def _run_with_progress(scenario: Scenario, workers: int, folder: Path, resume: bool, dask: str | None) -> Study:
    console = Console(stderr=True)
    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("trials"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(scenario.name, total=scenario.study.trials)
        return run(
            scenario,
            workers=workers,
            dask=dask,
            out=folder,
            resume=resume,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )


def _print(study: Study, console: Console) -> None:
    summary, name = study.summary, study.scenario.name
    low, high = summary["identification_rate_interval95"]
    if summary["interrupted"]:
        console.print(f"Interrupted: {summary['trials']} of {summary['requested']} trials are finished and kept.")
    for reason in summary["unphysical"]:
        console.print(f"Unphysical, and allowed by the scenario: {reason}")
    table = Table(title=f"{name}: attitude errors over {summary['solved']} solved frames", title_justify="left")
    table.add_column("axis")
    for heading in ("mean", "std", "rms", "3σ", "99.7 %", "largest", "specified", ""):
        table.add_column(heading, justify="right")
    for axis in AXES:
        e = summary["errors_deg"][axis]
        verdict = summary["specification"].get(axis)
        table.add_row(
            "about boresight" if axis == "about_boresight" else axis.replace("_", " "),
            *(deg_text(e[key]) for key in ("mean", "std", "rms", "three_sigma", "p997", "max")),
            deg_text(verdict["specified_deg"]) if verdict else "",
            ("[green]met[/]" if verdict["met"] else "[red]not met[/]") if verdict else "",
            end_section=axis == BODY_AXES[-1],
        )
    console.print(table)
    console.print(
        f"{summary['solved']} of {summary['trials']} frames solved, "
        + (f"[red]{summary['wrong']} wrong[/]" if summary["wrong"] else "none wrong")
        + f"; identified {100 * summary['identification_rate']:.2f} % "
        f"(95 % interval {100 * low:.2f} to {100 * high:.2f} %)"
    )
    console.print(
        f"{summary['trials_per_second']:.1f} trials a second on {summary['workers']} process"
        + ("es" if summary["workers"] > 1 else "")
    )
    for status, count in summary["unsolved_by_status"].items():
        console.print(f"  {count} × {status}")
    console.print(f"{study.folder}: {', '.join(RESULT_FILES)}")
