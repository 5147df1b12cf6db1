"""A page as PDF, for signing and filing: A4 pages with the same text and the same figures as the HTML.

Typeset by matplotlib, without a browser; the same page gives the same bytes.
"""

from __future__ import annotations

import io
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from simulator.study.pages.page import UNBROKEN, Block, Figures, Page, Picture, Section, Table, Text
from simulator.study.style import BACK, INK, LINE, NARROW_IN, SOFT, WIDE_IN, Panel, style

if TYPE_CHECKING:
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 8.27, 11.69  # A4
MARGIN_IN = 0.6
_GAP_IN = 0.25
_WIDE_SHARE = 0.85  # of the width of the page, for wide figures
_LINE_IN = 1.45 / 72  # line height, inches per point of font size
_MONOSPACED_IN = 0.605 / 72  # width of a monospaced letter, inches per point
_LETTER_IN = 0.56 / 72  # mean width of a letter of DejaVu Sans with a margin, inches per point
_BELOW_HEADING_IN = 2.0  # height below a heading that must be left on its page
_TABLE_POINTS = (7.5, 6.5)  # font size of tables, and of those that are too wide for it
_ROLES: dict[str, dict[str, Any]] = {
    "lead": {"size": 11, "weight": "bold"},
    "body": {"size": 9},
    "soft": {"size": 8, "colour": SOFT},
}


def pdf_of(page: Page) -> bytes:
    """The page as the bytes of a PDF file."""
    from matplotlib.backends.backend_pdf import PdfPages

    stream = io.BytesIO()
    with style(), PdfPages(stream, metadata={"Title": page.heading, "CreationDate": None}) as pages:
        paper = Paper(pages, page.provenance)
        paper.text(page.heading, 18, weight="bold")
        paper.text(page.description, 9, colour=SOFT)
        paper.text(page.provenance, 8, colour=SOFT)
        for block in page.answer:
            paper.block(block)
        for note in page.notes:
            paper.text(note, 9, weight="bold")
        for section in page.sections:
            paper.section(section)
        if page.scenario:
            paper.heading("Scenario, with all defaults")
            paper.lines(page.scenario_lines)  # without comments, which take three pages
        paper.end()
    return stream.getvalue()


class Paper:
    """Pages filled from top to bottom; a new page is started for items that do not fit."""

    def __init__(self, pages: PdfPages, footer: str) -> None:
        self.pages = pages
        self.footer = footer
        self.number = 0
        self.sheet: Figure | None = None
        self.top_in = 0.0  # of the next item, from the upper edge

    @property
    def room_in(self) -> float:
        """Height left on the page, inches."""
        return HEIGHT_IN - MARGIN_IN - self.top_in

    def _need(self, height_in: float) -> Figure:
        from matplotlib.figure import Figure

        if self.sheet is None or height_in > self.room_in:
            self.end()
            self.number += 1
            # without a layout engine from the start `savefig` draws once
            size = (WIDTH_IN, HEIGHT_IN)
            self.sheet = Figure(figsize=size, facecolor=BACK, layout="none")  # type: ignore[arg-type]  # not in its types
            self.top_in = MARGIN_IN
            self._put(MARGIN_IN, HEIGHT_IN - 0.4, f"{self.footer}, page {self.number}", 7, color=SOFT)
        return self.sheet

    def end(self) -> None:
        """Finish the current page."""
        if self.sheet is not None:
            self.pages.savefig(self.sheet)  # type: ignore[no-untyped-call]  # matplotlib's has no types
            self.sheet = None

    def _put(self, x_in: float, y_in: float, text: str, size: float, **look: Any) -> None:
        assert self.sheet is not None
        look = dict[str, Any](va="top", ha="left", color=INK, parse_math=False) | look
        self.sheet.text(x_in / WIDTH_IN, 1 - y_in / HEIGHT_IN, text, fontsize=size, **look)

    def text(self, text: str, size: float, weight: str = "normal", colour: str = INK) -> None:
        """A paragraph."""
        wide = _LETTER_IN * size * (1.12 if weight == "bold" else 1.0)
        lines = _wrapped(text, int((WIDTH_IN - 2 * MARGIN_IN) / wide))
        for line in lines:
            self._need(_LINE_IN * size)
            self._put(MARGIN_IN, self.top_in, line, size, weight=weight, color=colour)
            self.top_in += _LINE_IN * size
        self.top_in += 0.08 if lines else 0.0

    def section(self, section: Section) -> None:
        """A heading with what is below it."""
        first = section.blocks[0]
        below = _BELOW_HEADING_IN
        if isinstance(first, Figures):
            below = max(below, _layout(_rows(first)[0], first.across).height)
        self.heading(section.title, below)
        for block in section.blocks:
            self.block(block)

    def block(self, block: Block) -> None:
        """A paragraph, a table or figures; of a picture, which may be moving, its caption."""
        match block:
            case Text(role=role):
                self.text(block.plain, **_ROLES[role])
            case Table():
                self.table(block)
                self.text(block.note, 8, colour=SOFT)
            case Figures(legend=legend, across=across):
                self.text(", ".join(f"{marker} {label}" for _, marker, label in legend), 8)
                for row in _rows(block):
                    self._row(row, across)
            case Picture(caption=caption):
                self.text(caption, 8, colour=SOFT)

    def heading(self, text: str, below_in: float = _BELOW_HEADING_IN) -> None:
        """A heading, which is never the last item on a page: `below_in` inches must be left below it."""
        self._need(below_in + 0.5)
        self.top_in += 0.15
        self.text(text, 13, weight="bold")

    def lines(self, lines: list[str], size: float = 5.0) -> None:
        """Lines in four columns, in a monospaced font; long ones are wrapped."""
        columns = 4
        pitch = (WIDTH_IN - 2 * MARGIN_IN) / columns
        letters = int((pitch - 0.1) / (_MONOSPACED_IN * size))
        lines = [part for line in lines for part in textwrap.wrap(line, letters, subsequent_indent="    ")]
        while lines:
            self._need(2.5 * _LINE_IN * size)
            rows = min(int(self.room_in / (_LINE_IN * size)), -(-len(lines) // columns))
            for k, line in enumerate(lines[: rows * columns]):
                left, top = MARGIN_IN + k // rows * pitch, self.top_in + k % rows * _LINE_IN * size
                self._put(left, top, line, size, family="monospace")
            self.top_in += rows * _LINE_IN * size
            lines = lines[rows * columns :]

    def table(self, table: Table) -> None:
        """A table; columns as wide as their longest cell if there is room, with long cells wrapped."""
        from matplotlib.lines import Line2D

        if not table.rows:
            return
        size, edges, letters = _columns(table)
        for r, row in enumerate((table.headings, *table.rows)):
            cells = [_wrapped(cell, count) or [""] for cell, count in zip(row, letters, strict=True)]
            height = (max(len(cell) for cell in cells) + 0.5) * _LINE_IN * size
            sheet = self._need(height)
            for c, (cell, (left, right)) in enumerate(zip(cells, edges, strict=True)):
                words = c == 0 or c in table.words
                for k, line in enumerate(cell):
                    self._put(
                        left if words else right,
                        self.top_in + k * _LINE_IN * size,
                        line,
                        size,
                        ha="left" if words else "right",
                        weight="normal" if r else "bold",
                    )
            self.top_in += height
            y = 1 - (self.top_in - 0.2 * _LINE_IN * size) / HEIGHT_IN
            ends = [MARGIN_IN / WIDTH_IN, edges[-1][1] / WIDTH_IN]
            sheet.add_artist(Line2D(ends, [y, y], color=LINE, linewidth=0.6))
        self.top_in += 0.12

    def _row(self, row: list[Panel], across: int) -> None:
        """Figures side by side, with their titles and captions."""
        at = _layout(row, across)
        sheet = self._need(at.height)
        for k, (panel, high, title, note) in enumerate(zip(row, at.heights, at.titles, at.notes, strict=True)):
            left = MARGIN_IN + k * (at.width + _GAP_IN)
            for n, line in enumerate(title):
                self._put(left, self.top_in + n * _LINE_IN * 8.5, line, 8.5, weight="bold")
            top = self.top_in + at.above
            self._draw(sheet, panel, left, top, at.width, high)
            for n, line in enumerate(note):
                self._put(left, top + high + 0.04 + n * _LINE_IN * 6.5, line, 6.5, color=SOFT)
        self.top_in += at.height

    @staticmethod
    def _draw(sheet: Figure, panel: Panel, left: float, top: float, width: float, height: float) -> None:
        """Axes at their position on the page, with room for labels, in the font size of the page."""
        from matplotlib import rc_context

        before, below = 0.45, 0.75 if panel.wide else 0.36 if width < 2.5 else 0.6
        box = (left + before, HEIGHT_IN - top - height + below, width - before - 0.05, height - below - 0.05)
        with rc_context({"font.size": 6.5, "legend.fontsize": 5.5}):
            x, y, w, h = box
            panel.draw(sheet.add_axes((x / WIDTH_IN, y / HEIGHT_IN, w / WIDTH_IN, h / HEIGHT_IN)))


def _unbroken(text: str) -> str:
    """The text with spaces at which no line ends within intervals and before per cent signs."""
    return UNBROKEN.sub(lambda found: found[0].replace(" ", "\N{NO-BREAK SPACE}"), text)


def _wrapped(text: str, letters: int) -> list[str]:
    """Lines of at most a number of letters; intervals and words with a hyphen stay together."""
    return textwrap.wrap(_unbroken(text), letters, break_on_hyphens=False)


def _columns(table: Table) -> tuple[float, list[tuple[float, float]], list[int]]:
    """Font size of a table, and of each column its edges, inches, and the number of letters in a line."""
    bold = [heading + " " * (len(heading) // 6) for heading in table.headings]  # wider letters
    letters = [max(len(cell) for cell in column) for column in zip(bold, *table.rows, strict=True)]
    rooms = [(WIDTH_IN - 2 * MARGIN_IN) / (_LETTER_IN * size) - 2 * len(letters) for size in _TABLE_POINTS]
    fits = sum(letters) <= rooms[0]
    size, room = (_TABLE_POINTS[0], rooms[0]) if fits else (_TABLE_POINTS[1], rooms[1])
    needed = [
        max(len(word) for cell in column for word in _unbroken(cell).split(" "))
        for column in zip(bold, *table.rows, strict=True)
    ]
    while sum(letters) > room:
        spare = [count if count > least else 0 for count, least in zip(letters, needed, strict=True)]
        widest = spare if any(spare) else letters
        letters[widest.index(max(widest))] -= 1
    pitch = _LETTER_IN * size
    if sum(letters) > 0.75 * room:
        pitch = (WIDTH_IN - 2 * MARGIN_IN) / (sum(letters) + 2 * len(letters))
    edges, x_in = [], MARGIN_IN
    for count in letters:
        edges.append((x_in, x_in + count * pitch))
        x_in += (count + 2) * pitch
    return size, edges, letters


def _rows(figures: Figures) -> list[list[Panel]]:
    """The panels by rows: `across` in each, and a row of its own for each wide one."""
    rows: list[list[Panel]] = []
    for panel in figures.panels:
        if not rows or panel.wide or rows[-1][-1].wide or len(rows[-1]) == figures.across:
            rows.append([])
        rows[-1].append(panel)
    return rows


@dataclass(frozen=True)
class _RowLayout:
    """Sizes in inches and wrapped texts of figures side by side."""

    width: float
    """Of each figure."""
    height: float
    """Of the row, with titles and captions."""
    above: float
    """Of the titles."""
    heights: list[float]
    titles: list[list[str]]
    notes: list[list[str]]
    """Of each figure."""


def _layout(row: list[Panel], across: int) -> _RowLayout:
    """Layout of a row of figures."""
    width = (WIDTH_IN - 2 * MARGIN_IN) * _WIDE_SHARE
    if not row[0].wide:
        width = (WIDTH_IN - 2 * MARGIN_IN - (across - 1) * _GAP_IN) / across
    scale = width / (WIDE_IN if row[0].wide else NARROW_IN)
    heights = [panel.height_in * scale for panel in row]
    notes = [_wrapped(f"{panel.note}{panel.command}", int(width / (_LETTER_IN * 6.5))) for panel in row]
    titles = [_wrapped(panel.title, int(width / (_LETTER_IN * 8.5 * 1.12))) for panel in row]
    above = 0.08 + max(len(title) for title in titles) * _LINE_IN * 8.5
    height = max(heights) + above + 0.06 + max(len(note) for note in notes) * _LINE_IN * 6.5 + 0.15
    return _RowLayout(width, height, above, heights, titles, notes)
