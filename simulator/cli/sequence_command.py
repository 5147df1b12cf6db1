"""``boresight run --sequence``: progress on a terminal, what came of it, the files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulator.checks import load_scenario
from simulator.cli.checks import at_least
from simulator.cli.requests import RunRequest
from simulator.cli.terminal import open_console, print_table, progress_bar
from simulator.cli.verdicts import outcome_cell, outcome_line, print_inconsistency, print_judgement
from simulator.study.axes import AXES, BODY_AXES, axis_name
from simulator.study.pages.parts import unphysical_notes
from simulator.study.sequence.animation import find_ffmpeg
from simulator.study.sequence.result import Sequence
from simulator.study.sequence.run import run_sequence
from simulator.study.sequence.statistics import consistency_text
from simulator.study.texts import deg_text
from startracker.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console


def run_sequence_command(request: RunRequest) -> int:
    """Run the sequence; exit status 0, or 130 where it was interrupted."""
    at_least(1, frames=request.frames)
    if request.step_s is not None and not request.step_s > 0.0:
        raise InputError(f"--step-s: must be above 0, not {request.step_s:g}")
    at_least(0, seed=request.seed)
    values = list(request.set_values or ())
    values += [f"sequence.frames={request.frames}"] if request.frames is not None else []
    values += [f"sequence.step_s={request.step_s!r}"] if request.step_s is not None else []
    scenario = load_scenario(request.scenario, values, seed=request.seed)
    folder = request.out or Path("out") / f"{scenario.name}-sequence"
    with progress_bar(scenario.name, "frames", scenario.sequence.frames) as progress:
        sequence = run_sequence(
            scenario,
            out=folder,
            single=request.single,
            animate=request.animate,
            ccsds=request.ccsds,
            spice=request.spice,
            force=request.force,
            progress=progress,
        )
    _print(sequence, open_console())
    if request.animate and find_ffmpeg() is None:
        print("ffmpeg is not installed: the animation is a GIF only")
    return 130 if sequence.summary["interrupted"] else 0


def _print(sequence: Sequence, console: Console) -> None:
    summary = sequence.summary
    if summary["interrupted"]:
        console.print(f"Interrupted: {summary['frames']} of {summary['requested']} frames are finished and kept.")
    for note in unphysical_notes(summary["unphysical"]):
        console.print(note, markup=False)
    single = summary.get("single")
    rows = []
    for axis in AXES:
        e = summary["errors_deg"][axis]
        row = [axis_name(axis), *(deg_text(e[key]) for key in ("mean", "rms", "p997", "max"))]
        if single:
            gain = single["gain"][axis]
            row += [deg_text(single["errors_deg"][axis]["rms"]), f"{gain:.2f} ×" if gain else "–"]
        rows.append(row)
    title = f"{summary['name']}: attitude errors over {summary['solved']} solved frames"
    headings = ("axis", "mean", "rms", "99.7 % below", "largest", *(("rms alone", "gain") if single else ()))
    print_table(console, title, headings, rows, block=len(BODY_AXES))
    print_judgement(sequence.judgement, console)
    console.print(
        f"Attitude available for {100.0 * summary['availability']:.2f} % of {summary['duration_s']:g} s, "
        + outcome_line(summary)
        + f"; longest outage {summary['longest_outage_s']:g} s"
    )
    print_inconsistency(summary, console)
    held = [f"{mode.replace('_', ' ')} {seconds:g} s" for mode, seconds in summary["time_in_mode_s"].items() if seconds]
    console.print("; ".join(held))
    if consistency := consistency_text(summary["nees"]):
        console.print(consistency, markup=False)
    if "heads" in summary:
        _print_heads(summary["heads"], console)
    for status, count in summary["unsolved_by_status"].items():
        console.print(f"  {count} × {status}")
    if "operation" in summary:
        _print_operation(summary["operation"], console)
    console.print(f"{sequence.folder}: {', '.join(sequence.files)}")


def _print_heads(heads: dict[str, Any], console: Console) -> None:
    """Each head alone, and what the filter found of its alignment."""
    rows = []
    for name, head in heads.items():
        errors, used = head["errors_deg"], head["filter"]
        rows.append(
            [
                name,
                str(head["solved"]),
                outcome_cell(head),
                *(deg_text(errors[axis]["rms"]) for axis in BODY_AXES),
                str(used["used"] + used["started"]),
                str(used["rejected"] + used["realigned"] + used["restarted"] + used["too_late"]),
            ]
        )
    headings = ("head", "solved", "wrong", *(f"rms {axis}" for axis in BODY_AXES), "used", "not used")
    print_table(console, "Heads: errors of single frames", headings, rows)
    for name, head in heads.items():
        unlike = [f"{state} in {n} rows" for state, n in head["agreement"].items() if state != "consistent"]
        if unlike:
            console.print(f"Agreement of {name}: {', '.join(unlike)}")
        found = head.get("alignment_arcsec", {})
        off = [
            f"{axis} {each['estimated'] - each['true']:+.2f} ± {each['sigma']:.2f}″"
            for axis, each in found.items()
            if each["estimated"] is not None
        ]
        if off:
            console.print(f"Alignment of {name}, error ± σ: {', '.join(off)}")


def _print_operation(rules: dict[str, Any], console: Console) -> None:
    """What the sensor's rules of operation did."""
    exposure, defects, magnitudes = rules["exposure_s"], rules["blemishes"], rules["magnitudes"]
    console.print(
        f"Rules: {rules['discarded']} frames discarded as over-exposed (exposure {exposure['first']:g} s, shortest "
        f"{exposure['shortest']:g} s, last {exposure['last']:g} s); suspended for {rules['suspended_s']:g} s, "
        f"{rules['sun_frames']} frames of the Sun; large objects removed from {rules['moon_frames']} frames"
    )
    console.print(
        f"Defective pixels: {defects['mapped']} mapped, {defects['certain_mapped']} of {defects['certain']} that "
        f"are beyond doubt, {defects['sound_mapped']} sound ones"
    )
    if magnitudes["stars"]:
        slope = magnitudes["colour_slope"]
        console.print(
            f"Magnitudes of {magnitudes['stars']} star images: rms error {magnitudes['rms']:.3f}"
            + ("" if slope is None else f", {slope:+.3f} a magnitude of B − V")
        )
