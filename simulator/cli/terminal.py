"""What commands show on a terminal: tables as wide as it is, and a bar while they work."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text


def open_console(width: int = 110, *, error: bool = False) -> Console:
    """Console for tables, `width` columns wide where the output is no terminal; with `error` that for progress."""
    from rich.console import Console

    return Console(stderr=error, highlight=False, width=None if sys.stdout.isatty() or error else width)


def axis_title(axis: str) -> str:
    """Name of an axis of the errors, for people."""
    return "about boresight" if axis == "about_boresight" else axis.replace("_", " ")


def print_table(
    console: Console,
    title: str | Text,
    headings: Sequence[str | Text],
    rows: Iterable[Sequence[str]],
    *,
    words: int = 1,
    block: int | None = None,
) -> None:
    """Print a table: the first `words` columns to the left, figures to the right, a line after `block` rows."""
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for n, heading in enumerate(headings):
        table.add_column(heading, justify="left" if n < words else "right")
    for n, row in enumerate(rows, start=1):
        table.add_row(*row, end_section=n == block)
    console.print(table)


@contextmanager
def progress_bar(name: str, unit: str, total: int | None = None) -> Iterator[Callable[[int, int], None]]:
    """A bar that is gone when the work is done, and none without a terminal; call it with (finished, all)."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    own = open_console(error=True)
    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=own, transient=True, disable=not own.is_terminal) as bar:
        task = bar.add_task(name, total=total)
        yield lambda done, of: bar.update(task, completed=done, total=of)
