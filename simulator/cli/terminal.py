"""What commands show on a terminal: tables as wide as it is, and a bar while they work."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

from simulator.cli.streams import as_written, is_terminal

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text


def open_console(width: int = 110, *, error: bool = False) -> Console:
    """Console for tables, `width` columns wide where the output is not a terminal; with `error` that for progress."""
    from rich.console import Console

    return Console(stderr=error, highlight=False, width=None if is_terminal(sys.stdout) or error else width)


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
        table.add_row(*(as_written(cell, console.encoding) for cell in row), end_section=n == block)
    console.print(table)


def time_left_s(done: int, done_before: int, total: int, elapsed_s: float) -> float | None:
    """Seconds that the rest will take, from what this start has done: what was resumed cost nothing.

    None until something is finished.
    """
    here = done - done_before
    return elapsed_s / here * (total - done) if here > 0 else None


def times_text(elapsed_s: float, left_s: float | None) -> str:
    """``elapsed 4:00, about 2 min left``; without an estimate the elapsed time alone."""
    minutes, seconds = divmod(int(elapsed_s), 60)
    clock = f"{minutes}:{seconds:02d}" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
    if left_s is None:
        return f"elapsed {clock}"
    if left_s < 55:
        left = f"{max(5, 5 * round(left_s / 5))} s"
    elif left_s < 3570:
        left = f"{max(1, round(left_s / 60))} min"
    else:
        hours, minutes = divmod(round(left_s / 600) * 10, 60)
        left = f"{hours} h" + (f" {minutes} min" if minutes else "")
    return f"elapsed {clock}, about {left} left"


class WorkBar:
    """A bar with the elapsed time and the time left, shown on a terminal only; use it as a context.

    Parameters
    ----------
    name, unit : str
        What is done, and what is counted.
    total : int, optional
        How many; None if it is not known yet.
    clock : callable
        Seconds.
    """

    def __init__(
        self, name: str, unit: str, total: int | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        self.console = open_console(error=True)
        self.clock = clock
        self.started_s = self.first_s = clock()
        self.done_before: int | None = None
        self.left_s: float | None = None
        columns = (
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[unit]}"),
            TextColumn("{task.fields[times]}"),
        )
        self.bar = Progress(*columns, console=self.console, transient=True, disable=not self.console.is_terminal)
        self.task = self.bar.add_task(name, total=total, unit=unit, times=self.times)

    @property
    def times(self) -> str:
        """Elapsed and left, in words."""
        return times_text(self.clock() - self.started_s, self.left_s)

    def __enter__(self) -> Self:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def show(self, done: int, total: int, name: str | None = None) -> None:
        """Show that `done` of `total` are finished, under another name if one is given."""
        if self.done_before is None:
            self.done_before, self.first_s = done, self.clock()
        self.left_s = time_left_s(done, self.done_before, total, self.clock() - self.first_s)
        self.bar.update(self.task, completed=done, total=total, description=name, times=self.times)


@contextmanager
def progress_bar(name: str, unit: str, total: int | None = None) -> Iterator[Callable[[int, int], None]]:
    """A bar that is gone when the work is done, and none without a terminal; call it with (finished, all)."""
    with WorkBar(name, unit, total) as bar:
        yield bar.show
