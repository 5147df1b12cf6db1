"""The page engine: one place that writes HTML of studies, and what it makes of each kind of content."""

import ast
import re
from pathlib import Path

import pytest

from simulator.study.pages.html import html_of
from simulator.study.pages.page import Figures, Page, Picture, Section, Table, Words, lead, paragraph, sections, soft
from simulator.study.pages.pdf import pdf_of
from simulator.study.specification.verdicts import MET, NOT_MET
from simulator.study.style import Panel

SIMULATOR = Path(__file__).parents[2] / "simulator"
ENGINE = "study/pages/html.py"
FIGURES = Figures(
    (
        Panel("Narrow", "caption", lambda ax: ax.plot([0, 1]), anchor="narrow", command="boresight render x"),
        Panel("Wide", "", lambda ax: ax.plot([1, 0]), wide=True),
    ),
    legend=(("blue", "●", "first"),),
)


@pytest.fixture(scope="module")
def page():
    """A page with every kind of content."""
    return Page(
        heading="A page",
        description="of a <study>",
        provenance="Scenario a, digest 0123",
        answer=(lead(Words("Specification: met.", MET), " With a margin."), Table(("what", "verdict"), (("a", MET),))),
        verdict=MET,
        notes=("Unphysical value",),
        sections=sections(
            Section("Table", (Table(("trial", "value", "why"), (("7", "1.0″ (0.9–1.1)", "a & b"),), (2,), "Note."),)),
            None,
            Section("Nothing", (Table(("trial",), note="None at all."),)),
            Section("Linked", (Table(("trial", "optics.aperture_mm"), (("3", NOT_MET),), links=(("3", "narrow"),)),)),
            Section("Figures", (soft("Before."), FIGURES, paragraph("Run ", Words("this", "code")))),
            Section("Picture", (Picture(b"GIF89a", "image/gif", "frames", "The frames."),)),
        ),
        scenario="# a comment\nseed: 1\n",
    )


def modules():
    return {path.relative_to(SIMULATOR).as_posix(): path.read_text("utf-8") for path in SIMULATOR.rglob("*.py")}


def imported(source):
    """Top-level packages that a module imports, anywhere in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.partition(".")[0]


def test_only_the_engine_writes_html_of_studies():
    sources = modules()
    assert [name for name, source in sources.items() if {"jinja2", "markupsafe"} & set(imported(source))] == [ENGINE]
    markup = re.compile(r"<(?:!DOCTYPE|html|head|body|table|tr|td|figure|h1)\b")
    assert [
        name for name, source in sources.items() if name.startswith(("study/", "cli/")) and markup.search(source)
    ] == []
    assert [path.name for path in SIMULATOR.rglob("*.j2")] == ["page.html.j2"]


def test_the_page_is_complete_in_itself_and_the_same_again(page):
    text = html_of(page)
    assert text == html_of(page)
    assert text.startswith('<!DOCTYPE html>\n<html lang="en">')
    assert "<script" not in text
    assert re.findall(r"""(?:src|href)=["'](?!#|data:)([^"']*)""", text) == []
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))


def test_each_kind_of_content_is_shown(page):
    text = html_of(page)
    for shown in (
        "<title>A page – boresight</title>",
        "of a &lt;study&gt;",
        '<div class="answer good">',
        '<p class="lead"><b class="good">Specification: met.</b> With a margin.</p>',
        '<td data-label="verdict" class="good">met</td>',
        '<p class="note">Unphysical value</p>',
        '<span class="unbroken">(0.9–1.1)</span>',
        '<td data-label="why" class="words">a &amp; b</td>',
        '<p class="soft">Note.</p>',
        '<p class="soft">None at all.</p>',
        '<a href="#narrow">3</a>',
        "optics.<wbr>aperture_mm</th>",
        '<figure id="narrow"><h3>Narrow</h3>',
        "<code>boresight render x</code>",
        '<figure class="wide"><h3>Wide</h3>',
        '<span style="color: var(--blue)">●</span> first',
        '<img src="data:image/gif;base64,R0lGODlh" alt="frames">',
        "<pre># a comment\nseed: 1\n</pre>",
        '<pre class="paper">seed: 1\n</pre>',
    ):
        assert shown in text, shown
    assert text.count("<table") == 3  # a table without rows is its note
    assert text.count("<svg") == 3  # a wide figure once more for phones


def test_a_pdf_has_the_same_content_and_is_the_same_again(page):
    data = pdf_of(page)
    assert data.startswith(b"%PDF")
    assert data == pdf_of(page)
    assert b"A page" in data
