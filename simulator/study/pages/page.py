"""The content of a page, as data: what a study says, without its layout.

A study builds a `Page`; `simulator.study.pages.html` and `simulator.study.pages.pdf` make files of it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal

from simulator.study.style import Panel


@dataclass(frozen=True)
class Words:
    """Words of a paragraph that are set apart."""

    text: str
    style: str
    """``"strong"``, ``"variable"`` (italic), ``"code"``, or a verdict such as `MET`, for its colour."""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    parts: tuple[str | Words, ...]
    role: Literal["lead", "body", "soft"] = "body"
    """The first line of an answer, ordinary text, or a remark in a smaller size."""

    @property
    def plain(self) -> str:
        """The text without styles."""
        return "".join(part if isinstance(part, str) else part.text for part in self.parts)


@dataclass(frozen=True)
class Table:
    """Headings and rows of text, and a note below. A table without rows is shown as its note alone."""

    headings: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    words: tuple[int, ...] = ()
    """Columns that contain words and are aligned to the left, as the first always is; others are figures."""
    note: str = ""
    links: tuple[tuple[str, str], ...] = ()
    """First cells of rows that lead to a figure of the page, each with the anchor of the figure."""

    def without(self, heading: str) -> Table:
        """The table without a column, for the terminal; notes and links are not kept."""
        kept = [k for k, each in enumerate(self.headings) if each != heading]
        rows = tuple(tuple(row[k] for k in kept) for row in self.rows)
        return Table(tuple(self.headings[k] for k in kept), rows, tuple(kept.index(k) for k in self.words if k in kept))


@dataclass(frozen=True)
class Figures:
    """Figures side by side."""

    panels: tuple[Panel, ...]
    """Wide panels have a row of their own."""
    across: Literal[2, 3] = 3
    """Number of figures in a row of a wide page."""
    legend: tuple[tuple[str, str, str], ...] = ()
    """Legend of all the panels: variable of the colour (`simulator.study.style.COLOURS`), marker and text."""


@dataclass(frozen=True)
class Picture:
    """A picture that exists as the bytes of its file, such as an animation."""

    data: bytes
    media_type: str
    description: str
    """What it shows, for readers who do not see it."""
    caption: str


UNBROKEN = re.compile(r"\([-−+≤≥]?\s?\d[^()]{0,30}\)|[\d.]+ %")
"""Parts of a text within which no line ends: intervals in brackets, and numbers with their per cent sign."""

Block = Text | Table | Figures | Picture


@dataclass(frozen=True)
class Section:
    """A heading and what is below it."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Page:
    """A page: what it is about, the answer of the study, and sections."""

    heading: str
    """First line, and title of the window and of the PDF file."""
    description: str = ""
    provenance: str = ""
    """Origin of the results, from `simulator.study.pages.parts.provenance`."""
    answer: tuple[Block, ...] = ()
    verdict: str = ""
    """Verdict whose colour marks the answer; empty for none."""
    notes: tuple[str, ...] = ()
    """Warnings: what a reader must know before the results."""
    sections: tuple[Section, ...] = field(default=())
    scenario: str = ""
    """The scenario as YAML, at the end of the page."""

    @property
    def scenario_lines(self) -> list[str]:
        """The scenario without comments and empty lines, as it is printed on paper."""
        return [line for line in self.scenario.splitlines() if line.strip() and not line.strip().startswith("#")]


def paragraph(*parts: str | Words) -> Text:
    """A paragraph of ordinary text."""
    return Text(parts)


def lead(*parts: str | Words) -> Text:
    """The first line of an answer."""
    return Text(parts, "lead")


def soft(*parts: str | Words) -> Text:
    """A remark."""
    return Text(parts, "soft")


def sections(*found: Section | None) -> tuple[Section, ...]:
    """The sections that exist, in their order."""
    return tuple(section for section in found if section is not None)
