"""Plots and table of the heads of a sequence: each head alone beside the fused attitude, and its alignment."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from simulator.study.axes import BODY_AXES
from simulator.study.pages.page import Table
from simulator.study.sequence.columns import NO_FRAME
from simulator.study.sequence.plots import draw_compared
from simulator.study.sequence.time_axis import draw_strip, nearly_all, time_axis
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION, Panel
from simulator.study.texts import deg_text
from startracker.core import Columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_HEADS = ((ORANGE, "."), (GREEN, "x"), (INK, "+"), (VERMILION, "1"))
"""Colour and marker of each head; the fifth has those of the first."""


def heads_panels(columns: Columns, names: list[str]) -> dict[str, list[Panel]]:
    """Panels of the page by their heading; none without heads."""
    if not names:
        return {}
    note = "Single frames of each head, and the fused attitude with its ±3σ."
    groups = {
        "Heads": [
            *(
                Panel(f"{axis.capitalize()}, heads and fused", note, _errors_drawer(columns, names, axis))
                for axis in BODY_AXES
            ),
            Panel("Frames", "Whether the frames of each head were solved.", _frames_drawer(columns, names), 2.2),
        ]
    }
    for name in names:
        prefix = f"head_{name}_"
        own = {key.removeprefix(prefix): values for key, values in columns.items() if key.startswith(prefix)}
        if "alignment_x_arcsec" in own:
            own["elapsed_s"] = columns["elapsed_s"]
            groups[f"Alignment of {name}"] = [
                Panel(f"About the camera's {axis}", "", draw_compared(f"alignment_{axis}_arcsec", "angle [″]", own))
                for axis in "xyz"
            ]
    return groups


def _frames_drawer(columns: Columns, names: list[str]) -> Callable[[Axes], None]:
    """Strip chart: one row per head, with bars for its frames."""

    def draw(ax: Axes) -> None:
        for row, name in enumerate(names):
            status = columns[f"head_{name}_status"]
            kinds = {
                "solved": (status == "solved", GREEN),
                "not solved": ((status != "solved") & (status != NO_FRAME), VERMILION),
                "no frame": (status == NO_FRAME, SOFT),
            }
            for label, (chosen, colour) in kinds.items():
                draw_strip(ax, columns, row, chosen, color=colour, label="" if row else label)
        ax.set_yticks(range(len(names)), names)
        ax.set_ylim(len(names) - 0.4, -1.3)
        ax.grid(visible=False, axis="y")
        ax.legend(loc="upper right", ncols=3)
        time_axis(ax, columns)

    return draw


def _errors_drawer(columns: Columns, names: list[str], axis: str) -> Callable[[Axes], None]:
    """Errors about a body axis."""

    def draw(ax: Axes) -> None:
        t, many = columns["elapsed_s"], len(columns["elapsed_s"]) > 1500
        error, sigma = columns[f"error_{axis}_deg"] * 3600.0, columns[f"sigma_{axis}_deg"] * 3600.0
        shown = [error, 3.0 * sigma]
        for k, name in enumerate(names):
            colour, marker = _HEADS[k % len(_HEADS)]
            own = columns[f"head_{name}_error_{axis}_deg"] * 3600.0
            shown.append(own)
            own_t = columns[f"head_{name}_elapsed_s"]
            ax.plot(own_t, own, marker, color=colour, markersize=3.5, label=name, rasterized=many)
        ax.fill_between(t, -3.0 * sigma, 3.0 * sigma, color=BLUE, alpha=0.2, linewidth=0, rasterized=many)
        ax.plot(t, error, "-", color=BLUE, linewidth=1.0, label="fused", rasterized=many)
        if (reach := nearly_all(*shown)) > 0.0:
            ax.set_ylim(-1.4 * reach, 1.8 * reach)
        ax.set_ylabel("error [″]")
        ax.legend(loc="upper right", ncols=len(names) + 1)
        time_axis(ax, columns)

    return draw


def _agreement(rows: dict[str, int]) -> str:
    """The share of the rows in which a head is consistent, and the other states with theirs."""
    total = max(sum(rows.values()), 1)
    others = [f"{state} {100.0 * n / total:.1f} %" for state, n in rows.items() if state != "consistent"]
    return ", ".join([f"{100.0 * rows.get('consistent', 0) / total:.1f} %", *others])


def heads_table(heads: dict[str, Any]) -> Table:
    """Each head alone, what its attitudes did, and the error of its alignment, from ``heads`` of ``sequence.json``."""
    rows = []
    for name, head in heads.items():
        did = head["filter"]
        found = head.get("alignment_arcsec", {})
        off = [
            f"{each['estimated'] - each['true']:+.2f} ± {each['sigma']:.2f}"
            for each in found.values()
            if each["estimated"] is not None
        ]
        rows.append(
            (
                name,
                f"{100.0 * head['availability']:.1f} %",
                str(head["misidentified"]),
                str(head["inconsistent"]),
                str(head["wrong"]),
                *(deg_text(head["errors_deg"][axis]["rms"]) for axis in BODY_AXES),
                str(did["started"] + did["used"]),
                str(did["rejected"] + did["realigned"] + did["restarted"] + did["too_late"]),
                _agreement(head["agreement"]),
                f"{', '.join(off)}″" if off else "exact",
            )
        )
    headings = (
        "head",
        "solved",
        "misidentified",
        "inconsistent",
        "wrong",
        *(f"rms {axis}" for axis in BODY_AXES),
        "used",
        "not used",
        "agrees with the others",
        "alignment, error ± σ",
    )
    note = (
        "Errors of single frames from their own stars. Used: attitudes that updated the filter; not used: beyond its "
        "gate or too late. Agrees: the share of the rows in which the head is as stated, and otherwise what it is."
    )
    return Table(headings, tuple(rows), note=note)
