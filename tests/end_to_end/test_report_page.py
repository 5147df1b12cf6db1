"""The report as its readers meet it: on a desk and on a phone, in light and in dark, and on paper.

The page is judged by a browser (headless Chromium), not by reading its source.
"""

import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from pages import browser, faults, faults_on_paper, screens
from PIL import Image

from simulator.scenario import Scenario
from simulator.study.pages.html import html_of
from simulator.study.pages.pdf import pdf_of
from simulator.study.report.page import report_page
from simulator.study.run import run

pytestmark = pytest.mark.system

HERE = Path(__file__).parent
SCENARIO = HERE.parents[1] / "scenarios" / "cubesat_ideal.yaml"
SMALL = ["detector.width=200", "detector.height=200", "detector.pixel_pitch_um=28", "optics.psf.sigma_px=0.7"]


@pytest.fixture(scope="module")
def report():
    """A report with all its parts: a study of 24 frames, two of them told to be outliers of either kind."""
    study = run(Scenario.load(SCENARIO, SMALL), trials=24)
    columns = {name: np.array(study.columns[name]) for name in study.columns}
    columns["status"][5], columns["reason"][5] = "no_stars", "nothing above the noise"
    for name, column in columns.items():
        if name.startswith("error_"):
            column[5] = np.nan
    columns["wrong"][9] = True
    summary = study.summary | {"solved": 23, "unsolved": 1, "wrong": 1, "unphysical": ["a lens of f/0.3"]}
    return report_page(study.scenario, summary, columns)


@pytest.fixture(scope="module")
def file(report, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(html_of(report), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page():
    with browser() as opened:
        yield opened


@screens(390, 800, 1400)
def test_page_is_whole_and_legible(page, file, width, scheme):
    assert faults(page, file.as_uri(), width, scheme) == []
    pictures = page.value(
        "Promise.all([...document.querySelectorAll('img, svg image')].map(async n => { const i = new Image();"
        " i.src = n.href ? n.href.baseVal : n.src; await i.decode(); return i.naturalWidth; }))"
    )
    assert len(pictures) >= 3  # the frames
    assert min(pictures) > 100
    small = page.value(
        "[...document.querySelectorAll('svg text')].map(t => t.getBoundingClientRect().height)"
        ".filter(h => h > 0 && h < 7).length"
    )
    assert small <= (40 if width < 500 else 60)  # the names of stars in the frames alone


def test_both_schemes_show_frames_as_a_camera_does(page, file):
    """Bright stars on a dark sky; what the camera took is not inverted."""
    middle = {}
    for scheme in ("light", "dark"):
        page.screen(1100, scheme=scheme)
        page.open(file.as_uri())
        box = page.value(
            "(r => [r.left, r.top + scrollY, r.right, r.bottom + scrollY])"
            "(document.querySelector('figure[id^=trial] svg image').getBoundingClientRect())"
        )
        left, top, right, bottom = (round(v) for v in box)
        shot = np.asarray(Image.open(io.BytesIO(page.picture())).convert("L"))
        middle[scheme] = np.median(shot[top:bottom, left:right])
    assert middle["light"] == middle["dark"] < 60


def test_paper_is_white_and_the_print_has_six_pages_at_most(page, file):
    assert faults_on_paper(page, file.as_uri(), most_pages=6) == []
    text = page.value("document.body.innerText")
    assert "Scenario cubesat_ideal, digest " in text
    assert ", seed 1, boresight " in text
    assert " UTC" in text


def test_page_leads_to_its_frames_and_says_how_to_see_any_other(page, file):
    page.screen(1100)
    page.open(file.as_uri())
    assert page.value("[...document.querySelectorAll('a')].every(a => document.querySelector(a.getAttribute('href')))")
    assert page.value("document.querySelectorAll('a[href=\"#trial-5\"]').length") == 1
    text = page.value("document.body.innerText")
    assert "boresight render scenario.resolved.yaml --index I" in text
    assert "nothing above the noise" in text
    assert "a lens of f/0.3" in text
    ids = re.findall(r'\bid="([^"]+)"', file.read_text(encoding="utf-8"))
    assert len(ids) == len(set(ids))


def test_nothing_outside_the_page_and_the_same_bytes_again(report, file):
    text = file.read_text(encoding="utf-8")
    assert "<script" not in text
    outside = re.findall(r"""(?:src|href)=["'](?!#|data:)([^"']*)""", text)
    assert outside == []
    assert text == html_of(report)
    assert len(text) < 4_000_000
    json.dumps(text)


def test_pdf_says_the_same_and_is_the_same_again(report):
    data = pdf_of(report)
    assert data.startswith(b"%PDF")
    assert data == pdf_of(report)
    assert 4 <= len(re.findall(rb"/Type /Page\b", data)) <= 6
