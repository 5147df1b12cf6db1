"""Comparison of a published work with our results: rows of printed and computed values, sections, table, JSON, figures.

A study of a published work is a registry of section functions; each computes its values with the product's physics and
returns a `Section`: rows with comparisons, and figures drawn on request. `run_sections` calls them, `PrintedStudy`
prints and writes their results.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from simulator.paths import make_folder, write_atomically
from simulator.study import style as report_style
from simulator.study.style import STUDY_STYLE
from startracker._version import __version__
from startracker.display import described
from startracker.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

Verdict = Literal["exact", "close", "differs", "not printed", "input missing", "open"]

MARKS: dict[Verdict, str] = {
    "exact": "green",
    "close": "yellow",
    "differs": "red",
    "not printed": "cyan",
    "input missing": "magenta",
    "open": "blue",
}
"""Colour of each verdict in the printed table."""

NOTHING = "–"
"""Content of the column `printed` if the work has no value for comparison."""

COLUMNS: dict[str, dict[str, Any]] = {
    "where": {"min_width": 7},
    "quantity": {"ratio": 3},
    "printed": {"ratio": 2},
    "computed": {"ratio": 2},
    "verdict": {"no_wrap": True},
    "why": {"ratio": 5},
}
"""Columns of the table, the fields of a `Row`, and their widths in the terminal."""


@dataclass(frozen=True)
class Row:
    """One printed value and the one computed here.

    Raises
    ------
    ValueError
        If a row without a printed value has a verdict of comparison, or the reverse.
    """

    where: str
    """Figure, table, equation or section of the work, such as ``"Table 3.3"``."""
    quantity: str
    """Compared quantity."""
    printed: str
    computed: str
    """Both with their unit; `NOTHING` if the work has no value. Computed values never appear as `printed`."""
    verdict: Verdict
    """Result of the comparison: ``"exact"``, agreement in every printed digit; ``"close"``, differences explained by
    rounding, catalogue or an unprinted setting; ``"differs"``, neither. Without comparison: ``"not printed"``, a result
    without a printed value; ``"input missing"``, a printed value whose input (a picture, a setting, a device) is not
    available; ``"open"``, an open question of the work."""
    why: str = ""
    """Method of computation, and reason for a difference."""

    def __post_init__(self) -> None:
        if (self.printed in ("", NOTHING)) != (self.verdict == "not printed"):
            raise ValueError(
                f"{self.where}, {self.quantity}: {self.printed!r} is inconsistent with verdict {self.verdict!r}"
            )


@dataclass(frozen=True)
class Section:
    """Rows and figures of one part of a work, in its order; figures are functions without arguments that draw them, by
    file name without suffix, such as ``"fig_3_3_path"``."""

    title: str
    rows: Sequence[Row]
    figures: Mapping[str, Callable[[], Figure]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return described("Section", self.title, f"{len(self.rows)} rows", f"{len(self.figures)} figures")

    def figure(self, name: str) -> Figure:
        """One figure, drawn in the study's style."""
        from matplotlib import rc_context

        with rc_context(STUDY_STYLE):
            return self.figures[name]()

    def _repr_html_(self) -> str:
        """The table for notebooks."""
        from html import escape

        heads = "".join(f"<th style='text-align:left'>{head}</th>" for head in COLUMNS)
        lines = []
        for row in self.rows:
            cells = (f"<td style='text-align:left'>{escape(getattr(row, name))}</td>" for name in COLUMNS)
            lines.append(f"<tr>{''.join(cells)}</tr>")
        return f"<h4>{escape(self.title)}</h4><table><tr>{heads}</tr>{''.join(lines)}</table>"


def verdict_of(printed: str, computed: float, close: float = 0.05) -> Verdict:
    """Verdict on a computed number and the text of a printed one, in the same unit.

    The printed digits define its precision ("5.50" is ± 0.005, "1,266" is ± 0.5, "2.1e-14" is ± 0.05e-14): ``"exact"``
    if the computed value rounds to the printed digits, ``"close"`` within the relative difference `close`, otherwise
    ``"differs"``.

    Raises
    ------
    ValueError
        If `printed` is not a number.
    """
    number = _number(printed)
    exponent = int(number.as_tuple().exponent)
    difference = abs(computed - float(number))
    if difference <= 0.5 * 10.0**exponent * (1 + 1e-9):
        return "exact"
    return "close" if difference <= close * abs(float(number)) else "differs"


def _number(printed: str) -> Decimal:
    """A number as printed, with its digits; `ValueError` if it is not a number."""
    try:
        return Decimal(printed.replace(",", "").replace("\N{MINUS SIGN}", "-"))
    except InvalidOperation:
        raise ValueError(f"{printed!r} is not a number; use a Row with a verdict") from None


def with_unit(text: str, unit: str) -> str:
    """Numbers followed by their unit; without a space before signs of angles."""
    return f"{text} {unit}" if unit and unit not in "°″′" else text + unit


def compare(
    where: str,
    quantity: str,
    printed: str,
    computed: float,
    *,
    unit: str = "",
    close: float = 0.05,
    form: str | None = None,
    why: str = "",
) -> Row:
    """Row of two numbers in the same unit with the verdict by `verdict_of`.

    Without a format specification the computed value has two more digits than the printed one.
    """
    _sign, digits, exponent = _number(printed).as_tuple()
    if form is None:
        decimals = max(-int(exponent), 0)
        if "e" in printed.lower():
            form = f".{len(digits) + 1}e"
        else:
            whole = decimals == 0 and float(computed).is_integer()
            form = f"{',' if ',' in printed else ''}.{decimals if whole else decimals + 2}f"
    verdict = verdict_of(printed, computed, close)
    return Row(where, quantity, with_unit(printed, unit), with_unit(f"{computed:{form}}", unit), verdict, why)


@dataclass(frozen=True)
class PrintedStudy:
    """The computed sections of a work: name on the command line and of the JSON file; author, year and title of the
    work; sections by name in order."""

    name: str
    title: str
    sections: Mapping[str, Section]

    def counts(self) -> dict[str, int]:
        """Number of rows by verdict."""
        found = Counter(row.verdict for section in self.sections.values() for row in section.rows)
        return {verdict: found[verdict] for verdict in MARKS}  # in the order of MARKS, including zero counts

    def to_dict(self) -> dict[str, Any]:
        """All rows as plain values, for JSON."""
        return {
            "study": self.name,
            "work": self.title,
            "version": __version__,
            "verdicts": self.counts(),
            "sections": {
                key: {
                    "title": section.title,
                    "rows": [asdict(row) for row in section.rows],
                    "figures": [f"{name}.png" for name in section.figures],
                }
                for key, section in self.sections.items()
            },
        }

    def print(self, console: Console) -> None:
        """The tables of all sections and the count of verdicts."""
        from rich.table import Table
        from rich.text import Text

        console.print(Text(self.title, style="bold"))
        for section in self.sections.values():
            if not section.rows:
                continue
            table = Table(title=Text(section.title), title_justify="left", show_lines=True, expand=True)
            for name, width in COLUMNS.items():
                table.add_column(name, **width)
            for row in section.rows:
                table.add_row(
                    *(Text(getattr(row, name), MARKS[row.verdict] if name == "verdict" else "") for name in COLUMNS)
                )
            console.print(table)
        console.print(", ".join(f"{count} {verdict}" for verdict, count in self.counts().items()))

    def write(self, folder: Path) -> list[str]:
        """Write ``NAME.json`` and every figure as PNG into `folder`; returns the names of the files.

        Raises
        ------
        InputError
            If the folder cannot be written, with the reason.
        """
        from matplotlib import rc_context

        from simulator.study.plots import save_bytes

        make_folder(folder)
        files = [f"{self.name}.json"]
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)
        write_atomically(folder / files[0], text + "\n")
        for section in self.sections.values():
            for name in section.figures:
                with rc_context(STUDY_STYLE):
                    data = save_bytes(section.figure(name))
                write_atomically(folder / f"{name}.png", data)
                files.append(f"{name}.png")
        return files


def run_sections(
    name: str,
    title: str,
    registry: Mapping[str, Callable[[], Section]],
    only: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> PrintedStudy:
    """Compute the sections of a work, or the one of a name; `progress` is called with each name before it is computed.

    Raises
    ------
    InputError
        For an unknown section, with the list of sections.
    """
    if only is not None and only not in registry:
        raise InputError(f"--section: unknown section {only!r}; use one of {', '.join(registry)}")
    sections = {}
    for key, function in registry.items():
        if only in (None, key):
            if progress:
                progress(key)
            sections[key] = function()
    return PrintedStudy(name, title, sections)


def new_figure(
    rows: int = 1, columns: int = 1, size: tuple[float, float] = (6.4, 4.2), **axes: Any
) -> tuple[Figure, Any]:
    """A figure of `size` inches in the study's style, and its axes: one, or an array of them, as from ``subplots``."""
    return report_style.new_figure(STUDY_STYLE, rows, columns, size, **axes)
