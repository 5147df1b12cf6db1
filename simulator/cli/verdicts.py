"""The verdict on a specification, as every command prints it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.cli.terminal import print_table
from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED, Judgement

if TYPE_CHECKING:
    from rich.console import Console

_COLOURS = {MET: "green", NOT_MET: "red", UNDECIDED: "yellow"}


def coloured(verdict: str) -> str:
    """A verdict with its colour."""
    return f"[{_COLOURS[verdict]}]{verdict}[/]"


def print_judgement(judgement: Judgement, console: Console) -> None:
    """The requirements with their verdicts as a table, and the verdict on all of them as a line."""
    rows = [
        (
            each.requirement.title,
            each.value_text,
            each.interval_text or "–",
            each.limit_text,
            coloured(each.verdict),
        )
        for each in judgement.verdicts
    ]
    headings = ("requirement", judgement.basis, "95 % interval", "specified", "verdict")
    print_table(console, "specification", headings, rows)
    head, said, rest = judgement.text.partition(judgement.state)
    console.print(f"{head}{coloured(said)}{rest}")
