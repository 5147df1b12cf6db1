"""``boresight run``: progress on a terminal, the statistics table, the files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from simulator.checks import load_scenario
from simulator.cli.checks import at_least, processes
from simulator.cli.terminal import open_console, progress_bar
from simulator.paths import make_folder
from simulator.study.run import RESULT_FILES, Study, run
from simulator.study.statistics import AXES, BODY_AXES, deg_text

if TYPE_CHECKING:
    from rich.console import Console


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
    at_least(1, trials=trials)
    at_least(0, seed=seed)
    scenario = load_scenario(path, set_values, trials=trials, seed=seed)
    workers = processes(workers, dask, scenario.study.trials)
    folder = make_folder(out or Path("out") / scenario.name)
    with progress_bar(scenario.name, "trials", scenario.study.trials) as tell:
        study = run(scenario, workers=workers, dask=dask, out=folder, resume=resume, progress=tell)
    _print(study, open_console())
    return 130 if study.summary["interrupted"] else 0


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
