"""The report as its readers meet it: on a desk and on a phone, in light and in dark, and on paper.

The page is judged by a browser (headless Chromium), not by reading its source. Contrast: WCAG 2.1, 1.4.3 asks for
4.5 : 1 between text and what is behind it.
"""

import importlib.util
import io
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simulator.scenario import Scenario
from simulator.study.report.page import build_report, html_of
from simulator.study.report.pdf import pdf_of
from simulator.study.run import run

HERE = Path(__file__).parent
SCENARIO = HERE.parents[1] / "scenarios" / "cubesat.yaml"
SMALL = ["detector.width=200", "detector.height=200", "detector.pixel_pitch_um=28", "optics.psf.sigma_px=0.7"]
CONTRAST = """
(() => {
  const rgb = text => text.match(/[\\d.]+/g).slice(0, 3).map(Number);
  const linear = v => (v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = text => { const [r, g, b] = rgb(text).map(linear);
                          return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const behind = node => { for (; node; node = node.parentElement) { const c = getComputedStyle(node).backgroundColor;
                           if (c !== 'rgba(0, 0, 0, 0)') return c; } return 'rgb(255, 255, 255)'; };
  const found = [];
  for (const node of document.querySelectorAll('body *')) {
    const own = [...node.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
    if (!own || !node.getClientRects().length) continue;
    const style = getComputedStyle(node);
    const front = light(node instanceof SVGElement ? style.fill : style.color), back = light(behind(node));
    found.push([(Math.max(front, back) + 0.05) / (Math.min(front, back) + 0.05), node.textContent.trim().slice(0, 40)]);
  }
  return found;
})()
"""


def _chromium():
    spec = importlib.util.spec_from_file_location("chromium_over_a_pipe", HERE / "chromium.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
    return build_report(study.scenario, summary, columns)


@pytest.fixture(scope="module")
def file(report, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(html_of(report), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page():
    chromium = _chromium()
    program = chromium.find_chromium()
    if program is None:
        message = (
            "Chromium is missing: install it (Debian: apt-get install chromium) or name it in the variable CHROMIUM"
        )
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    with chromium.Page(program) as opened:
        yield opened


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1100])
def test_page_is_whole_and_legible(page, file, width, scheme):
    page.screen(width, scheme=scheme, mobile=width < 500)
    page.open(file.as_uri())
    assert page.complaints() == []
    assert page.value("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    assert page.value(
        "[...document.querySelectorAll('body *')].filter(n => !(n.closest('svg') && n.tagName !== 'svg')"
        f" && n.getBoundingClientRect().right > {width} + 0.5).map(n => n.outerHTML.slice(0, 80))"
    ) == []  # fmt: skip
    pictures = page.value(
        "Promise.all([...document.querySelectorAll('img, svg image')].map(async n => { const i = new Image();"
        " i.src = n.href ? n.href.baseVal : n.src; await i.decode(); return i.naturalWidth; }))"
    )
    assert len(pictures) >= 3  # the frames
    assert min(pictures) > 100
    dim = [entry for entry in page.value(CONTRAST) if entry[0] < 4.5]
    assert dim == []
    small = page.value(
        "[...document.querySelectorAll('svg text')].map(t => t.getBoundingClientRect().height)"
        ".filter(h => h > 0 && h < 7).length"
    )
    assert small <= (40 if width < 500 else 60)  # the names of stars in the frames alone
    shot = np.asarray(Image.open(io.BytesIO(page.picture())).convert("L"), dtype=float)
    corner = shot[2, 2]
    assert (corner > 240) if scheme == "light" else (corner < 40)
    assert np.mean(np.abs(shot - corner) > 60) > 0.02  # and something stands on it


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


def test_paper_is_white_whatever_the_screen_likes(page, file):
    page.screen(1100, scheme="dark", medium="print")
    page.open(file.as_uri())
    assert page.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 254)"
    assert page.printed().startswith(b"%PDF")


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
    assert len(re.findall(rb"/Type /Page\b", data)) >= 5
