"""``boresight run``: progress on a terminal, the statistics table, the files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simulator.checks import load_scenario
from simulator.cli.checks import at_least, processes
from simulator.cli.requests import RunRequest
from simulator.cli.terminal import open_console, print_table, progress_bar
from simulator.cli.verdicts import outcome_line, print_inconsistency, print_judgement
from simulator.study.axes import AXES, BODY_AXES, axis_name
from simulator.study.pages.parts import unphysical_notes
from simulator.study.run import RESULT_FILES, Study, run
from simulator.study.texts import deg_text
from startracker.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console


def main(request: RunRequest) -> int:
    """Run the study or the sequence; exit status 0, or 130 where it was interrupted."""
    _refuse_unused(request)
    if request.sequence:
        from simulator.cli.sequence_command import run_sequence_command

        return run_sequence_command(request)
    at_least(1, trials=request.trials)
    at_least(0, seed=request.seed)
    scenario = load_scenario(request.scenario, request.set_values or (), trials=request.trials, seed=request.seed)
    workers = processes(request.workers, request.dask, scenario.study.trials)
    folder = request.out or Path("out") / scenario.name
    with progress_bar(scenario.name, "trials", scenario.study.trials) as progress:
        study = run(
            scenario,
            workers=workers,
            dask=request.dask,
            out=folder,
            resume=request.resume,
            force=request.force,
            progress=progress,
        )
    _print(study, folder, open_console())
    return 130 if study.summary["interrupted"] else 0


def _refuse_unused(request: RunRequest) -> None:
    """Refuse the first option that has no effect with ``--sequence``, or without it."""
    of_sequences = ("frames", "step_s", "single", "animate", "ccsds", "spice")
    unused = ("trials", "workers", "dask", "resume") if request.sequence else of_sequences
    for name in unused:
        value, option = getattr(request, name), f"--{name.replace('_', '-')}"
        if value is not None and value is not False:
            if request.sequence:
                raise InputError(f"{option}: has no effect with --sequence; remove it")
            raise InputError(f"{option}: requires --sequence")


def _print(study: Study, folder: Path, console: Console) -> None:
    summary, name = study.summary, study.scenario.name
    low, high = summary["identification_rate_interval95"]
    if summary["interrupted"]:
        console.print(f"Interrupted: {summary['trials']} of {summary['requested']} trials are finished and kept.")
    for note in unphysical_notes(summary["unphysical"]):
        console.print(note, markup=False)
    rows = []
    for axis in AXES:
        e = summary["errors_deg"][axis]
        rows.append((
            axis_name(axis),
            *(deg_text(e[key]) for key in ("mean", "std", "rms", "p997")),
            " to ".join(map(deg_text, e["p997_interval95"])),
            deg_text(e["max"]),
        ))  # fmt: skip
    title = f"{name}: attitude errors over {summary['solved']} solved frames"
    headings = ("axis", "mean", "std", "rms", "99.7 % below", "95 % interval", "largest")
    print_table(console, title, headings, rows, block=len(BODY_AXES))
    print_judgement(study.judgement, console)
    console.print(
        f"{summary['solved']} of {summary['trials']} frames solved, "
        + outcome_line(summary)
        + f"; identified {100 * summary['identification_rate']:.2f} % "
        f"(95 % interval {100 * low:.2f} to {100 * high:.2f} %)"
    )
    print_inconsistency(summary, console)
    console.print(
        f"{summary['trials_per_second']:.1f} trials per second on {summary['workers']} process"
        + ("es" if summary["workers"] > 1 else "")
    )
    for status, count in summary["unsolved_by_status"].items():
        console.print(f"  {count} × {status}")
    for note in study.notes:
        console.print(note, markup=False, soft_wrap=True)
    if study.folder is None:
        console.print(f"{folder}: keeps the results of an earlier run with more trials; run again to finish this one")
    else:
        console.print(f"{folder}: {', '.join(RESULT_FILES)}")
