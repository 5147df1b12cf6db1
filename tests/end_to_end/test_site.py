"""The documentation site: built without warnings, searchable, and whole on every screen (headless Chromium)."""

import importlib.util
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import quote

import pytest

pytestmark = pytest.mark.slow
HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGES = (
    "index.html",
    "tutorials/first-study.html",
    "tutorials/first-photograph.html",
    "how-to/camera.html",
    "reference/files.html",
    "reference/glossary.html",
    "reference/generated/scenario/detector.html",
    "reference/generated/commands/solve.html",
    "reference/generated/api/startracker.StarTracker.html",
    "notebooks/accuracy.html",
    "tracker.html",
    "theses.html",
)
BEYOND = """
(() => { const scrolls = n => { for (let p = n.parentElement; p; p = p.parentElement) {
           const o = getComputedStyle(p).overflowX; if (o === 'auto' || o === 'scroll' || o === 'hidden') return true; }
           return false; };
         const seen = n => { const s = getComputedStyle(n); return s.display !== 'none' && s.visibility !== 'hidden'; };
         return [...document.querySelectorAll('main *')].filter(n => seen(n) && n.getClientRects().length
           && n.getBoundingClientRect().right > innerWidth + 1 && !n.closest('dialog') && !scrolls(n))
           .map(n => n.outerHTML.slice(0, 100)); })()
"""
"""Elements that reach over the right border of the window, and stand in nothing that scrolls."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site as `make docs` builds it, with warnings as errors."""
    pytest.importorskip("sphinx")
    out = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", "docs", str(out)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return out


@pytest.fixture(scope="module")
def page():
    spec = importlib.util.spec_from_file_location("chromium_over_a_pipe", HERE / "chromium.py")
    chromium = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(chromium)
    program = chromium.find_chromium()
    if program is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)("Chromium is missing")
    with chromium.Page(program) as opened:
        yield opened


@pytest.fixture(scope="module")
def index(site):
    text = (site / "searchindex.js").read_text(encoding="utf-8")
    return json.loads(re.fullmatch(r"Search\.setIndex\((.*)\)\s*", text, re.DOTALL)[1])


def _found(index, *words):
    """Names of the pages that have all words, stemmed as Sphinx stems them."""
    from sphinx.search.en import SearchEnglish

    stem = SearchEnglish({}).stem
    sets = []
    for word in words:
        numbers = set()
        for table in ("terms", "titleterms"):
            entry = index[table].get(stem(word.lower()), [])
            numbers |= {entry} if isinstance(entry, int) else set(entry)
        sets.append(numbers)
    return {index["docnames"][n] for n in set.intersection(*sets)}


def test_search_finds_what_readers_look_for(index):
    assert {"camera", "reference/glossary"} <= _found(index, "rolling", "shutter")
    assert "reference/glossary" in _found(index, "NEA")
    assert "reference/generated/commands/solve" in _found(index, "wcs")
    options = {entry[4] if isinstance(entry[4], str) else "" for group in index["objects"].values() for entry in group}
    assert any("wcs" in anchor for anchor in options)
    assert not _found(index, "nosuchwordanywhere")


@pytest.mark.parametrize(
    ("query", "first"), [("rolling shutter", "Camera geometry"), ("NEA", "Glossary"), ("--wcs", "boresight solve")]
)
def test_search_page_lists_the_page(site, page, query, first):
    page.screen(1400)
    page.open((site / "search.html").as_uri() + f"?q={quote(query)}")
    found = "[...document.querySelectorAll('#search-results li')].map(n => n.innerText)"
    deadline = time.monotonic() + 20.0
    while not any(first in text for text in page.value(found)):
        assert time.monotonic() < deadline, page.value(found)
        time.sleep(0.2)


def test_nothing_is_fetched(site):
    for file in site.rglob("*.html"):
        text = file.read_text(encoding="utf-8")
        outside = re.findall(r"<(?:script|img|iframe)[^>]*src=[\"'](?:https?:)?//", text)
        outside += re.findall(r"<link[^>]*rel=[\"']stylesheet[\"'][^>]*href=[\"'](?:https?:)?//", text)
        assert not outside, file


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 800, 1400])
def test_pages_are_whole(site, page, width, scheme):
    page.screen(width, scheme=scheme, mobile=width < 500)
    for name in PAGES:
        page.open((site / name).as_uri())
        assert [c for c in page.complaints() if "request to" in c] == [], name
        assert page.value("document.documentElement.scrollWidth <= document.documentElement.clientWidth"), name
        assert page.value(BEYOND) == [], name
        assert page.value("[...document.images].every(i => i.complete && i.naturalWidth > 0)"), name
        assert page.value("document.documentElement.dataset.theme") == scheme, name


def test_paper_has_the_text_alone(site, page):
    page.screen(800, medium="print")
    page.open((site / "tutorials/first-study.html").as_uri())
    assert page.value("getComputedStyle(document.querySelector('.bd-header')).display") == "none"
    assert page.printed().startswith(b"%PDF")
