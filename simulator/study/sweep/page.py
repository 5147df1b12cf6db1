"""The page of a sweep."""

from __future__ import annotations

from typing import Any

from simulator.study.axes import AXES, BODY_AXES, axis_name
from simulator.study.pages.page import Block, Figures, Page, Section, Table, Words, lead, paragraph, sections, soft
from simulator.study.pages.parts import provenance
from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED
from simulator.study.sweep.plots import SweepFigure, key_label
from simulator.study.texts import deg_text, rate_text, rms_text, value_text


def sweep_page(table: dict[str, Any], figures: list[SweepFigure]) -> Page:
    """Content of the page of a sweep.

    Parameters
    ----------
    table : dict
        As in ``sweep.json``.
    figures : list of SweepFigure
        From `simulator.study.sweep.plots.sweep_figures`.
    """
    done = [point for point in table["points"] if "statistics" in point]
    refused = [point for point in table["points"] if point["status"] == "refused"]
    swept = [axis["path"] for axis in table["swept"]]
    keys = tuple(key_label(axis) for axis in table["swept"])
    method = (
        paragraph(
            f"Scenario {table['scenario_file']}. Trial ",
            Words("i", "variable"),
            " has the same time, attitude and "
            "random streams at every point, so that points can be compared trial by trial.",
        ),
    )
    return Page(
        heading=f"{table['name']}: sweep of {' and '.join(filter(None, (', '.join(swept[:-1]), swept[-1])))}",
        description=_extent(table),
        provenance=provenance(table, table["identity"]["sha256"]),
        answer=_answer(table, done, refused),
        notes=_notes(table),
        sections=sections(
            Section("Smallest errors", (_best(done, keys, swept),)),
            *(
                Section(figure.title, (Figures(tuple(figure.panels), legend=tuple(figure.legend)), soft(figure.note)))
                for figure in figures
            ),
            Section("Points", (_points(done, keys, swept),)),
            Section("Unphysical points", (_refused(refused, keys, swept),)) if refused else None,
            Section("Method", method),
        ),
    )


def _extent(table: dict[str, Any]) -> str:
    """How many points and trials."""
    kind = "Latin hypercube" if table["kind"] == "latin_hypercube" else "Full grid"
    return f"{kind} of {_counted(len(table['points']))}, {table['trials_per_point']} trials per point."


def _counted(points: int) -> str:
    return f"{points} point{'s' if points != 1 else ''}"


def _answer(table: dict[str, Any], done: list[dict[str, Any]], refused: list[dict[str, Any]]) -> tuple[Block, ...]:
    """Number of points with each verdict, and what limits the verdicts."""
    states = [point["statistics"].get("verdict") for point in done]
    counts: list[str | Words] = []
    for state in (MET, NOT_MET, UNDECIDED):
        if count := states.count(state):
            counts += [", " if counts else "", Words(state, state), f" at {_counted(count)}"]
    specified = ", ".join(f"{name} {deg_text(limit)}" for name, limit in table["specification_deg"].items())
    found: list[Block] = [lead(f"Specification ({specified}): ", *counts, ".")]
    trials, needed = table["trials_per_point"], table["trials_needed"]
    if trials < needed:
        found.append(
            paragraph(
                f"{trials} trials can show that a point does not meet it; at least {needed} are needed to show that "
                "one does."
            )
        )
    if refused:
        verb = "are" if len(refused) > 1 else "is"
        found.append(paragraph(f"{_counted(len(refused))} {verb} unphysical, see below."))
    return tuple(found)


def _notes(table: dict[str, Any]) -> tuple[str, ...]:
    if not table["interrupted"]:
        return ()
    missing = sum(point["status"] == "not run" for point in table["points"])
    return (f"This sweep was interrupted: {_counted(missing)} not run. Run it again to continue.",)


def _values(point: dict[str, Any], swept: list[str]) -> list[str]:
    return [value_text(point["values"][path]) for path in swept]


def _best(done: list[dict[str, Any]], keys: tuple[str, ...], swept: list[str]) -> Table:
    """The point with the smallest rms error about each axis."""
    rows = []
    for axis in AXES:
        known = [point for point in done if point["statistics"][f"{axis}_rms_deg"] is not None]
        if known:
            point = min(known, key=lambda p: p["statistics"][f"{axis}_rms_deg"])
            title = axis_name(axis)
            rows.append((title, rms_text(point["statistics"], axis), str(point["point"]), *_values(point, swept)))
    return Table(("axis", "rms (95 % interval)", "point", *keys), tuple(rows))


def _points(done: list[dict[str, Any]], keys: tuple[str, ...], swept: list[str]) -> Table:
    """Statistics of all points."""
    rows = []
    for point in done:
        s = point["statistics"]
        rows.append((
            str(point["point"]),
            *_values(point, swept),
            f"{s['solved']} of {s['trials']}",
            " / ".join(str(s.get(name, "–")) for name in ("misidentified", "inconsistent", "wrong")),
            rate_text(s),
            *(rms_text(s, axis) for axis in BODY_AXES),
            s.get("verdict", "–"),
        ))  # fmt: skip
    names = (f"rms {axis} (95 %)" for axis in BODY_AXES)
    return Table(
        ("point", *keys, "solved", "mis. / inc. / wrong", "identified (95 %)", *names, "verdict"),
        tuple(rows),
        note="mis. / inc. / wrong: misidentified, inconsistent and wrong attitudes. All statistics are in points.csv "
        "and sweep.json, all trials in sweep.parquet.",
    )


def _refused(refused: list[dict[str, Any]], keys: tuple[str, ...], swept: list[str]) -> Table:
    """Points that no camera can have, with the reason."""
    rows = tuple((str(point["point"]), *_values(point, swept), point["reason"]) for point in refused)
    return Table(("point", *keys, "reason"), rows, (len(keys) + 1,))
