"""The report as PDF, for signing and filing: A4 pages with the same text and the same figures as the page.

Typeset by matplotlib, without a browser; the same report gives the same bytes.
"""

from __future__ import annotations

import io
import textwrap
from typing import TYPE_CHECKING, Any

from simulator.study.report.content import RENDER_COMMAND
from simulator.study.style import BACK, INK, LINE, NARROW_IN, SOFT, WIDE_IN, Panel, style

if TYPE_CHECKING:
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure

    from simulator.study.html_page import Table
    from simulator.study.report.page import Report

WIDTH_IN, HEIGHT_IN = 8.27, 11.69  # A4
MARGIN_IN = 0.6
_GAP_IN = 0.25
_WIDE_SHARE = 0.85  # of the width of the page, for wide figures
_LINE_IN = 1.45 / 72  # line height, inches per point of font size
_MONOSPACED_IN = 0.605 / 72  # width of a monospaced letter, inches per point
_LETTER_IN = 0.56 / 72  # mean width of a letter of DejaVu Sans with a margin, inches per point


def pdf_of(report: Report) -> bytes:
    """The report as the bytes of a PDF file.

    Parameters
    ----------
    report : Report
        From `simulator.study.report.page.build_report`.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    stream = io.BytesIO()
    content = report.content
    with (
        style(),
        PdfPages(stream, metadata={"Title": f"{report.name}: boresight study", "CreationDate": None}) as pages,
    ):
        paper = Paper(pages, content.provenance)
        paper.text(report.name, 18, weight="bold")
        paper.text(report.description, 9, colour=SOFT)
        paper.text(content.provenance, 8, colour=SOFT)
        paper.text(f"{content.answer.verdict} {content.answer.margin}", 11, weight="bold")
        paper.table(content.answer.axes)
        paper.text(content.answer.axes.note, 8, colour=SOFT)
        paper.table(content.answer.rates)
        paper.text("Limits. " + " ".join(content.answer.limits), 9)
        for note in content.notes:
            paper.text(note, 9, weight="bold")
        paper.heading("Accuracy")
        paper.table(content.accuracy)
        paper.text(content.accuracy.note, 8, colour=SOFT)
        paper.panels(report.panels.errors)
        if report.panels.trends:
            paper.heading("Dependence of the error")
            paper.panels(report.panels.trends)
        if content.budget.rows:
            paper.heading("Error budget")
            paper.table(content.budget)
            paper.text(content.budget.note, 8, colour=SOFT)
        paper.heading("Time and sky")
        paper.panels(report.panels.wide)
        paper.heading("Frames", 4.8)
        paper.panels([panel for panel, _ in report.frames], 2)
        paper.heading("Outliers")
        paper.table(content.outliers)
        paper.text(f"{content.outliers.note} {RENDER_COMMAND}", 8)
        paper.heading("Method")
        paper.text(content.how, 9)
        paper.text(", ".join(f"{name} {number}" for name, number in report.summary["versions"].items()), 8, colour=SOFT)
        paper.heading("Scenario, with all defaults")
        # without comments, which take three pages and are in scenario.resolved.yaml
        lines = report.resolved.splitlines()
        paper.lines([line for line in lines if line.strip() and not line.strip().startswith("#")])
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
        lines = textwrap.wrap(text, int((WIDTH_IN - 2 * MARGIN_IN) / wide))
        for line in lines:
            self._need(_LINE_IN * size)
            self._put(MARGIN_IN, self.top_in, line, size, weight=weight, color=colour)
            self.top_in += _LINE_IN * size
        self.top_in += 0.08 if lines else 0.0

    def heading(self, text: str, need_in: float = 2.5) -> None:
        """A heading, which is never the last item on a page: `need_in` inches must be left."""
        self._need(need_in)
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

    def table(self, table: Table, size: float = 7.5) -> None:
        """A table; columns as wide as their longest cell if there is room, with long cells wrapped."""
        from matplotlib.lines import Line2D

        if not table.rows:
            return
        bold = [heading + " " * (len(heading) // 6) for heading in table.headings]  # wider letters
        letters = [max(len(cell) for cell in column) for column in zip(bold, *table.rows, strict=True)]
        room = (WIDTH_IN - 2 * MARGIN_IN) / (_LETTER_IN * size) - 2 * len(letters)
        while sum(letters) > room:
            letters[letters.index(max(letters))] -= 1
        whole = (
            (WIDTH_IN - 2 * MARGIN_IN) / (sum(letters) + 2 * len(letters))
            if sum(letters) > 0.75 * room
            else _LETTER_IN * size
        )
        edges, x_in = [], MARGIN_IN
        for count in letters:
            edges.append((x_in, x_in + count * whole))
            x_in += (count + 2) * whole
        for r, row in enumerate((table.headings, *table.rows)):
            cells = [textwrap.wrap(cell, count) or [""] for cell, count in zip(row, letters, strict=True)]
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

    def panels(self, panels: list[Panel], across: int = 3) -> None:
        """Figures, `across` per row, or one per row for wide ones."""
        row: list[Panel] = []
        for panel in panels:
            if panel.wide or len(row) == across:
                self._row(row, across)
                row = []
            row.append(panel)
            if panel.wide:
                self._row(row, across)
                row = []
        self._row(row, across)

    def _row(self, row: list[Panel], across: int) -> None:
        if not row:
            return
        width = (WIDTH_IN - 2 * MARGIN_IN) * _WIDE_SHARE
        if not row[0].wide:
            width = (WIDTH_IN - 2 * MARGIN_IN - (across - 1) * _GAP_IN) / across
        scale = width / (WIDE_IN if row[0].wide else NARROW_IN)
        heights = [panel.height_in * scale for panel in row]
        notes = [textwrap.wrap(panel.note, int(width / (_LETTER_IN * 6.5))) for panel in row]
        titles = [textwrap.wrap(panel.title, int(width / (_LETTER_IN * 8.5 * 1.12))) for panel in row]
        above = 0.08 + max(len(title) for title in titles) * _LINE_IN * 8.5
        height = max(heights) + above + 0.06 + max(len(note) for note in notes) * _LINE_IN * 6.5 + 0.15
        sheet = self._need(height)
        for k, (panel, high, title, note) in enumerate(zip(row, heights, titles, notes, strict=True)):
            left = MARGIN_IN + k * (width + _GAP_IN)
            for n, line in enumerate(title):
                self._put(left, self.top_in + n * _LINE_IN * 8.5, line, 8.5, weight="bold")
            top = self.top_in + above
            self._draw(sheet, panel, left, top, width, high)
            for n, line in enumerate(note):
                self._put(left, top + high + 0.04 + n * _LINE_IN * 6.5, line, 6.5, color=SOFT)
        self.top_in += height

    @staticmethod
    def _draw(sheet: Figure, panel: Panel, left: float, top: float, width: float, height: float) -> None:
        """Axes at their position on the page, with room for labels, in the font size of the page."""
        from matplotlib import rc_context

        before, below = 0.45, 0.75 if panel.wide else 0.36 if width < 2.5 else 0.6
        box = (left + before, HEIGHT_IN - top - height + below, width - before - 0.05, height - below - 0.05)
        with rc_context({"font.size": 6.5, "legend.fontsize": 5.5}):
            x, y, w, h = box
            panel.draw(sheet.add_axes((x / WIDTH_IN, y / HEIGHT_IN, w / WIDTH_IN, h / HEIGHT_IN)))
