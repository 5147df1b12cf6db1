"""The verdict on a specification and the outcome of attitudes, as every command prints them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from simulator.cli.terminal import print_table
from simulator.study.pages.parts import verdict_table
from simulator.study.specification.outcome import outcome_text
from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED, Judgement

if TYPE_CHECKING:
    from rich.console import Console

_COLOURS = {MET: "green", NOT_MET: "red", UNDECIDED: "yellow"}


def coloured(verdict: str) -> str:
    """A verdict with its colour."""
    return f"[{_COLOURS[verdict]}]{verdict}[/]"


def outcome_line(summary: Mapping[str, Any]) -> str:
    """Wrong and inconsistent attitudes of a summary as a part of a line."""
    text = outcome_text(summary)
    return f"[red]{text}[/]" if summary["wrong"] else text


def outcome_cell(counts: Mapping[str, Any]) -> str:
    """Number of wrong attitudes as the cell of a table, with that of the inconsistent ones if there are any."""
    wrong, inconsistent = counts["wrong"], counts.get("inconsistent", 0)
    text = f"[red]{wrong}[/]" if wrong else "0"
    return f"{text} ({inconsistent} inconsistent)" if inconsistent else text


def print_inconsistency(summary: Mapping[str, Any], console: Console) -> None:
    """Rate and likely cause of inconsistent attitudes; nothing without any."""
    found = summary.get("inconsistency")
    if found is not None:
        console.print(f"{found['text']}.", markup=False, soft_wrap=True)


def print_judgement(judgement: Judgement, console: Console) -> None:
    """The requirements with their verdicts as a table, and the verdict on all of them as a line."""
    table = verdict_table(judgement).without("margin")
    rows = [(*cells, coloured(verdict)) for *cells, verdict in table.rows]
    print_table(console, "specification", table.headings, rows)
    head, said, rest = judgement.text.partition(judgement.state)
    console.print(f"{head}{coloured(said)}{rest}")
