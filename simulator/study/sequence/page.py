"""The page of a sequence, with the answer in its first lines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.axes import AXES, axis_name
from simulator.study.pages.page import (
    Block,
    Figures,
    Page,
    Picture,
    Section,
    Table,
    Words,
    lead,
    paragraph,
    sections,
    soft,
)
from simulator.study.pages.parts import provenance, unphysical_notes, verdict_table
from simulator.study.sequence.frames import MODES
from simulator.study.sequence.heads_plots import heads_panels, heads_table
from simulator.study.sequence.plots import MODE_TITLES, panels
from simulator.study.sequence.statistics import consistency_text
from simulator.study.specification.outcome import outcome_text
from simulator.study.specification.verdicts import NOT_MET
from simulator.study.texts import deg_text

if TYPE_CHECKING:
    from simulator.study.sequence.result import Sequence

_LARGEST_GIF_BYTES = 12_000_000
"""A larger animation remains a separate file."""

_MOST_UNSOLVED = 20
"""Maximum number of unsolved frames that the page lists."""


def sequence_page(sequence: Sequence, gif: bytes | None = None) -> Page:
    """Content of the page of a sequence.

    Parameters
    ----------
    sequence : Sequence
        Its scenario, frames and summary.
    gif : bytes, optional
        The animation.
    """
    scenario, summary, columns = sequence.scenario, sequence.summary, sequence.columns
    heads = [head.name for head in scenario.heads]
    groups = heads_panels(columns, heads) | panels(columns)
    lens = summary.get("in_flight_calibration")
    modes = tuple((MODE_TITLES[mode], f"{summary['time_in_mode_s'][mode]:g} s") for mode in MODES)
    median_ms = summary["median_ms"]
    times = f"Median {median_ms['render'] or 0:.1f} ms to render a frame, {median_ms['track'] or 0:.1f} ms to track it."
    return Page(
        heading=f"{scenario.name}: sequence of {summary['frames']} frames",
        description=scenario.description,
        provenance=provenance(summary, scenario.fingerprint()),
        answer=_answer(sequence),
        verdict=sequence.judgement.state,
        notes=_notes(summary),
        sections=sections(
            Section("Frames", (_animation(gif),)) if gif is not None else None,
            *(Section(heading, (Figures(tuple(group)),)) for heading, group in groups.items()),
            Section("Calibrated lens", (_calibration(lens),)) if lens is not None else None,
            Section("Accuracy", (_accuracy(summary),)),
            Section("Accuracy of the heads", (heads_table(summary["heads"]),)) if heads else None,
            Section("Time in each mode", (Table(("mode", "time"), modes),)),
            Section("Unsolved frames", (_unsolved(summary, columns),)),
            Section("Method", (paragraph(times),)),
        ),
        scenario=scenario.to_yaml(),
    )


def _answer(sequence: Sequence) -> tuple[Block, ...]:
    summary, judged = sequence.summary, sequence.judgement
    outcome: str | Words = outcome_text(summary)
    if summary["wrong"]:
        outcome = Words(outcome_text(summary), NOT_MET)
    found: list[Block] = [
        lead(Words(f"{judged.text}.", judged.state)),
        verdict_table(judged),
        paragraph(
            "Attitude available for ",
            Words(f"{100 * summary['availability']:.2f} %", "strong"),
            f" of {summary['duration_s']:g} s, ",
            outcome,
            f"; longest outage {summary['longest_outage_s']:g} s.",
        ),
    ]
    if summary["inconsistency"]:
        found.append(paragraph(f"{summary['inconsistency']['text']}."))
    if consistency := consistency_text(summary["nees"]):
        found.append(paragraph(consistency))
    return tuple(found)


def _notes(summary: dict[str, Any]) -> tuple[str, ...]:
    notes = unphysical_notes(summary["unphysical"])
    if summary["interrupted"]:
        frames = f"{summary['frames']} of {summary['requested']} frames"
        notes.insert(0, f"This sequence was interrupted: {frames} are included.")
    return tuple(notes)


def _animation(gif: bytes) -> Block:
    if len(gif) > _LARGEST_GIF_BYTES:
        return soft("The animation is in sequence.gif beside this page.")
    return Picture(
        gif,
        "image/gif",
        "Animation of the frames with windows and matched stars",
        "Windows (orange), matched stars (blue), and the errors below. Also in sequence.gif.",
    )


def _accuracy(summary: dict[str, Any]) -> Table:
    single = summary.get("single")
    rows = []
    for axis in AXES:
        errors = summary["errors_deg"][axis]
        row = [
            axis_name(axis),
            *(deg_text(errors[name]) for name in ("mean", "std", "rms", "p997", "max")),
        ]
        if single:
            gain = single["gain"][axis]
            row += [deg_text(single["errors_deg"][axis]["rms"]), f"{gain:.2f}" if gain else "–"]
        rows.append(tuple(row))
    note = "The error is the rotation vector from the true to the estimated attitude, over the solved frames"
    if single:
        note += f"; single frames: {single['solved']} frames solved one by one without prediction"
    headings = (
        "axis",
        "mean",
        "std",
        "rms",
        "99.7th percentile",
        "max",
        *(("rms, single frames", "gain") if single else ()),
    )
    return Table(headings, tuple(rows), note=f"{note}.")


def _calibration(found: dict[str, Any]) -> Table:
    """Parameters of the lens at the end of a calibration in flight, compared with the truth."""
    rows = []
    for name, value in found["parameters"].items():
        constant_s = value["time_constant_s"]
        rows.append(
            (
                name.replace("_", " "),
                *(f"{value[key]:.4g}" for key in ("value", "sigma", "true")),
                f"{value['error_sigmas']:+.2f}",
                "–" if constant_s is None else f"{constant_s:.0f} s",
            )
        )
    chi2, pixels, used = found["chi2"], found["defective_pixels"], found["frames_used"]
    good = f"{pixels['sound_mapped']} good ones"
    note = (
        f"Changes since the calibration on the ground, after {used} frames. χ² of all parameters "
        f"{chi2['value']:.1f} (95 % bounds {chi2['bounds95'][0]:.1f} to {chi2['bounds95'][1]:.1f}). Of "
        f"{pixels['certain']} defective pixels {pixels['certain_mapped']} are mapped, and {good}."
    )
    return Table(("parameter", "estimate", "σ", "truth", "error / σ", "time constant"), tuple(rows), note=note)


def _unsolved(summary: dict[str, Any], columns: dict[str, NDArray[Any]]) -> Table:
    """Frames that are unsolved or wrong, up to `_MOST_UNSOLVED`."""
    found = np.flatnonzero((columns["status"] != "solved") | columns["wrong"])[:_MOST_UNSOLVED]
    count = summary["frames"] - summary["solved"] + summary["wrong"]
    note = "" if len(found) else "All frames were solved."
    if count > _MOST_UNSOLVED:
        note = f"The first {_MOST_UNSOLVED} of {count}; all are in sequence.parquet."
    return Table(
        ("frame", "time", "status", "reason"),
        tuple(
            (
                str(columns["index"][i]),
                f"{columns['elapsed_s'][i]:g} s",
                str(columns["status"][i]),
                str(columns["reason"][i]),
            )
            for i in found
        ),
        (2, 3),
        note,
    )
